"""Short records that tests train on, with gaps and without, and a setup for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from splitband import Record, TrainingSettings
from splitband.comparison.methods import Sizes, named
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.network import with_defaults
from splitband.runtime.arrays import Array


@dataclass(frozen=True)
class Setup:
    """Training part, settings, bands and sizes of the methods of a test."""

    train: int
    settings: TrainingSettings
    bands: Bands = field(default_factory=Bands)
    sizes: Sizes = field(default_factory=Sizes)

    def forecaster(self, name: str) -> Forecaster:
        """The method of that name."""
        return with_defaults(
            named(name, self.sizes), self.settings, self.bands, self.bands, self.bands
        )

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of `compare` and `plan`."""
        return {"settings": self.settings, "bands": self.bands, "sizes": self.sizes}


NAN = np.nan
DT, WARMUP, TRAIN, LENGTH = 0.1, 12, 90, 140
QUICK = TrainingSettings.paper(window=40, warmup=WARMUP, epochs=1, batch_size=16)
SETUP = Setup(TRAIN, QUICK, bands=Bands(0.6, 2, 2), sizes=Sizes(hidden_high=5, hidden_low=3))


def record(ny: int = 1, nu: int = 0, seed: int = 0) -> Record:
    """Two sinusoids in each channel under a little noise, with a simulator of the slower one."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(LENGTH)[:, None]
    phase = rng.uniform(0, 6, (2, ny))
    y = np.sin(2 * np.pi * 0.2 * t + phase[0]) + 0.4 * np.sin(2 * np.pi * 1.1 * t + phase[1])
    y_sim = 0.8 * np.sin(2 * np.pi * 0.2 * t + phase[0]) + 0.3
    u = rng.standard_normal((LENGTH, nu)) if nu else None
    return Record(y + 0.05 * rng.standard_normal(y.shape), DT, u=u, y_sim=y_sim)


def holed(y: Array, *rows: Any, channel: Any = slice(None)) -> Array:
    """A copy without the given rows."""
    y = y.copy()
    for row in rows:
        y[row, channel] = NAN
    return y


def with_gaps(y: Array, **others: Any) -> Record:
    """A record of which NaN was not measured."""
    return Record.with_gaps(y, DT, **others)


def standing_in(y: Array, value: float, **others: Any) -> Record:
    """The record of `y`, with one value in all of its gaps."""
    known = np.isfinite(y)
    return Record(np.where(known, y, value), DT, measured=known, **others)


def rms(*errors: Array) -> float:
    """The root of the mean of the squares, added over the channels that are given."""
    return float(np.sqrt(np.mean(sum(e**2 for e in errors))))


def error_of(y: Array, prediction: Array) -> float:
    """RMSE by definition: each channel's mean square over what was measured of it, added up."""
    total = 0.0
    for channel in range(y.shape[1]):
        squares = [
            (a - b) ** 2
            for a, b in zip(y[:, channel], prediction[:, channel], strict=True)
            if not np.isnan(a)
        ]
        total += sum(squares) / len(squares) if squares else NAN
    return float(np.sqrt(total))
