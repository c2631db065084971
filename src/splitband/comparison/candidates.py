"""Define the candidates of a search: sizes and training settings, and the progress of each."""

from __future__ import annotations

import math
from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from splitband.comparison.backtest import Fit
from splitband.forecasters.base import cells_of
from splitband.forecasters.held_out import HELD_OUT_SHARE
from splitband.forecasters.initialisation import LinearPart
from splitband.forecasters.network import Network
from splitband.records import Record
from splitband.training import TrainingSettings
from splitband.training.settings import ROUND

FIRST_STEPS = 300
"""Steps of Adam before L-BFGS takes over, from random weights."""
FIRST_ROUND, FIRST_SAMPLES = 100, 20_000
"""Iterations of L-BFGS in the first round of a candidate, and samples in each of them. On records
of more than `SHORT_RECORD` samples, networks that begin as a linear model have `LONGER` times as
many, as an iteration of such a small network is quick."""
LONGER = 4
"""A round trains this many times as long as all rounds before it together."""
FREE_RUN_FROM_LINEAR = 150
"""Predicted samples of the shorter window that is tried for networks that begin as a linear model,
beside the recipe's window."""
FREE_RUNS_FROM_RANDOM = 100, 50
"""Predicted samples of the shorter windows that are tried for networks that begin with random
weights, beside the recipe's window."""
SHORT_RECORD = 3000
"""Longest record, in samples, for which one window over all of it is tried, too."""
PENALTIES = 1e-4, 1e-3
"""Penalties to try; the second one only on records of up to `SHORT_RECORD` samples."""


LEAST_IMPROVEMENT = 0.01
"""A round that lowers the held-out error by less than this share of it has changed nothing."""
FINAL_SHARE = 0.25
"""Iterations of a final training, which goes on on all samples, as a share of those before. Four
times as many change no error by the whole command (docs/developers/rules.md)."""


@dataclass(eq=False)
class Candidate:
    """Hold a method with one choice of sizes, training settings and seed, and how far it is."""

    network: Network  # untrained, with the settings of the first round, for the whole training part
    seed: int = 0  # of its initial weights
    fits: list[Fit] = field(default_factory=list)  # one for each round that it was trained in
    scores: list[float] = field(default_factory=list)  # held-out, after each; inf for a failure

    @property
    def method(self) -> str:
        """Return the name of its method."""
        return self.network.name

    @property
    def settings(self) -> TrainingSettings:
        """Return the settings of its first round."""
        assert self.network.settings is not None
        return self.network.settings

    @property
    def score(self) -> float:
        """Return its lowest held-out error; infinite before the first round."""
        return min(self.scores, default=math.inf)

    @property
    def best(self) -> int:
        """Return the index of the round with that error."""
        return self.scores.index(self.score)

    @property
    def seconds(self) -> float:
        """Return how long its last round took."""
        return self.fits[-1].seconds

    @property
    def final_seconds(self) -> float:
        """Return how long its final training takes: what its share of the iterations took.

        Without the forecasts after it.
        """
        took = sum(fit.report.seconds for fit in self.fits[: self.best + 1])
        return FINAL_SHARE * took / (1 - HELD_OUT_SHARE)

    @property
    def progressed(self) -> bool:
        """Return whether its last round lowered the error by more than `LEAST_IMPROVEMENT`."""
        before = (1 - LEAST_IMPROVEMENT) * min(self.scores[:-1], default=math.inf)
        return bool(self.scores) and self.scores[-1] < before

    def forget(self, but: Container[int] = ()) -> None:
        """Drop forecasts, which take most of the memory, but for those of some rounds."""
        self.fits = [
            fit if i in but else replace(fit, forecasts={}) for i, fit in enumerate(self.fits)
        ]

    def next(self) -> Network:
        """Return the network with the settings of its next round."""
        done, first = len(self.fits), self.settings.lbfgs_iterations or 0
        return self.going_on(LONGER * first * (1 + LONGER) ** (done - 1)) if done else self.network

    def final(self) -> Network:
        """Return the network with the settings of its final training, on all samples."""
        done = sum(_iterations(fit) for fit in self.fits[: self.best + 1])
        return self.going_on(max(round(FINAL_SHARE * done), 1))

    def going_on(self, iterations: int) -> Network:
        """Return the network with settings to go on for so many iterations of L-BFGS."""
        usual = TrainingSettings.max_samples
        more = replace(self.settings, epochs=0, lbfgs_iterations=iterations, max_samples=usual)
        return self.network.trained_as(more)

    def options(self) -> dict[str, str]:
        """Return, as text, all options that may differ between candidates of a method."""
        # As text: cells are modules, which equal only themselves.
        found: dict[str, Any] = {**self.network.get_params(), **vars(self.settings)}
        return {name: str(value) for name, value in found.items() if name != "settings"}


