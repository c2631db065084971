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
import scipy

Array = npt.NDArray[np.float64]

ENOUGH_PAIRS = 0.25
"""Of measured samples a lag apart, as a share of the most at any lag: fewer agree by chance."""
LONGEST = 4000
"""Samples that what is fitted by least squares is fitted to at most: its time grows with them."""
FARTHEST_BACK = 10 * LONGEST
"""Rows of a record in which they lie, where some were not measured."""


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
    """The mean of the training samples: what is left where nothing can be foreseen.

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
    """A trajectory that somebody else predicted: a simulator, taken as it is.

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


@dataclass(frozen=True, eq=False)
class SeasonalNaive:
    """The last period of the training samples, repeated; use `SeasonalNaive.fit`.

    Attributes
    ----------
    period : The samples that repeat, `(lag, ny)`.
    end : Index after the last of them.
    """

    period: Array
    end: int

    @classmethod
    def fit(cls, y: Array) -> SeasonalNaive:
        """Choose the lag whose last period, repeated backwards, fits `y` `(time, ny)` best.

        Where `y` is NaN nothing was measured, and the period before has to do. Compared are the
        lags up to half the record at which the record resembles itself: the local minima of its
        mean squared difference at a lag.
        """
        errors = {lag: _last_period(y, lag)[1] for lag in sorted(self_similar_lags(y))}
        # A period and its multiples tie up to rounding: the shortest one is meant.
        good_enough = min(errors.values()) * (1 + 1e-9) + 1e-24 * float(np.nanmean(y**2))
        lag = next(lag for lag, error in errors.items() if error <= good_enough)
        return cls(_last_period(y, lag)[0], len(y))

    @property
    def lag(self) -> int:
        """Samples in a period."""
        return len(self.period)

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        index = np.arange(start, start + steps)
        repeated: Array = self.period[(index - self.end) % self.lag]
        return repeated

    def __str__(self) -> str:
        return f"the last {self.lag} training samples, repeated"


def recent(y: Array) -> tuple[int, Array]:
    """Where the end of `y` `(time, ny)` begins that is fitted, and that end.

    Each channel has its last `LONGEST` samples there, those of the last `FARTHEST_BACK` if any is
    among these.
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
    """Mean and range of a channel; a constant one has its value and 1."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    return (float(np.nanmean(y)), high - low) if low < high else (low, 1.0)


def self_similar_lags(y: Array, most: int = 200) -> list[int]:
    """Lags up to half of `y` with the smallest local minima of mean (y_n - y_{n+lag})^2.

    The mean is over the pairs of measured samples, each channel by itself.
    """
    n = len(y)
    lags = np.arange(1, n // 2 + 1)
    difference, doubtful = np.zeros(len(lags)), np.zeros(len(lags), dtype=np.bool_)
    for channel in y.T:
        measured = (~np.isnan(channel)).astype(np.float64)
        centred = np.nan_to_num(channel - np.nanmean(channel))
        # Of a square and its two mixed products: (a - b)^2 = a^2 + b^2 - 2 a b.
        pairs, before, after, products = (
            scipy.signal.correlate(a, b, mode="full", method="fft")[n - 1 :][lags]
            for a, b in (
                (measured, measured),
                (measured, centred**2),
                (centred**2, measured),
                (centred, centred),
            )
        )
        pairs = np.rint(pairs)
        doubtful |= pairs < ENOUGH_PAIRS * pairs.max()
        difference += (before + after - 2 * products) / np.maximum(pairs, 1)
    difference[doubtful] = np.inf
    minima = scipy.signal.argrelmin(np.append(difference, np.inf))[0]  # the last lag may be one
    ranked = minima[np.argsort(difference[minima], kind="stable")]
    return [int(lags[i]) for i in ranked[:most]] or [int(lags[-1])]


def seasons(y: Array, lag: int) -> Array:
    """`y` `(time, ny)` as `(season, lag, ny)`, the last season ending with it; NaN in the first."""
    count = -(-len(y) // lag)
    found = np.full((count * lag, y.shape[1]), np.nan)
    found[-len(y) :] = y
    return found.reshape(count, lag, -1)


def all_around(period: Array) -> Array:
    """A period `(lag, ny)`, with straight lines across what is NaN, round from end to begin."""
    found, phase = period.copy(), np.arange(len(period))
    for channel in found.T:
        seen = ~np.isnan(channel)
        channel[~seen] = np.interp(phase[~seen], phase[seen], channel[seen], period=len(period))
    return found


def _last_period(y: Array, lag: int) -> tuple[Array, float]:
    """The last measured sample at each phase, and its mean squared error for all earlier ones."""
    by_season = seasons(y, lag)
    count = len(by_season)
    last = count - 1 - (~np.isnan(by_season))[::-1].argmax(axis=0)
    period = np.take_along_axis(by_season, last[None], axis=0)[0]
    errors = by_season - period
    errors[np.arange(count)[:, None, None] >= last] = np.nan
    compared = len(errors.ravel()) - np.count_nonzero(np.isnan(errors))
    return all_around(period), float(np.nansum(errors**2) / compared) if compared else np.inf
