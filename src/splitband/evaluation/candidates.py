"""Define what a search tries: ways to train a network, and how far each has come."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

from splitband.data import Record
from splitband.forecasters.backtest import Backtest, for_trial
from splitband.forecasters.beginning import Earlier, LinearPart
from splitband.forecasters.network import Network
from splitband.training import Settings

FIRST_STEPS = 300
"""Steps of Adam before L-BFGS takes over, from random weights."""
FREE_RUN, FREE_RUNS = 150, (100, 50)
"""Samples of the shorter windows that are predicted, from a linear model and from random weights;
the longest windows are the recipe's."""
SHORT = 3000
"""Samples of a record up to which windows of all of it are tried, too."""
PENALTIES = 1e-4, 1e-3
"""The penalties that are tried, the second one on records of up to `SHORT` samples."""
LADDER = 100, 400, 1600, 6400
"""Iterations of L-BFGS that a candidate has had after each round."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Hold one way to train one method.

    Attributes
    ----------
    method, network : Its name, and the forecaster with its settings.
    rung : Rounds of L-BFGS that it has had; -1 for a training without.
    score : RMSE of the mean of its seeds on the held-out samples; infinite where it has not been
        trained.
    done : Forecasts of the held-out samples, by seed.
    began_as : Label of the candidate that it goes on from.
    """

    method: str
    network: Network
    rung: int = -1
    score: float = math.inf
    done: Mapping[int, Backtest] = field(default_factory=dict)
    began_as: str = ""

    @property
    def label(self) -> str:
        """Return what progress bars and checkpoints call it."""
        return f"{self.method}, {self.network.training_in_words()}"

    @property
    def settings(self) -> Settings:
        """Return how the network is trained."""
        assert self.network.settings is not None
        return self.network.settings

    @property
    def trained(self) -> int:
        """Return its iterations of L-BFGS."""
        return self.settings.quasi_newton or 0

    def going_on(self, iterations: int, weights: Mapping[int, Mapping[str, Tensor]]) -> Network:
        """Return the network, trained for more iterations from these weights, by seed."""
        settings = replace(self.settings, quasi_newton=self.trained + iterations)
        return self.network.trained_as(settings).going_on(Earlier(self.trained, weights))

    def longer(self) -> Candidate | None:
        """Return the candidate of the next round; None where there is none."""
        if not 0 <= self.rung < len(LADDER) - 1:
            return None
        weights = {seed: done.weights for seed, done in self.done.items()}
        network = self.going_on(LADDER[self.rung + 1] - self.trained, weights)
        began_as = self.began_as or self.label
        return replace(self, network=network, rung=self.rung + 1, done={}, began_as=began_as)

    def options(self) -> dict[str, Any]:
        """Return all in which candidates of a method differ: cells, and how they are trained."""
        return {**self.network.get_params(), **vars(self.settings)}


def combined(first: Candidate, one: Candidate, other: Candidate) -> Candidate | None:
    """Return the candidate that differs from the first one as both others do.

    None where they differ from it in the same option.
    """
    usual = {name: str(value) for name, value in first.options().items()}
    ours, theirs = (
        {name: value for name, value in each.options().items() if str(value) != usual[name]}
        for each in (one, other)
    )
    ours.pop("settings", None)
    theirs.pop("settings", None)
    if not theirs or ours.keys() & theirs.keys():
        return None
    of_training = {name: value for name, value in theirs.items() if name in vars(one.settings)}
    of_network = {name: value for name, value in theirs.items() if name not in of_training}
    network = one.network.clone().set_params(**of_network)
    network = network.trained_as(replace(one.settings, **of_training))
    return replace(first, network=network, rung=max(one.rung, other.rung), score=math.inf, done={})


def candidates(forecaster: Network, record: Record) -> list[Candidate]:
    """Return ways to train a network on a record, the most promising one first.

    An iteration of a small state-space network is quick: on long records it has more of them.

    A network that begins as a linear model needs no steps of Adam, and differs in size, window and
    penalty from the first candidate, one at a time. From random weights there is also the default
    recipe, by Adam alone.
    """
    usual, samples = forecaster.settings, len(record)
    assert usual is not None
    steps = max(1, round(FIRST_STEPS / usual.batches_of(samples)))
    finished = replace(usual, epochs=steps, quasi_newton=LADDER[0])
    size, *sizes = _sizes(forecaster)
    if record.nu and all(isinstance(cell, LinearPart) for cell in _cells(forecaster)):
        rung = int(samples > SHORT)
        window = min(usual.warmup + FREE_RUN, usual.window)
        base = replace(finished, window=window, epochs=0, quasi_newton=LADDER[rung])
        settings = [base, replace(base, window=usual.window), replace(base, penalty=PENALTIES[0])]
        if samples <= SHORT:
            settings.append(replace(base, penalty=PENALTIES[1]))
            settings.append(replace(base, window=samples, penalty=PENALTIES[0]))
        settings.append(replace(base, epochs=steps, linear_start=False))
        every = [(size, each) for each in settings] + [(other, base) for other in sizes]
        found = []
    else:
        rung = 0
        windows = {min(usual.warmup + free, usual.window) for free in (*FREE_RUNS, usual.window)}
        settings = [replace(finished, window=window) for window in sorted(windows)]
        every = [(other, each) for each in settings for other in (sizes or [size])]
        every += [(other, replace(settings[0], penalty=PENALTIES[0])) for other in sizes[-1:]]
        found = [Candidate(forecaster.name, size.trained_as(usual))]
    found += [Candidate(forecaster.name, n.trained_as(how), rung) for n, how in every]
    distinct: dict[str, Candidate] = {}
    for candidate in found:  # windows that differ may be one on the shorter record of a trial
        distinct.setdefault(for_trial(candidate.network, samples).training_in_words(), candidate)
    return [*distinct.values()]


def _cells(forecaster: Network) -> list[Any]:
    return [getattr(forecaster, name) for name in forecaster.cells]


def _sizes(forecaster: Network) -> list[Network]:
    """Return it with cells of other sizes that are worth trying, the usual ones first."""
    cells = _cells(forecaster)
    if not forecaster.resizable or not all(hasattr(cell, "variants") for cell in cells):
        return [forecaster.clone()]
    every = zip(*(cell.variants() for cell in cells), strict=True)
    return [
        forecaster.clone().set_params(**dict(zip(forecaster.cells, sized, strict=True)))
        for sized in every
    ]
