"""A record, and a forecaster of each kind that is fitted to its beginning."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

import splitband as sb
from splitband import GRU, Bands, Forecaster, Record, Recorded, TrainingSettings
from splitband.comparison.methods import QUICK, Sizes
from tests.signals import Setup
from tests.support import known_after

DT, TRAIN, LENGTH, WARMUP, STEPS = 0.1, 60, 100, 8, 20
START = pd.Timestamp("2024-05-01 12:00")
SETTINGS = TrainingSettings.paper(window=20, warmup=WARMUP, epochs=1, batch_size=32)
BANDS = Bands(0.6, 1, 2)
SETUP = Setup(
    TRAIN, SETTINGS, BANDS, Sizes(hidden_high=3, hidden_low=2, state_size=2, step_size=0.2)
)


def record() -> Record:
    """Time stamps, an input that has an effect, and a simulator that is late and too small."""
    rng = np.random.default_rng(4)
    t = DT * np.arange(LENGTH)[:, None]
    u = rng.standard_normal((LENGTH, 1))
    slow = np.sin(2 * np.pi * 0.25 * t)
    y = 1.0 + 2.0 * slow + 0.3 * np.cumsum(u, axis=0) / np.sqrt(1 + t)
    y_sim = np.sin(2 * np.pi * 0.25 * (t - 0.3))
    return Record(y + 0.02 * rng.standard_normal(y.shape), DT, u, y_sim=y_sim, start=START)


def recorded() -> Recorded:
    """An export that begins before the record does and goes on after it."""
    t = DT * np.arange(-20, LENGTH + 40)[:, None]
    start = START + pd.Timedelta(seconds=-20 * DT)
    return Recorded(np.sin(2 * np.pi * 0.25 * (t - 0.3)), DT, start)


REPRESENTATIVES = (
    *(name for name in QUICK if name != "grey-box"),
    *("gru", "state-space", "split-gru-hp", "split-gru-conditioned"),
    *("filtered-gru-calibrated-conditioned", "filtered-high-gru-conditioned", "residual-euler-mlp"),
    *("residual-gru-calibrated", "residual-periodic-gru", "filtered-linear-state-space"),
)
"""One of each kind, and pairs of the options; grey boxes have tests of their own."""
MADE: dict[str, Callable[[], Forecaster]] = {
    **{name: lambda name=name: SETUP.forecaster(name) for name in REPRESENTATIVES},  # type: ignore[misc]
    "filtered, simulator of its own": lambda: sb.Filtered(
        sb.Calibrated(recorded()), GRU(3), BANDS, conditioned=True, settings=SETTINGS
    ),
    "simulator of its own": lambda: sb.Calibrated(recorded()),
    "filtered linear": lambda: sb.Filtered(sb.Linear(), GRU(3), BANDS, settings=SETTINGS),
    "residual of a residual": lambda: sb.Residual(
        sb.Residual(None, GRU(3), settings=SETTINGS), GRU(3), settings=SETTINGS
    ),
    "residual of a network called network": lambda: sb.Residual(
        sb.Single(GRU(3), SETTINGS, name="network"), GRU(3), settings=SETTINGS
    ),
    "networks of different sizes": lambda: sb.Ensemble(
        [sb.Single(GRU(2), SETTINGS), sb.Single(GRU(3), SETTINGS)]
    ),
    "ensemble": lambda: sb.Ensemble(sb.Single(GRU(3), SETTINGS), 3),
    "ensemble of residuals of networks": lambda: sb.Ensemble(
        sb.Residual(sb.Single(GRU(3), SETTINGS), GRU(3), settings=SETTINGS), seeds=(0, 2)
    ),
    "ensemble of hybrids": lambda: sb.Ensemble(
        sb.Filtered(sb.Calibrated(recorded()), GRU(3), BANDS, settings=SETTINGS), 2
    ),
}


def ahead(at: int = TRAIN) -> dict[str, Any]:
    """Return what is known of the record from a sample on, for `predict`."""
    return known_after(record(), at)


@cache
def fitted(name: str) -> Forecaster:
    """Once in a process; its interval too, which takes more fits."""
    return MADE[name]().fit(record()[:TRAIN], seed=1)
