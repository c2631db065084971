"""Define the candidates of a search: sizes and training settings, and the progress of each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from torch import Tensor

from splitband.data import Record
from splitband.forecasters.backtest import Backtest, for_trial
from splitband.forecasters.initialisation import Earlier, LinearPart
from splitband.forecasters.network import Network
from splitband.training import Settings

FIRST_STEPS = 300
"""Steps of Adam before L-BFGS takes over, from random weights."""
FREE_RUN_FROM_LINEAR = 150
"""Predicted samples of the shorter window that is tried for networks that begin as a linear model,
beside the recipe's window."""
FREE_RUNS_FROM_RANDOM = 100, 50
"""Predicted samples of the shorter windows that are tried for networks that begin with random
weights, beside the recipe's window."""
SHORT = 3000
"""Longest record, in samples, for which one window over all of it is tried, too."""
PENALTIES = 1e-4, 1e-3
"""Penalties to try; the second one only on records of up to `SHORT` samples."""
LADDER = 100, 400, 1600, 6400
"""Total iterations of L-BFGS: a candidate has had 100 after its first round, 400 after its second,
and so on. On records of more than `SHORT` samples, networks that begin as a linear model start with
the second."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Hold one method with one choice of sizes and training settings.

    Attributes
    ----------
    method, network : Name of the method, and the network with its settings.
    rung : Index of its round in `LADDER`; -1: no further round, as it is trained by Adam alone or
        has been dropped.
    score : RMSE of the seeds' median forecast of the held-out samples; infinite before training.
    done : Forecasts of the held-out samples, by seed.
    first_label : Label of its first round; empty until the second. Labels contain the iterations
        and change with each round; this one identifies the candidate.
    """

    method: str
    network: Network
    rung: int = -1
    score: float = math.inf
    done: Mapping[int, Backtest] = field(default_factory=dict)
    first_label: str = ""

    @property
    def label(self) -> str:
        """Return its name in progress bars and checkpoints."""
        return f"{self.method}, {self.network.training_in_words()}"

    @property
    def settings(self) -> Settings:
        """Return the training settings."""
        assert self.network.settings is not None
        return self.network.settings

    @property
    def iterations(self) -> int:
        """Return its total iterations of L-BFGS."""
        return self.settings.quasi_newton or 0

    def continued(self, more: int, weights: Mapping[int, Mapping[str, Tensor]]) -> Network:
        """Return the network set to continue from these weights, by seed, for `more` iterations."""
        settings = replace(self.settings, quasi_newton=self.iterations + more)
        return self.network.trained_as(settings).continued(Earlier(self.iterations, weights))

    def longer(self) -> Candidate | None:
        """Return the candidate of the next round; None where there is none."""
        if not 0 <= self.rung < len(LADDER) - 1:
            return None
        weights = {seed: done.weights for seed, done in self.done.items()}
        network = self.continued(LADDER[self.rung + 1] - self.iterations, weights)
        first_label = self.first_label or self.label
        return replace(self, network=network, rung=self.rung + 1, done={}, first_label=first_label)

    def options(self) -> dict[str, Any]:
        """Return all options that may differ between candidates: cells and training settings."""
        return {**self.network.get_params(), **vars(self.settings)}


def combined(usual: Candidate, best: Candidate, other: Candidate) -> Candidate | None:
    """Return the usual candidate with the changes of both others.

    None where both change the same option, or `other` changes none.
    """
    # As text: cells are modules, which equal only themselves.
    unchanged = {name: str(value) for name, value in usual.options().items()}
    ours, theirs = (
        {name: value for name, value in each.options().items() if str(value) != unchanged[name]}
        for each in (best, other)
    )
    ours.pop("settings", None)
    theirs.pop("settings", None)
    if not theirs or ours.keys() & theirs.keys():
        return None
    of_training = {name: value for name, value in theirs.items() if name in vars(best.settings)}
    of_network = {name: value for name, value in theirs.items() if name not in of_training}
    network = best.network.clone().set_params(**of_network)
    network = network.trained_as(replace(best.settings, **of_training))
    rung = max(best.rung, other.rung)
    return replace(usual, network=network, rung=rung, score=math.inf, done={})


def candidates(
    forecaster: Network, record: Record, others: Sequence[Record] = ()
) -> list[Candidate]:
    """Return the candidates for training a network on a record, the most promising one first.

    A network that begins as a linear model needs no steps of Adam. Its candidates differ from the
    first one in size, window, penalty or start, one at a time. On long records they begin with the
    iterations of the second round, as an iteration of such a small network is quick. For other
    networks, the first candidate is the default recipe, by Adam alone.
    """
    usual, samples = forecaster.settings, len(record)
    assert usual is not None
    steps = max(1, round(FIRST_STEPS / usual.batches_of(samples)))
    finished = replace(usual, epochs=steps, quasi_newton=LADDER[0])
    size, *sizes = _sizes(forecaster)
    if record.nu and all(isinstance(cell, LinearPart) for cell in _cells(forecaster)):
        rung = int(samples > SHORT)
        window = min(usual.warmup + FREE_RUN_FROM_LINEAR, usual.window)
        base = replace(finished, window=window, epochs=0, quasi_newton=LADDER[rung])
        settings = [base, replace(base, window=usual.window), replace(base, penalty=PENALTIES[0])]
        if samples <= SHORT:
            settings.append(replace(base, penalty=PENALTIES[1]))
        if samples <= min([SHORT, *map(len, others)]):
            settings.append(replace(base, window=samples, penalty=PENALTIES[0]))
        settings.append(replace(base, epochs=steps, linear_start=False))
        every = [(size, each) for each in settings] + [(other, base) for other in sizes]
        found = []
    else:
        rung = 0
        windows = {
            min(usual.warmup + free, usual.window)
            for free in (*FREE_RUNS_FROM_RANDOM, usual.window)
        }
        settings = [replace(finished, window=window) for window in sorted(windows)]
        every = [(other, each) for each in settings for other in (sizes or [size])]
        every += [(other, replace(settings[0], penalty=PENALTIES[0])) for other in sizes[-1:]]
        found = [Candidate(forecaster.name, size.trained_as(usual))]
    found += [Candidate(forecaster.name, n.trained_as(how), rung) for n, how in every]
    distinct: dict[str, Candidate] = {}
    for candidate in found:  # windows may become equal on the shorter record of a trial
        distinct.setdefault(for_trial(candidate.network, samples).training_in_words(), candidate)
    return [*distinct.values()]


def _cells(forecaster: Network) -> list[Any]:
    return [getattr(forecaster, name) for name in forecaster.cells]


def _sizes(forecaster: Network) -> list[Network]:
    """Return the network with each size of its cells to try, the usual one first."""
    cells = _cells(forecaster)
    if not forecaster.resizable or not all(hasattr(cell, "variants") for cell in cells):
        return [forecaster.clone()]
    every = zip(*(cell.variants() for cell in cells), strict=True)
    return [
        forecaster.clone().set_params(**dict(zip(forecaster.cells, sized, strict=True)))
        for sized in every
    ]
