"""Training on windows of a record: free runs from a warm-up, compared with what was measured."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from splitband.data import Trajectory
from splitband.models import Model, Signals, Task
from splitband.threads import one_torch_thread

STEPS = 1000
"""Gradient steps of the default recipe, for each network."""


@dataclass(frozen=True)
class Settings:
    """How to train; the defaults are the paper's for its system (i), `Settings.of` is our recipe.

    Attributes
    ----------
    window : Samples of a sub-trajectory, warm-up included; one starts at every sample.
    warmup : R, its measured samples that set the initial state.
    epochs : Passes over all windows (the paper's "training steps").
    batch_size : Windows to a step.
    learning_rate : Of Adam, at the beginning.
    milestones : `(epoch, learning rate)` pairs: the rate from that epoch on.
    one_cycle : The rate rises to `learning_rate` over the first tenth of the steps and falls along
        a cosine to a hundredth of it; in place of milestones.
    clip : Largest norm of a gradient.
    growth : Share of the training over which the free run grows from a tenth of its length to all.
    normalize : Scale each channel by mean and standard deviation of the training record.
    """

    window: int = 150
    warmup: int = 30
    epochs: int = 300
    batch_size: int = 50
    learning_rate: float = 1e-3
    milestones: tuple[tuple[int, float], ...] = ()
    one_cycle: bool = False
    clip: float | None = None
    growth: float = 0.0
    normalize: bool = True

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("warmup", "epochs", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.window <= self.warmup:
            raise ValueError(
                f"window must be longer than the warm-up of {self.warmup} samples, "
                f"got {self.window}"
            )
        for epoch, _ in self.milestones:
            if epoch < 0:
                raise ValueError(f"milestones must be at epochs from 0 on, got {epoch}")
        for rate in (self.learning_rate, *(rate for _, rate in self.milestones)):
            if not 0 < rate < float("inf"):
                raise ValueError(f"learning rates must be positive, got {rate}")
        if self.one_cycle and self.milestones:
            raise ValueError(f"milestones need one_cycle=False, got {self.milestones}")
        if self.clip is not None and not self.clip > 0:
            raise ValueError(f"clip must be positive, got {self.clip}")
        if not 0 <= self.growth <= 1:
            raise ValueError(f"growth must be a share of the training, 0 to 1, got {self.growth}")

    @classmethod
    def of(cls, samples: int) -> Settings:
        """The default recipe for a training record of so many samples; not in the paper.

        Windows of three fifths of it, at most 400; one cycle of the learning rate, clipped
        gradients, free runs that grow, and about `STEPS` steps for each network, one pass at least.
        """
        window = min(400, max(2, 3 * samples // 5))
        batch = 25
        batches = -(-max(samples - window + 1, 1) // batch)
        return cls(
            window,
            default_warmup(window),
            epochs=max(1, round(STEPS / batches)),
            batch_size=batch,
            learning_rate=3e-3,
            one_cycle=True,
            clip=1.0,
            growth=0.6,
        )

    def rate(self, epoch: int, share: float) -> float:
        """The learning rate in an epoch, when `share` (0 to 1) of all steps are done."""
        if self.one_cycle:
            rise = 0.1
            if share < rise:
                return self.learning_rate * (0.1 + 0.9 * share / rise)
            fall = 0.5 * (1 + math.cos(math.pi * (share - rise) / (1 - rise)))
            return self.learning_rate * (0.01 + 0.99 * fall)
        reached = [rate for start, rate in sorted(self.milestones) if start <= epoch]
        return reached[-1] if reached else self.learning_rate

    def reach(self, share: float, steps: int) -> int:
        """How many of a window's `steps` are simulated when `share` of all batches are done."""
        done = min(1.0, share / self.growth) if self.growth else 1.0
        return max(1, round(steps * (0.1 + 0.9 * done)))


def default_warmup(window: int, most: int = 50) -> int:
    """At most a third of the window, and no more than `most`."""
    return min(most, max(1, window // 3))


@dataclass(frozen=True)
class Progress:
    """Where a training run is: sent after each epoch."""

    task: str
    epoch: int
    epochs: int
    loss: float
    share: float
    """Of the whole training, 0 to 1."""


@dataclass
class History:
    """What a training run did: the mean loss of each epoch by task, and its run time."""

    losses: dict[str, list[float]] = field(default_factory=dict)
    seconds: float = 0.0


def fit(
    model: Model,
    trajectory: Trajectory,
    settings: Settings | None = None,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
) -> History:
    """Train a model in place (paper, Eqs. 12 and 14).

    Parameters
    ----------
    model : What to train; its initial parameters are the caller's.
    trajectory : The training record, and nothing else: cut it before.
    settings : How; `Settings.of` the record by default.
    seed : For the order of the windows.
    progress : Called after each epoch.

    Raises
    ------
    ValueError
        For a record shorter than a window, or of other channels than the model's.
    FloatingPointError
        When the loss is no longer finite.
    """
    settings = settings or Settings.of(len(trajectory))
    _check_record(model, trajectory, settings)
    model.adapt_to(trajectory, settings.normalize)
    began = time.perf_counter()
    history = History()
    record = model.normalised(trajectory)
    tasks = model.tasks(record)
    for done, task in enumerate(tasks):
        generator = torch.Generator().manual_seed(seed)  # a network does not depend on the others
        losses = history.losses.setdefault(task.name, [])
        for loss in _train(task, settings, generator):
            losses.append(loss)
            if progress is not None:
                share = (done + len(losses) / settings.epochs) / len(tasks)
                progress(Progress(task.name, len(losses), settings.epochs, loss, share))
    history.seconds = time.perf_counter() - began
    return history


def _train(task: Task, settings: Settings, generator: torch.Generator) -> Iterator[float]:
    """Train one network; yield the mean loss of each epoch."""
    known, target = _windows(task, settings)
    optimizer = torch.optim.Adam(task.network.parameters(), lr=settings.learning_rate)
    for epoch in range(settings.epochs):
        total = 0.0
        batches = torch.randperm(len(target), generator=generator).split(settings.batch_size)
        for i, batch in enumerate(batches):
            share = (epoch + i / len(batches)) / settings.epochs
            steps = settings.reach(share, target.shape[1])
            for group in optimizer.param_groups:
                group["lr"] = settings.rate(epoch, share)
            with one_torch_thread():
                seen, wanted = _select(known, batch), target[batch, :steps]
            optimizer.zero_grad(set_to_none=True)
            loss = _rmse(task.simulate(seen, steps), wanted)
            loss.backward()
            with one_torch_thread():
                if settings.clip is not None:
                    nn.utils.clip_grad_norm_(task.network.parameters(), settings.clip)
                optimizer.step()
            total += loss.item() * len(batch)
        mean = total / len(target)
        if not mean < float("inf"):
            raise FloatingPointError(
                f"training of the {task.name} diverged in epoch {epoch + 1}: the loss is {mean}; "
                f"lower the learning rate ({settings.learning_rate:g})"
            )
        yield mean


def _windows(task: Task, settings: Settings) -> tuple[Signals, Tensor]:
    """All windows of stride 1 as views: what is known of each, and what is to be reproduced."""

    def views(x: Tensor) -> Tensor:
        return x.unfold(0, settings.window, 1).transpose(1, 2)

    u, y_sim = (None if s is None else views(s) for s in (task.known.u, task.known.y_sim))
    known = Signals(views(task.known.y)[:, : settings.warmup], u, y_sim)
    return known, views(task.target)[:, settings.warmup :: task.stride]


def _select(known: Signals, batch: Tensor) -> Signals:
    u, y_sim = (None if s is None else s[batch] for s in (known.u, known.y_sim))
    return Signals(known.y[batch], u, y_sim)


def _rmse(prediction: Tensor, target: Tensor) -> Tensor:
    # A norm, not the root of a mean: its gradient at zero error is zero, not NaN.
    return torch.linalg.vector_norm(prediction - target) / target.numel() ** 0.5


def _check_record(model: Model, trajectory: Trajectory, settings: Settings) -> None:
    if (trajectory.ny, trajectory.nu) != (model.ny, model.nu):
        raise ValueError(
            f"the record must have the model's {model.ny} channel(s) and {model.nu} input(s), "
            f"got {trajectory.ny} and {trajectory.nu}"
        )
    if len(trajectory) < settings.window:
        raise ValueError(
            f"window must fit into the training record of {len(trajectory)} samples, "
            f"got {settings.window}"
        )
