"""Train system (i) under a reading of the text, and keep what came out."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from benchmarks import study
from reproduction.bands import HIGH, LOW, Bands, networks_of
from reproduction.readings import COLUMN, Reading
from splitband.metrics import rmse
from splitband.models import Model, Recurrent
from splitband.models.base import Signals
from splitband.training import Progress, Settings, fit

Array = npt.NDArray[np.float64]
NETWORKS = ("gru", "split-gru", "split-gru-hp")
NAIVE = ("persistence", "seasonal-naive", "harmonic")
EVALUATIONS = 300
"""Epochs, at most, after which the free run of the whole record is compared with the truth."""


def settings_of(method: str, reading: Reading) -> Settings:
    """Return the paper's settings with what a reading changes."""
    settings = Settings(COLUMN.window, COLUMN.warmup, COLUMN.epochs_of(method), normalize=False)
    return replace(settings, **reading.training.changes)


class Watch:
    """Keep the free run after each epoch, and the weights of the lowest training loss."""

    def __init__(self, networks: dict[str, nn.Module], part: Callable[[str], Array]) -> None:
        self.networks, self.part = networks, part
        self.runs: dict[str, dict[int, Array]] = {name: {} for name in networks}
        self.losses: dict[str, list[float]] = {name: [] for name in networks}
        self.best: dict[str, dict[str, Tensor]] = {}

    def __call__(self, at: Progress) -> None:
        """See an epoch."""
        if at.loss < min(self.losses[at.task], default=np.inf):
            self.best[at.task] = deepcopy(self.networks[at.task].state_dict())
        self.losses[at.task].append(at.loss)
        if at.epoch % max(1, at.epochs // EVALUATIONS) == 0:
            self.runs[at.task][at.epoch] = self.part(at.task)

    def errors(self, truth: Array) -> dict[int, float]:
        """Return the RMSE of the free run by epoch, all networks being those after it."""
        epochs = min(self.runs.values(), key=len)
        return {
            epoch: rmse(truth, np.sum([runs[epoch] for runs in self.runs.values()], axis=0))
            for epoch in epochs
        }

    def restore(self) -> None:
        """Put the weights of the lowest training loss back."""
        for name, network in self.networks.items():
            network.load_state_dict(self.best[name])


class Trial:
    """A method on (i) under a reading: the record, an untrained model, and its free runs.

    Parameters
    ----------
    method : Out of `NETWORKS`.
    reading : What the paper's text is taken to say.
    seed : Of the initial weights.
    draw : Of the noise.
    """

    def __init__(self, method: str, reading: Reading, seed: int, draw: int) -> None:
        self.reading, self.settings = reading, settings_of(method, reading)
        self.record = reading.record(draw)
        networks = networks_of(method, reading, seed)
        self.networks: dict[str, nn.Module]
        self.model: Model
        if method == "gru":
            self.model, self.networks = Recurrent(networks[0]), {"network": networks[0]}
            self.signal, factor = self.record, 1
        else:
            rate, filter_output = self.record.sampling_rate, method.endswith("-hp")
            self.model = bands = Bands(networks, reading, rate, filter_output)
            self.networks = {LOW: networks[0], HIGH: networks[1]}
            if reading.training.summed:
                self.networks = {"sum": bands.networks}
            self.signal, factor = reading.filtering.bands(self.record), reading.training.low_warmup
        self.begin = factor * self.settings.warmup

    def fit(self, seed: int, watch: Watch) -> dict[str, list[float]]:
        """Train one network after the other, each with its own warm-up; return the losses."""
        known = self.signal[: COLUMN.train]
        if not isinstance(self.model, Bands) or self.reading.training.summed:
            return fit(self.model, known, self.settings, seed, watch).losses
        losses: dict[str, list[float]] = {}
        for name, warmup in ((LOW, self.begin), (HIGH, self.settings.warmup)):
            self.model.trained = [name]
            own = replace(self.settings, warmup=warmup)
            losses |= fit(self.model, known, own, seed, watch).losses
        return losses

    def from_start(self, part: str = "") -> Array:
        """Return the free run after the first warm-up, or a part of it, `(steps, 1)`."""
        return self._free_run(self.signal.y[: self.begin], part)

    def forecast(self) -> Array:
        """Return the free run after the training part, which knows no later sample."""
        trained = self.signal.y
        if isinstance(self.model, Bands):
            trained = self.reading.filtering.bands(self.record, COLUMN.train).y
        return self._free_run(trained[: COLUMN.train])

    def parts_rmse(self) -> dict[str, float]:
        """Return the error of each band after the first warm-up."""
        if not isinstance(self.model, Bands):
            return {}
        truth = self.record.truth
        low = self.model.pair.lowpass(truth)
        return {
            name: rmse(band[self.begin :], self.from_start(name))
            for name, band in ((LOW, low), (HIGH, truth - low))
        }

    def _free_run(self, y: Array, part: str = "") -> Array:
        steps, model = len(self.record) - len(y), self.model

        def history(samples: int) -> Signals:
            return Signals(torch.tensor(y[None, len(y) - samples :], dtype=torch.float32))

        with torch.no_grad():
            if not isinstance(model, Bands):
                return _array(model.components(history(self.begin), steps)["network"])
            runs: dict[str, Callable[[], Tensor]] = {
                LOW: lambda: model.low_at_full_rate(history(self.begin), steps),
                HIGH: lambda: model.high(history(self.settings.warmup), steps),
            }
            chosen = [run() for name, run in runs.items() if part in ("", "sum", name)]
            return _array(torch.stack(chosen).sum(dim=0))


def _array(values: Tensor) -> Array:
    return np.asarray(values[0].double().numpy())


def tried(method: str, reading: Reading, seed: int, draw: int = 0) -> study.Facts:
    """Train a method on (i) under a reading; return its errors and the time it took.

    `total_rmse` is that of the free run after the warm-up at the last epoch; `best` has the weights
    of each network's lowest training loss, `lowest` the epoch with the lowest error, which only a
    reader of the test samples knows.
    """
    began = time.process_time()
    trial = Trial(method, reading, seed, draw)
    truth = trial.record.truth
    watch = Watch(trial.networks, trial.from_start)
    losses = trial.fit(0 if reading.training.fixed == "order" else seed, watch)
    errors = watch.errors(truth[trial.begin :])
    low = min(errors, key=lambda epoch: errors[epoch])
    last = {
        "total_rmse": rmse(truth[trial.begin :], trial.from_start()),
        "forecast_rmse": rmse(truth[COLUMN.train :], trial.forecast()),
        "parts_rmse": trial.parts_rmse(),
    }
    watch.restore()
    return {
        "method": method,
        "draw": draw,
        **last,
        "best": rmse(truth[trial.begin :], trial.from_start()),
        "lowest": errors[low],
        "lowest_epoch": low,
        "errors": study.few([*errors.values()]),
        "late_deviation": float(np.std([*errors.values()][-len(errors) // 10 :])),
        "losses": {name: study.final(values) for name, values in losses.items()},
        "reading": asdict(reading),
        **study.facts(seed, trial.settings, began),
    }


def path_of(out: Path, method: str, name: str, seed: int, draw: int = 0) -> Path:
    """Return the file of a run."""
    own = study.path_of(out / method, name, seed)
    return own if not draw else own.with_name(own.name.replace("-seed", f"-draw{draw}-seed"))


def quick(method: str, forecaster: Any, reading: Reading, draw: int) -> study.Facts:
    """Return the errors of what needs no training: a baseline, or the oracle."""
    record = reading.record(draw)
    fitted = forecaster.fit(record[: COLUMN.train])
    errors = {}
    for key, begin in (("total_rmse", COLUMN.warmup), ("forecast_rmse", COLUMN.train)):
        predicted = fitted.predict(len(record) - begin, record[:begin]).y
        errors[key] = rmse(record.truth[begin:], predicted)
    return {"method": method, "draw": draw, **errors, "reading": asdict(reading)}
