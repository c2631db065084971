"""Select and scale the samples to which baselines are fitted.

A baseline is a method that needs no training of a network; a network has to beat it. It is fitted
to the training samples by least squares. Time indices count from the first training sample.
"""

from __future__ import annotations

from typing import Protocol, Self

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array

LONGEST = 4000
"""Most measured samples of a channel in a least-squares fit, to limit its time. By eye."""
FARTHEST_BACK = 10 * LONGEST
"""Where there are gaps, only so many rows before a record's end are searched for them. By eye."""


class ByTime(Protocol):
    """Define the interface of baselines that are functions of the time index alone.

    Others forecast from the history, such as persistence, or from the inputs.
    """

    @classmethod
    def fit(cls, y: Array) -> Self:
        """Fit to measured samples `(time, ny)`, NaN in gaps."""

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples `start`..`start + steps - 1`, `(steps, ny)`; 0 is the first fitted."""


def recent(y: Array, longest: int | None = None) -> tuple[int, Array]:
    """Return the first index of `y` `(time, ny)` that is fitted, and `y` from there on.

    The last `longest` measured samples of each channel are kept, by default `LONGEST`; others
    become NaN. Samples more than `FARTHEST_BACK` rows before the end are dropped too, unless a
    channel has no later ones.
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
    """Return the mean and range of a channel; for a constant channel its value and 1."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    return (float(np.nanmean(y)), high - low) if low < high else (low, 1.0)
