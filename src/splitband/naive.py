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
        found = {lag: _last_period(y, lag) for lag in sorted(self_similar_lags(y))}
        # A period and its multiples tie up to rounding: the shortest one is meant.
        least = min(error for _, error in found.values())
        good_enough = least * (1 + 1e-9) + 1e-24 * float(np.nanmean(y**2))
        return cls(next(period for period, error in found.values() if error <= good_enough), len(y))

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


def self_similar_lags(y: Array, most: int = 200) -> list[int]:
    """Lags up to half of `y` with the smallest local minima of mean (y_n - y_{n+lag})^2.

    The mean is over the pairs of measured samples, each channel by itself.
    """
    n = len(y)
    lags = np.arange(1, n // 2 + 1)
    difference = np.zeros(len(lags))
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
        unknown = np.where(pairs > 0, 0.0, np.inf)
        difference += (before + after - 2 * products) / np.maximum(pairs, 1) + unknown
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
    measured = ~np.isnan(by_season)
    latest = count - 1 - measured[::-1].argmax(axis=0)
    period = np.take_along_axis(by_season, latest[None], axis=0)[0]
    earlier = measured & (np.arange(count)[:, None, None] < latest)
    errors = (by_season - period)[earlier]
    return all_around(period), float(np.mean(errors**2)) if len(errors) else np.inf
