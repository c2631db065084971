"""Records and forecasters of every kind, to be run sample by sample."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

import splitband as sb

SHORT = sb.TrainingSettings.paper(window=60, warmup=20, epochs=1)
BANDS = sb.Bands(1.0, 2, 3)


def driven(samples: int = 260, channels: int = 2) -> sb.Record:
    """A linear system of two inputs, one of which acts late, and a simulator that is half right."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(samples, 2)).cumsum(axis=0)
    u -= u.mean(axis=0)
    late = np.concatenate([np.repeat(u[:1, 1], 6), u[:-6, 1]])
    y = np.zeros((samples, channels))
    for n in range(1, samples):
        y[n] = 0.9 * y[n - 1] + 0.2 * u[n, 0] + 0.3 * late[n] * np.arange(1, channels + 1)
    noisy = y + 0.05 * rng.normal(size=y.shape)
    return sb.Record(noisy, 0.1, u=u, y_sim=0.8 * y + 0.3, inputs=("force", "valve"))


def free(samples: int = 260) -> sb.Record:
    """Two tones, of which a simulator knows the slow one, on a slope."""
    time = 0.1 * np.arange(samples)
    rng = np.random.default_rng(1)
    slow = np.sin(time)
    y = slow + 0.2 * np.sin(9 * time) + 0.05 * time + 0.01 * rng.normal(size=samples)
    return sb.Record(y, 0.1, y_sim=1.1 * slow - 0.1)


class Leaky(nn.Module):
    """A cell of a user's own."""

    def __init__(self, ny: int = 1, nu: int = 0) -> None:
        super().__init__()
        self.ny, self.nu = ny, nu
        self.mix = nn.Linear(ny + nu, ny)

    def sized(self, ny: int, nu: int, warmup: int) -> "Leaky":
        return Leaky(ny, nu)

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        return y_warmup[:, -1]

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        return 0.9 * h + 0.1 * torch.tanh(self.mix(y if u is None else torch.cat([y, u], dim=-1)))

    def observe(self, h: Tensor) -> Tensor:
        return h


WITH_INPUTS: dict[str, Callable[[], sb.Forecaster]] = {
    "mean": sb.Mean,
    "persistence": sb.Persistence,
    "linear": sb.Linear,
    "simulator": lambda: sb.Calibrated(terms=("gain", "offset")),
    "gru": lambda: sb.Single(sb.GRU(5), SHORT),
    "rnn": lambda: sb.Single(sb.networks.EulerMLP(hidden_size=7, recognition_size=5), SHORT),
    "state-space": lambda: sb.Single(sb.StateSpace(3, 4), SHORT),
    "own cell": lambda: sb.Single(Leaky(), SHORT),
    "split": lambda: sb.Split(sb.GRU(4), sb.GRU(5), BANDS, settings=SHORT),
    "split, conditioned, +HP": lambda: sb.Split(
        sb.GRU(4), sb.GRU(5), BANDS, True, True, settings=SHORT
    ),
    "split at one rate": lambda: sb.Split(
        sb.GRU(4), sb.GRU(5), sb.Bands(1.0, 1, 1), conditioned=True, settings=SHORT
    ),
    "filtered": lambda: sb.Filtered(None, sb.GRU(5), BANDS, conditioned=True, settings=SHORT),
    "filtered high": lambda: sb.Filtered(
        None, sb.GRU(5), BANDS, conditioned=True, settings=SHORT, simulator_band="high"
    ),
    "filtered high at one rate": lambda: sb.Filtered(
        None, sb.GRU(5), sb.Bands(1.0, 2, 1), True, SHORT, simulator_band="high"
    ),
    "residual of linear": lambda: sb.Residual(
        sb.Linear(), sb.GRU(5), conditioned=True, settings=SHORT
    ),
    "ensemble": lambda: sb.Ensemble([sb.Single(sb.GRU(n), SHORT) for n in (4, 3, 2)]),
}
WITHOUT: dict[str, Callable[[], sb.Forecaster]] = {
    "seasonal-naive": sb.SeasonalNaive,
    "harmonic": sb.Harmonic,
    "periodic": sb.Periodic,
    "gru": lambda: sb.Single(sb.GRU(5), SHORT),
    "split, conditioned": lambda: sb.Split(
        sb.GRU(4), sb.GRU(5), BANDS, conditioned=True, settings=SHORT
    ),
    "filtered": lambda: sb.Filtered(None, sb.GRU(5), BANDS, conditioned=True, settings=SHORT),
    "filtered high": lambda: sb.Filtered(
        None, sb.GRU(5), BANDS, conditioned=True, settings=SHORT, simulator_band="high"
    ),
    "filtered periodic": lambda: sb.Filtered(
        sb.Periodic(), sb.GRU(5), BANDS, conditioned=True, settings=SHORT
    ),
    "residual": lambda: sb.Residual(None, sb.GRU(5), settings=SHORT),
}


def in_double(forecaster: sb.Forecaster) -> None:
    """Networks in double precision, so that nothing but rounding differs."""
    for member in (forecaster, *getattr(forecaster, "members", [])):
        model = getattr(member, "model", None)
        if isinstance(model, nn.Module):
            model.double()


def rows(record: sb.Record, stream: Any) -> Callable[[int], dict[str, Any]]:
    """What a stream is given at each sample beside the measured one."""

    def at(n: int) -> dict[str, Any]:
        given: dict[str, Any] = {}
        if stream.nu and record.u is not None:
            given["u"] = record.u[n]
        if stream.steps.simulated and record.y_sim is not None:
            given["y_sim"] = record.y_sim[n : n + 1 + stream.steps.ahead]
        return given

    return at


@cache
def fitted(name: str) -> tuple[sb.Forecaster, sb.Record]:
    """A forecaster that is fitted to the first 150 samples of a record, once in a process."""
    record = driven() if name in WITH_INPUTS else free()
    make = WITH_INPUTS[name] if name in WITH_INPUTS else WITHOUT[name.removesuffix(", no inputs")]
    forecaster = make().fit(record[:150], seed=1)
    in_double(forecaster)
    return forecaster, record
