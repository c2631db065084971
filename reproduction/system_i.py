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
from reproduction.readings import COLUMN, Reading
from splitband.data import Trajectory
from splitband.filters.resampling import downsample, upsample
from splitband.metrics import rmse
from splitband.models import Model, Recurrent
from splitband.models.base import Signals, Task
from splitband.networks import GRU, Cell, rollout
from splitband.training import Progress, Settings, fit

Array = npt.NDArray[np.float64]
NETWORKS = ("gru", "split-gru", "split-gru-hp")
NAIVE = ("persistence", "seasonal-naive", "harmonic")
LOW, HIGH = "low band", "high band"
EVALUATIONS = 300
"""Epochs, at most, after which the free run of the whole record is compared with the truth."""


class Bands(Model):
    """Two networks on a record whose two channels are the bands of a signal.

    Parameters
    ----------
    networks : Of the low and the high band, one channel each.
    reading : What is done with the bands.
    sampling_rate : In Hz.
    filter_output : Whether the prediction of the high band is high-passed, the paper's "+HP".
    """

    def __init__(
        self, networks: list[GRU], reading: Reading, sampling_rate: float, filter_output: bool
    ) -> None:
        super().__init__(2, 0)
        self.networks = nn.ModuleList(networks)
        self.reading, self.filter_output = reading, filter_output
        self.pair = reading.filtering.pair(sampling_rate)
        self.trained: list[str] = []

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return both bands at the full rate, `(batch, steps, 1)`."""
        return {LOW: self.low_at_full_rate(known, steps), HIGH: self.high(known, steps)}

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the bands in `trained`, or their sum."""
        if self.reading.training.summed:
            target = record.y.sum(dim=1, keepdim=True)
            return [Task("sum", self.networks, record, target, self._sum)]
        k = self.reading.resampling.k
        tasks = [
            Task(LOW, self.networks[0], record, self._low_target(record.y), self._low, k),
            Task(HIGH, self.networks[1], record, record.y[:, 1:], self.high),
        ]
        return [task for task in tasks if task.name in self.trained]

    def _sum(self, known: Signals, steps: int) -> Tensor:
        return self.low_at_full_rate(known, steps) + self.high(known, steps)

    def _low_target(self, y: Tensor) -> Tensor:
        low, resampling = y[:, :1], self.reading.resampling
        if not resampling.mean:
            return low
        padded = torch.cat([low, low[-1:].expand(resampling.k - 1, 1)])
        return padded.unfold(0, resampling.k, 1).mean(dim=-1)

    def _history(self, known: Signals) -> tuple[Tensor, Tensor]:
        if not self.reading.filtering.own_warmup:
            return known.y[..., :1], known.y[..., 1:]
        y = known.y.sum(dim=-1, keepdim=True)
        low = self.pair.lowpass(y)
        return low, y - low

    def _low(self, known: Signals, steps: int) -> Tensor:
        history, k = self._history(known)[0], self.reading.resampling.k
        offset = history.shape[1] % k
        slow = downsample(history, k, offset)
        if self.reading.resampling.mean:
            slow = history[:, offset:].unflatten(1, (-1, k)).mean(dim=2)
        return self._rollout(0, slow, steps)

    def low_at_full_rate(self, known: Signals, steps: int) -> Tensor:
        """Return the free run of the low band, `(batch, steps, 1)`."""
        k, align = self.reading.resampling.k, self.reading.resampling.align
        return upsample(self._low(known, (steps - 2) // k + 2), k, steps, align)

    def high(self, known: Signals, steps: int) -> Tensor:
        """Return the free run of the high band, `(batch, steps, 1)`."""
        history = self._history(known)[1]
        y = self._rollout(1, history, steps)
        if not self.filter_output:
            return y
        if self.reading.hp_alone:
            return self._highpass(y)
        return self._highpass(torch.cat([history, y], dim=1))[:, history.shape[1] :]

    def _highpass(self, y: Tensor) -> Tensor:
        high = self.pair.highpass(y)
        return high.clamp(-1.0, 1.0) if self.reading.filtering.clamp else high

    def _rollout(self, band: int, history: Tensor, steps: int) -> Tensor:
        if self.reading.training.twice:
            history = torch.cat([history, history[:, -1:]], dim=1)
        cell: Cell = self.networks[band]  # type: ignore[assignment]
        return rollout(cell, history, steps)


Prediction = Callable[[int, int], dict[str, Array]]
"""Gives the parts `(time, 1)` of a free run by its first sample and its number of samples."""


def settings_of(method: str, reading: Reading) -> Settings:
    """Return the paper's settings with what a reading changes."""
    settings = Settings(COLUMN.window, COLUMN.warmup, COLUMN.epochs_of(method), normalize=False)
    return replace(settings, **reading.training.changes)


def networks_of(method: str, reading: Reading, seed: int) -> list[GRU]:
    """Return untrained networks, the low band's first, with the weights of the package's own."""
    torch.manual_seed(0 if reading.training.fixed == "weights" else seed)
    sizes = [COLUMN.hidden_low, COLUMN.hidden_high]
    if method == "gru":
        sizes = [sum(sizes)]
    networks = [GRU(size) for size in (sizes[::-1] if reading.large_low else sizes)]
    for network in networks:
        _set_weights(network, reading.training.weights)
    return networks


def _set_weights(network: GRU, kind: str) -> None:
    for name, values in network.named_parameters():
        if kind == "orthogonal" and name == "transition.weight_hh":
            for gate in values.data.chunk(3):
                nn.init.orthogonal_(gate)
        if kind == "zero biases" and "bias" in name:
            nn.init.zeros_(values)


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


def tried(method: str, reading: Reading, seed: int, draw: int = 0) -> study.Facts:
    """Train a method on (i) under a reading; return its errors and the time it took.

    `total_rmse` is that of the free run after the warm-up at the last epoch; `best` has the weights
    of each network's lowest training loss, `lowest` the epoch with the lowest error, which only a
    reader of the test samples knows.
    """
    record, settings = reading.record(draw), settings_of(method, reading)
    networks = networks_of(method, reading, seed)
    order = 0 if reading.training.fixed == "order" else seed
    began = time.process_time()
    begin = settings.warmup * (reading.training.low_warmup if method != "gru" else 1)
    if method == "gru":
        model: Model = Recurrent(networks[0])
        known = record[: COLUMN.train]
        watched: dict[str, nn.Module] = {"network": networks[0]}
    else:
        hp = method.endswith("-hp")
        model = Bands(networks, reading, record.sampling_rate, hp)
        known = reading.filtering.bands(record)
        watched = (
            {"sum": model.networks}
            if reading.training.summed
            else {LOW: networks[0], HIGH: networks[1]}
        )

    def predicted(begin: int, signal: Array, name: str) -> Array:
        return _free_run(model, signal[:begin], settings, reading, len(record) - begin, name)

    watch = Watch(watched, lambda name: predicted(begin, known.y, name))
    losses = _fit(model, known[: COLUMN.train], settings, reading, order, watch)
    errors = watch.errors(record.truth[begin:])
    ended = predicted(begin, known.y, "")
    trained = known.y if method == "gru" else reading.filtering.bands(record, COLUMN.train).y
    forecast = predicted(COLUMN.train, trained, "")
    watch.restore()
    low = min(errors, key=lambda epoch: errors[epoch])
    return {
        "method": method,
        "draw": draw,
        "total_rmse": rmse(record.truth[begin:], ended),
        "forecast_rmse": rmse(record.truth[COLUMN.train :], forecast),
        "best": rmse(record.truth[begin:], predicted(begin, known.y, "")),
        "lowest": errors[low],
        "lowest_epoch": low,
        "errors": study.few([*errors.values()]),
        "late_deviation": float(np.std([*errors.values()][-len(errors) // 10 :])),
        "losses": {name: study.final(values) for name, values in losses.items()},
        "reading": asdict(reading),
        **study.facts(seed, settings, began),
    }


def _fit(
    model: Model, known: Trajectory, settings: Settings, reading: Reading, seed: int, watch: Watch
) -> dict[str, list[float]]:
    """Train one network after the other, each with its own warm-up."""
    if not isinstance(model, Bands) or reading.training.summed:
        return fit(model, known, settings, seed, watch).losses
    losses: dict[str, list[float]] = {}
    for name, factor in ((LOW, reading.training.low_warmup), (HIGH, 1)):
        model.trained = [name]
        own = replace(settings, warmup=factor * settings.warmup)
        losses |= fit(model, known, own, seed, watch).losses
    return losses


def _free_run(
    model: Model, y: Array, settings: Settings, reading: Reading, steps: int, name: str
) -> Array:
    """Return a part of the free run after `y`, by its name, or their sum: `(steps, 1)`."""

    def history(samples: int) -> Signals:
        return Signals(torch.tensor(y[None, len(y) - samples :], dtype=torch.float32))

    with torch.no_grad():
        if not isinstance(model, Bands):
            return _array(model.components(history(settings.warmup), steps)["network"])
        longer = reading.training.low_warmup * settings.warmup
        parts: dict[str, Callable[[], Tensor]] = {
            LOW: lambda: model.low_at_full_rate(history(longer), steps),
            HIGH: lambda: model.high(history(settings.warmup), steps),
        }
        chosen = [part() for of, part in parts.items() if name in ("", "sum", of)]
        return _array(torch.stack(chosen).sum(dim=0))


def _array(values: Tensor) -> Array:
    return np.asarray(values[0].double().numpy())


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
