"""What several test files ask of the library by the names of methods."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from torch import Tensor, nn

from splitband import Forecaster, Record
from splitband.comparison.backtest import BacktestSpec, Fit, backtest, first_origin
from splitband.comparison.result import Comparison
from splitband.comparison.run import compare as compared
from splitband.forecasters.held_out import Origin
from splitband.forecasters.loading import load
from splitband.forecasters.network import Network
from splitband.forecasters.saving import FILE
from splitband.models import Model
from splitband.runtime.arrays import Array
from tests.signals import Setup


def simulated(model: Model, y: Array, steps: int, u: Any = None, y_sim: Any = None) -> Array:
    """What a model says after a warm-up, its components added."""
    total: Array = np.sum([*model.simulate_components(y, steps, u, y_sim).values()], axis=0)
    return total


def untrained(name: str, record: Record, setup: Setup, seed: int) -> Model:
    """The model of a method, its weights drawn from the seed."""
    network = setup.forecaster(name)
    assert isinstance(network, Network)
    return network._built(record, setup.settings, seed)


def asked(
    name: str,
    record: Record,
    setup: Setup,
    seed: int = 0,
    later: Sequence[int] = (),
    others: Sequence[Record] = (),
) -> Fit:
    """Both protocols, and forecasts from `later` samples by the same fit."""
    forecaster = setup.forecaster(name)
    forecaster.check(record[: setup.train], *others)
    origins = {
        first_origin(record, setup.train, setup.settings.warmup),
        Origin(setup.train, setup.train),
        *(Origin(setup.train, at) for at in later),
    }
    return backtest(forecaster, BacktestSpec(record, sorted(origins), others), seed)


def compare(
    record: Record,
    names: Sequence[Forecaster | str],
    setup: Setup,
    seeds: int = 1,
    **options: Any,
) -> Comparison:
    """Methods by name, under both protocols, trained as the setup says."""
    return compared(record, setup.train, names, seeds=seeds, **setup.options, **options)


def known_after(record: Record, at: int) -> dict[str, Any]:
    """Return inputs and simulator's output of a record from a sample on, for `predict`."""
    return {
        name: None if signal is None else signal[at:]
        for name, signal in (("u", record.u), ("y_sim", record.y_sim))
    }


def with_other_samples(record: Record, start: int, stop: int | None = None) -> Record:
    """A record of which other samples were measured from index `start` on."""
    y = record.y.copy()
    y[start:stop] += 25.0
    return replace(record, y=y)


class SlowClock:
    """Stands in for the module `time`: a machine on which each look at the clock takes a while.

    Deadlines (`runtime.deadlines`) are then over after so many looks, however fast the machine is.
    """

    def __init__(self, tick: float) -> None:
        self.tick, self.at = tick, 1e9

    def time(self) -> float:
        self.at += self.tick
        return self.at


def slowed(monkeypatch: pytest.MonkeyPatch, tick: float) -> SlowClock:
    """Let deadlines look at a slow clock."""
    clock = SlowClock(tick)
    monkeypatch.setattr("splitband.runtime.deadlines.time", clock)
    return clock


def load_model(folder: Path) -> tuple[Model, dict[str, Any]]:
    """The model of a saved network, and the facts that were saved with it."""
    network, facts = load(folder), json.loads((folder / FILE).read_text())
    assert isinstance(network, Network)
    return network.model, facts


class Scripted(nn.Module):
    """A cell that says what it was told, from entry `after` on, and keeps its inputs."""

    ny = 1

    def __init__(self, script: Tensor, after: int, nu: int = 0) -> None:
        super().__init__()
        self.script, self.after, self.nu = nn.Parameter(script), after, nu
        self.inputs: list[Tensor] = []

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> int:
        self.batch = len(y_warmup)
        self.inputs = [] if u is None else [*u.unbind(dim=1)]
        return self.after

    def step(self, h: int, y: Tensor, u: Tensor | None = None) -> int:
        if u is not None:
            self.inputs.append(u)
        return h + 1

    def observe(self, h: int) -> Tensor:
        return self.script[h].expand(self.batch, 1)


def edit(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Change the description of a saved forecaster."""
    path = folder / "forecaster.json"
    description = json.loads(path.read_text())
    change(description)
    path.write_text(json.dumps(description))


def with_own_predictions(model: Any, y: Any, warmup: int) -> Any:
    """Samples whose missing channels are a network's predictions from the samples before each."""
    y = np.array(y)
    for n in range(warmup, len(y)):
        if np.isnan(y[n]).any() and np.isfinite(y[n - warmup : n]).all():
            y[n] = np.where(np.isnan(y[n]), simulated(model, y[n - warmup : n], 1)[0], y[n])
    return y