def _iterations(fit: Fit) -> int:
    """Return the iterations of L-BFGS that a training has run before it settled or was cut."""
    settings = fit.fitted.settings
    assert settings is not None
    losses = fit.report.losses.values()
    rounds = max((len(of_network) - settings.epochs for of_network in losses), default=0)
    return min(max(rounds, 1) * ROUND, settings.lbfgs_iterations or 0)


def combined(usual: Candidate, best: Candidate, other: Candidate) -> Candidate | None:
    """Return a candidate with the changes of both `best` and `other` against the usual one.

    None where both change the same option, or `other` changes none.
    """
    unchanged = usual.options()
    ours, theirs = (
        {name for name, value in each.options().items() if value != unchanged[name]}
        for each in (best, other)
    )
    if not theirs or ours & theirs:
        return None
    trained = {name: getattr(other.settings, name) for name in theirs & {*vars(best.settings)}}
    network = best.network.clone()
    network.set_params(
        **{name: getattr(other.network, name) for name in theirs - {*vars(best.settings)}}
    )
    trained_as = network.trained_as(replace(best.settings, **trained))
    return Candidate(trained_as, usual.seed)


def candidates(
    forecaster: Network, sized: bool, record: Record, others: Sequence[Record], seed: int
) -> list[Candidate]:
    """Return the candidates for training a network on a record, the most promising one first.

    A network that begins as a linear model needs no steps of Adam. Its candidates differ from
    the first one in size (if `sized`), window, penalty or start, one at a time. Other networks
    begin with steps of Adam; their candidates differ in window and size.
    """
    usual, samples = forecaster.settings, len(record)
    assert usual is not None
    steps = max(1, round(FIRST_STEPS / usual.batches_of(samples)))
    first = replace(usual, epochs=steps, lbfgs_iterations=FIRST_ROUND, max_samples=FIRST_SAMPLES)
    size, *sizes = _sizes(forecaster) if sized else [forecaster]
    if record.nu and all(isinstance(cell, LinearPart) for cell in cells_of(forecaster).values()):
        window = min(usual.warmup + FREE_RUN_FROM_LINEAR, usual.window)
        iterations = FIRST_ROUND * (1 if samples <= SHORT_RECORD else LONGER)
        base = replace(first, window=window, epochs=0, lbfgs_iterations=iterations)
        settings = [base, replace(base, window=usual.window), replace(base, l2=PENALTIES[0])]
        if samples <= SHORT_RECORD:
            settings.append(replace(base, l2=PENALTIES[1]))
        if samples <= min([SHORT_RECORD, *map(len, others)]):
            settings.append(replace(base, window=samples, l2=PENALTIES[0]))
        settings.append(replace(base, epochs=steps, linear_start=False))
        every = [(size, each) for each in settings] + [(other, base) for other in sizes]
    else:
        windows = {
            min(usual.warmup + free, usual.window)
            for free in (*FREE_RUNS_FROM_RANDOM, usual.window)
        }
        settings = [replace(first, window=window) for window in sorted(windows)]
        every = [(other, each) for each in settings for other in (sizes or [size])]
        every += [(other, replace(settings[0], l2=PENALTIES[0])) for other in sizes[-1:]]
    distinct: dict[str, Candidate] = {}
    for network, how in every:  # windows may become equal on the shorter record of a trial
        shorter = network.trained_as(how).for_trial(samples)
        candidate = Candidate(network.trained_as(how), seed)
        distinct.setdefault(shorter.training_in_words(), candidate)
    return [*distinct.values()]


def _sizes(forecaster: Network) -> list[Network]:
    """Return the network with each size of its cells to try, the usual one first."""
    cells: dict[str, Any] = {**cells_of(forecaster)}
    if not all(hasattr(cell, "variants") for cell in cells.values()):
        return [forecaster.clone()]
    every = zip(*(cell.variants() for cell in cells.values()), strict=True)
    return [
        forecaster.clone().set_params(**dict(zip(cells, sized, strict=True))) for sized in every
    ]
