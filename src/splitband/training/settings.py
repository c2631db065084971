"""Define the settings of a training, the recipes for a record, progress and history."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from splitband.records import Record
from splitband.records.signals import usual_distance, warm_ends
from splitband.runtime.arguments import whole
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr

Recipe = Literal["default", "constant-rate"]
ROUND = 20
"""Iterations of a round of L-BFGS."""
STEPS = 1000
"""Gradient steps of the default recipe, for each network."""
SHORTEST_WINDOW = 150
"""Shortest window of the default recipe in samples, for records of sufficient length."""
MAX_BATCHES = 100
"""Largest number of steps per epoch in the default recipe, for a part of a long record's windows.
"""
ENOUGH_WINDOWS = 0.25
"""Least share of windows with a warm-up without gaps; below it, warm-ups are shortened."""


@dataclass(frozen=True, repr=False)
class TrainingSettings(WithRepr):
    """Training settings: our recipe of about a thousand steps, unless they are changed.

    `of` adapts them to the length of a record, `paper` returns those of the paper.

    Attributes
    ----------
    window : Length of a training window in samples, with its warm-up; one starts at every sample.
    warmup : R, measured samples at the start of a window, for the initial state.
    epochs : Passes over all windows (the paper's "training steps"), or over `max_batches` of them;
        may be 0 with `lbfgs_iterations`.
    batch_size : Windows per gradient step.
    learning_rate : Initial learning rate of Adam.
    milestones : `(epoch, learning rate)` pairs: the rate from an epoch on.
    one_cycle : In place of milestones, the rate rises to `learning_rate` over the first tenth of
        the steps and falls along a cosine to a hundredth of `learning_rate`.
    clip : Largest norm of a gradient.
    growth : Share of the training in which the free run grows from a tenth to its full length.
    normalize : Scale channels by mean and standard deviation of the training record.
    max_batches : Largest number of steps per epoch, with windows drawn anew for every epoch.
    lbfgs_iterations : Iterations of L-BFGS after the epochs, at most. See `training.lbfgs`. A
        state-space network on many samples takes a step of Levenberg-Marquardt in place of ten, see
        `training.levenberg`.
    max_samples : Largest number of samples in an iteration of L-BFGS, warm-ups included; of more
        windows, evenly spaced ones are used.
    l2 : Weight of the sum of squared weights in the loss, relative to the mean squared error
        of the scaled channels (ridge regression). It helps with few samples.
    linear_start : Networks with a linear part begin as the linear model of the record.
    """

    window: int = SHORTEST_WINDOW
    warmup: int = 50
    epochs: int = 50
    batch_size: int = 25
    learning_rate: float = 1e-2
    milestones: tuple[tuple[int, float], ...] = ()
    one_cycle: bool = True
    clip: float | None = 1.0
    growth: float = 0.6
    normalize: bool = True
    max_batches: int | None = 20
    lbfgs_iterations: int | None = None
    max_samples: int = 100_000
    l2: float = 0.0
    linear_start: bool = True

    def __post_init__(self) -> None:
        """Check ranges."""
        values = vars(self)
        optional = [
            name for name in ("max_batches", "lbfgs_iterations") if values[name] is not None
        ]
        for name in ("window", "warmup", "epochs", "batch_size", "max_samples", *optional):
            values[name] = whole(name, values[name], 0 if name == "epochs" else 1)
        if not self.epochs and not self.lbfgs_iterations:
            raise InputError("epochs must be positive without lbfgs_iterations, got 0")
        if self.window <= self.warmup:
            raise InputError(
                f"window must be longer than the warm-up of {self.warmup} samples, "
                f"got {self.window}"
            )
        for epoch, _ in self.milestones:
            if epoch < 0:
                raise InputError(f"milestones must be at epochs from 0 on, got {epoch}")
        for rate in (self.learning_rate, *(rate for _, rate in self.milestones)):
            if not 0 < rate < float("inf"):
                raise InputError(f"learning rates must be positive, got {rate}")
        if self.one_cycle and self.milestones:
            raise InputError(f"milestones need one_cycle=False, got {self.milestones}")
        if self.clip is not None and not self.clip > 0:
            raise InputError(f"clip must be positive, got {self.clip}")
        if not 0 <= self.l2 < float("inf"):
            raise InputError(f"l2 must not be negative, got {self.l2}")
        if not 0 <= self.growth <= 1:
            raise InputError(f"growth must be a share of the training, 0 to 1, got {self.growth}")

    @classmethod
    def of(cls, samples: int, windows: int | None = None) -> TrainingSettings:
        """Return the default recipe for a number of training samples; not in the paper.

        Windows have two fifths of the samples, 150 to 400. The learning rate has one cycle,
        gradients are clipped, free runs grow. A network takes about `STEPS` steps, at most
        `MAX_BATCHES` of them per epoch. `windows`: the number of windows, if gaps reduce it.
        """
        window = max(SHORTEST_WINDOW, 2 * samples // 5)
        window = max(2, min(400, window, longest_window(samples)))
        windows = max(samples - window + 1, 1) if windows is None else windows
        batches = min(-(-windows // cls.batch_size), MAX_BATCHES)
        epochs = max(1, round(STEPS / batches))
        return cls(window, default_warmup(window), epochs, max_batches=batches)

    @classmethod
    def paper(
        cls,
        window: int = 150,
        warmup: int = 30,
        epochs: int = 300,
        batch_size: int = 50,
        learning_rate: float = 1e-3,
        **changes: Any,
    ) -> TrainingSettings:
        """Return the settings of the paper for its system (i), some of them changed.

        Adam at a constant rate, in batches of 50 windows (Ensinger et al. 2023, Sec. 5).
        """
        plain = {"one_cycle": False, "clip": None, "growth": 0.0, "max_batches": None}
        return cls(window, warmup, epochs, batch_size, learning_rate, **{**plain, **changes})

    def batches(self, windows: int) -> int:
        """Return the steps of an epoch over a number of windows."""
        batches = -(-windows // self.batch_size)
        return batches if self.max_batches is None else min(batches, self.max_batches)

    def batches_of(self, samples: int) -> int:
        """Return the steps of an epoch over a record of `samples` without gaps."""
        return self.batches(max(samples - self.window + 1, 1))

    @property
    def rounds(self) -> int:
        """Return the number of rounds of `ROUND` iterations after the epochs."""
        return -(-(self.lbfgs_iterations or 0) // ROUND)

    def after(self, earlier: TrainingSettings | None) -> TrainingSettings:
        """Return the sum of an `earlier` training and its continuation by this one, for tables."""
        if earlier is None:
            return self
        iterations = (earlier.lbfgs_iterations or 0) + (self.lbfgs_iterations or 0)
        epochs = earlier.epochs + self.epochs
        return replace(self, epochs=epochs, lbfgs_iterations=iterations or None)

    def steps_in_words(self) -> str:
        """Describe the length of the training, for tables."""
        epochs = f"{self.epochs} epoch{'s' if self.epochs > 1 else ''}"
        finish = f"{self.lbfgs_iterations} iterations" if self.lbfgs_iterations else ""
        l2 = f"l2 {self.l2:g}" if self.l2 else ""
        random = "" if self.linear_start else "from random weights"
        return ", ".join(filter(None, [random, epochs if self.epochs else "", finish, l2]))

    def rate(self, epoch: int, share: float) -> float:
        """Return the learning rate in an epoch after a `share` (0 to 1) of all steps."""
        if self.one_cycle:
            rise = 0.1
            if share < rise:
                return self.learning_rate * (0.1 + 0.9 * share / rise)
            fall = 0.5 * (1 + math.cos(math.pi * (share - rise) / (1 - rise)))
            return self.learning_rate * (0.01 + 0.99 * fall)
        reached = [rate for start, rate in sorted(self.milestones) if start <= epoch]
        return reached[-1] if reached else self.learning_rate

    def reach(self, share: float, steps: int) -> int:
        """Return the length of the free run, at most `steps`, after a `share` of all batches."""
        done = min(1.0, share / self.growth) if self.growth else 1.0
        return max(1, round(steps * (0.1 + 0.9 * done)))


def longest_window(samples: int) -> int:
    """Return the longest window, three fifths of a record's samples: windows then differ."""
    return 3 * samples // 5


def default_warmup(window: int, most: int = 50) -> int:
    """Return a third of the window in samples, at most `most`."""
    return min(most, max(1, window // 3))


def recipe_settings(
    recipe: Recipe, training: Record, others: Sequence[Record] = ()
) -> TrainingSettings:
    """Return a recipe's settings for a record, with a shorter warm-up if gaps leave few windows.

    Windows fit into the `others`, the further training records, too. "constant-rate" is like the
    paper's: Adam at 1e-3 on windows of at most 250 samples (`reproduction.settings` has its own).
    """
    samples = len(training)
    settings = TrainingSettings.of(samples)
    if recipe == "constant-rate":
        window = min(250, max(2, samples // 2))
        settings = TrainingSettings.paper(window, default_warmup(window))
    longest = max(min(map(len, others), default=settings.window), 2)
    if longest < settings.window:
        warmup = min(settings.warmup, default_warmup(longest))
        settings = replace(settings, window=longest, warmup=warmup)
    if training.measured is None or samples < settings.window:
        return settings
    tried = []
    # A warm-up ends with a sample of the slowest channel.
    slowest = max(usual_distance(known) for known in training.measured.T)
    enough = ENOUGH_WINDOWS / slowest * (samples - settings.window + 1)
    for part in (1, 2, 4):
        warmup = max(settings.warmup // part, 1)
        starts = window_starts([training], settings.window, warmup)
        tried.append((len(starts), warmup))
        if len(starts) >= enough:
            break
    windows, warmup = max(tried)
    if recipe == "default" and windows:
        settings = TrainingSettings.of(samples, windows)
    return replace(settings, warmup=warmup)


def within_reach(settings: TrainingSettings, reach: int | None) -> TrainingSettings:
    """Return settings whose windows predict at most `reach` samples, where errors stay useful."""
    if reach is None:
        return settings
    return replace(settings, window=min(settings.window, settings.warmup + reach))


def window_starts(records: Sequence[Record], window: int, warmup: int) -> npt.NDArray[np.int_]:
    """Return the first samples of all windows, counted over the records."""
    found, begin = [], 0
    for record in records:
        known = record.y_with_gaps
        starts = warm_ends(known, warmup) - warmup
        starts = starts[starts + window <= len(record)]
        something = np.concatenate([[0], np.cumsum(~np.isnan(known).all(axis=1))])
        some = something[starts + window] > something[starts + warmup]
        found.append(begin + starts[some])
        begin += len(record)
    return np.concatenate(found)


def checked_starts(records: Sequence[Record], window: int, warmup: int) -> npt.NDArray[np.int_]:
    """Return the `window_starts`; raises ValueError for none."""
    shortest = min(records, key=len)
    if len(shortest) < window:
        named = f" {shortest.name}" if len(records) > 1 and shortest.name else ""
        raise InputError(
            f"window must fit into the training record{named} of {len(shortest)} samples, "
            f"got {window}"
        )
    starts = window_starts(records, window, warmup)
    if not len(starts):
        raise InputError(
            f"warmup must fit between the gaps of the training record, got {warmup} samples"
        )
    return starts


@dataclass(frozen=True)
class Progress:
    """The progress of a training, after an epoch."""

    task: str
    epoch: int
    epochs: int
    loss: float
    share: float
    """Completed share of the whole training, 0 to 1."""


@dataclass
class History:
    """The losses by task, and the run time of a training."""

    losses: dict[str, list[float]] = field(default_factory=dict)
    """The mean losses of epochs, then of rounds on all windows, in one unit."""
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    """Failures in training, in words."""
    cut: bool = False
    """Whether a deadline ended the training early."""
