"""Calibrate a simulator: gain, offset, delay and clock, each kept only if it lowers the error.

Not in the paper. A small clock error or delay makes even a good simulator wrong after a while; the
training part of the record is enough to estimate them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

Term = Literal["gain", "offset", "delay", "clock"]
TERMS: tuple[Term, ...] = get_args(Term)
MOST_DELAY = 0.1
"""Largest delay or advance of a simulator, as a share of the training part's duration. By eye."""
MOST_CLOCK = 0.05
"""Largest relative deviation of the simulator's clock from 1. By eye."""


@saved
@dataclass(frozen=True)
class Calibration:
    """Map a simulation to the record: y(t) = offset + gain * simulator(clock * t - delay).

    t is counted from the first training sample, the origin.

    Attributes
    ----------
    gain, offset : One value per channel; empty for 1 and 0.
    delay : Delay in s, positive for a simulator that is too early.
    clock : Factor of the simulator's time.
    errors : Held-out RMSE by set of terms, for channels scaled to a deviation of 1.
    """

    gain: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    delay: float = 0.0
    clock: float = 1.0
    errors: dict[str, float] = field(default_factory=dict)

    def apply(
        self,
        y_sim: Array,
        samples: int,
        sampling_time: float,
        begin: float = 0.0,
        begin_sim: float = 0.0,
    ) -> Array:
        """Return the calibrated simulation, `(samples, ny)`.

        Raises ValueError if `y_sim` ends too early and neither delay nor clock are calibrated.

        Parameters
        ----------
        y_sim : `(time, ny)`. With a calibrated delay or clock, its values are held before the
            origin, before its first and after its last sample.
        samples : Number of samples to return.
        sampling_time : Sampling time of both, in s.
        begin, begin_sim : Position of the first sample to return, and of the first sample of
            `y_sim`, in samples after the origin.
        """
        self.check(y_sim.shape[1])
        index = self.places(samples, sampling_time, begin) - begin_sim
        rows = np.rint(index).astype(int)
        if self.stays and rows[-1] >= len(y_sim):
            raise ValueError(f"y_sim must have {rows[-1] + 1} samples at least, got {len(y_sim)}")
        on_rows = self.stays and bool(np.abs(index - rows).max() < 1e-6)
        moved = y_sim[np.maximum(rows, 0)] if on_rows else spline_of(y_sim)(index)
        gain = np.array(self.gain or 1.0)
        return np.asarray(gain * moved + np.array(self.offset or 0.0), dtype=np.float64)

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        numbers = [*self.gain, *self.offset, self.delay, self.clock]
        for value in numbers:
            if not isinstance(value, int | float) or not np.isfinite(value):
                raise ValueError(f"a calibration must hold finite numbers, got {value!r}")
        if not self.clock > 0:
            raise ValueError(f"clock must be positive, got {self.clock}")

    def check(self, ny: int) -> None:
        """Raise ValueError unless gain and offset have `ny` values, or none."""
        for name in ("gain", "offset"):
            if len(getattr(self, name)) not in (0, ny):
                raise ValueError(f"{name} must have {ny} value(s), got {len(getattr(self, name))}")

    def places(self, samples: int, sampling_time: float, begin: float = 0.0) -> Array:
        """Return the simulator times that `apply` uses, `(samples,)`, in samples from t = 0."""
        index = begin + np.arange(samples, dtype=np.float64)
        if self.stays:
            return index
        return np.maximum(self.clock * index - self.delay / sampling_time, 0.0)

    def held(self, steps: int, sampling_time: float, begin: float, samples: int, end: float) -> str:
        """Return a sentence if the simulation ends too early, else an empty string.

        The last `steps` of the `samples` from `begin` on are the forecast; `end` is the position
        after the simulation's last sample. Positions are counted in samples after the origin.
        """
        missing = int(np.sum(self.places(samples, sampling_time, begin) > end - 0.5))
        if not missing:
            return ""
        return (
            f"the simulator's output ends too early for its calibration ({self}): for the last "
            f"{missing} of {steps} samples its last value is held; a longer output would do better"
        )

    def __str__(self) -> str:
        """Return the calibrated terms, with units."""
        parts = []
        if self.gain:
            parts.append("gain " + ", ".join(f"{g:.3g}" for g in self.gain))
        if self.offset:
            parts.append("offset " + ", ".join(f"{o:.3g}" for o in self.offset))
        if self.delay:
            parts.append(f"delay {self.delay:.4g} s")
        if self.clock != 1:
            parts.append(f"clock {self.clock:.5g}")
        return "; ".join(parts) or "as it comes"

    @property
    def stays(self) -> bool:
        """Return whether the simulator's time is unchanged."""
        return self.delay == 0 and self.clock == 1


def samples_needed(samples: int, train: int) -> int:
    """Return the length in samples of a simulation that suffices to fit every term."""
    return int(np.ceil(samples * (1 + MOST_CLOCK) + train * MOST_DELAY)) + 1


def spline_of(y: Array) -> Callable[[Array], Array]:
    """Return a function that interpolates between samples; the ends are held."""
    spline = scipy.interpolate.CubicSpline(np.arange(len(y)), y)
    return lambda index: np.asarray(spline(np.clip(index, 0, len(y) - 1)))
