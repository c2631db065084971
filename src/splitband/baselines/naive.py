"""Naive baselines: what a trained model has to beat to be worth its training.

Each is fitted on the training samples and predicts by time index, which counts from the first of
them: `predict(start, steps, last)` gives the samples `start`..`start + steps - 1`, `last` being the
measured sample before them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

LONGEST = 4000
"""Measured samples of a channel that least squares fits use at most, to bound their time."""
FARTHEST_BACK = 10 * LONGEST
"""Rows before the end of a record in which these are looked for, where there are gaps."""


class Naive(Protocol):
    """A prediction that needs no training beyond a closed-form fit."""

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """The samples from index `start` on, `(steps, ny)`; `last` `(ny,)` precedes them."""


@dataclass(frozen=True)
class Persistence:
    """Nothing changes: the last measured sample, held."""

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        return np.tile(last, (steps, 1))

    def __str__(self) -> str:
        return "the last measured sample, held"


@dataclass(frozen=True, eq=False)
class Mean:
    """The mean of the training samples, the best forecast where nothing can be foreseen.

    Attributes
    ----------
    y : By channel, `(ny,)`.
    """

    y: Array

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        return np.tile(self.y, (steps, 1))

    def __str__(self) -> str:
        return "the mean of the training samples"


@dataclass(frozen=True, eq=False)
class Given:
    """A trajectory that is given, that of a simulator.

    Attributes
    ----------
    y : From index 0 on, `(time, ny)`.
    description : What it is.
    """

    y: Array
    description: str

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        return self.y[start : start + steps]

    def __str__(self) -> str:
        return self.description


def recent(y: Array) -> tuple[int, Array]:
    """The index from which on `y` `(time, ny)` is fitted, and `y` from there on.

    Of each channel the last `LONGEST` measured samples are kept, those among them that are farther
    back than `FARTHEST_BACK` rows only where there are no others; the rest becomes NaN.
    """
    y = y.copy()
    for channel in y.T:
        last = known(channel)[-LONGEST:]
        near = last[last >= len(y) - FARTHEST_BACK]
        channel[: near[0] if len(near) else last[0]] = np.nan
    begin = min(int(known(channel)[0]) for channel in y.T)
    return begin, y[begin:]


def known(y: Array) -> npt.NDArray[np.int_]:
    """The indices at which a channel `(time,)` was measured."""
    return np.flatnonzero(~np.isnan(y))


def units(y: Array) -> tuple[float, float]:
    """Mean and range of a channel; of a constant one its value, and 1."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    return (float(np.nanmean(y)), high - low) if low < high else (low, 1.0)
