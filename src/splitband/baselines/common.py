"""Select and scale the samples to which baselines are fitted.

A baseline is what a trained model has to beat to be worth its training. It is fitted to the
training samples in closed form, and predicts by time index, which counts from the first of them.
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array

LONGEST = 4000
"""Measured samples of a channel that least squares fits use at most, to bound their time.
By eye."""
FARTHEST_BACK = 10 * LONGEST
"""Rows before the end of a record in which these are looked for, where there are gaps. By eye."""


class ByTime(Protocol):
    """Define the interface of closed-form fits: functions of time from the first fitted sample."""

    @classmethod
    def fit(cls, y: Array) -> Self:
        """Fit to measured samples `(time, ny)`, NaN in gaps."""

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples `start`..`start + steps - 1`, counted from there, `(steps, ny)`."""


def recent(y: Array, longest: int | None = None) -> tuple[int, Array]:
    """Return the index from which on `y` `(time, ny)` is fitted, and `y` from there on.

    Of each channel the last `longest` measured samples are kept, by default `LONGEST`; those among
    them that are farther back than `FARTHEST_BACK` rows only where there are no others. The rest
    becomes NaN.
    """
    y = y.copy()
    for channel in y.T:
        last = known(channel)[-(longest or LONGEST) :]
        near = last[last >= len(y) - FARTHEST_BACK]
        channel[: near[0] if len(near) else last[0]] = np.nan
    begin = min(int(known(channel)[0]) for channel in y.T)
    return begin, y[begin:]


def known(y: Array) -> npt.NDArray[np.int_]:
    """Return the indices at which a channel `(time,)` was measured."""
    return np.flatnonzero(~np.isnan(y))


def units(y: Array) -> tuple[float, float]:
    """Return mean and range of a channel; for a constant one its value, and 1."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    return (float(np.nanmean(y)), high - low) if low < high else (low, 1.0)
