"""Repeat the last period of a record, on top of a trend if there is one.

The seasonal-naive baseline (see `splitband.baselines.common`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from splitband.baselines.trend import Trend, described, find, trending
from splitband.metrics import spread
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

ENOUGH_PAIRS = 0.25
"""Fewest pairs of measured samples at a lag, as a share of the largest number at any lag. A lag
with fewer pairs is left out, as they may agree by chance. By eye."""


@saved
@dataclass(frozen=True, eq=False)
class LastPeriod:
    """Repeat the last period of the training samples; use `LastPeriod.fit`.

    Attributes
    ----------
    period : The samples that are repeated, without the trend, `(lag, ny)`.
    end : Index after the last of them.
    trends : Trend of each channel; None without one.
    """

    period: Array
    end: int
    trends: tuple[Trend | None, ...]

    @classmethod
    def fit(cls, y: Array) -> LastPeriod:
        """Choose the lag whose last period, repeated backwards, fits `y` `(time, ny)` best.

        A trend, if there is one (`trend.find`), is removed first. Gaps (NaN) are filled from the
        period before. The candidates are the lags, up to half the record, at which the record
        resembles itself: local minima of its mean squared difference at a lag.
        """
        trends = tuple(find(channel) for channel in y.T)
        return cls(last_period(y - trending(trends, np.arange(len(y)))), len(y), trends)

    @property
    def lag(self) -> int:
        """Return the number of samples in a period."""
        return len(self.period)

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples from `start` on, `(steps, ny)`."""
        index = round(start) + np.arange(steps)
        return self.period[(index - self.end) % self.lag] + self.trend(round(start), steps)

    def trend(self, start: float, steps: int) -> Array:
        """Return only the trend from sample `start` on, `(steps, ny)`."""
        return trending(self.trends, start + np.arange(steps))

    def __str__(self) -> str:
        trends = described([trend and trend.shape for trend in self.trends])
        return f"the last {self.lag} training samples, repeated{trends}"


def last_period(y: Array) -> Array:
    """Return the last period of `y` `(time, ny)`, `(lag, ny)`, for the best lag, see `fit`."""
    by_lag = {lag: _last_period(y, lag) for lag in sorted(self_similar_lags(y))}
    # A period and its multiples fit equally well up to rounding. The shortest one is taken.
    negligible = np.maximum(1e-24 * np.nanmean(y**2, axis=0), np.finfo(np.float64).tiny)
    errors = {lag: np.log(error + negligible).sum() for lag, (_, error) in by_lag.items()}
    good_enough = min(errors.values()) + 1e-9 * y.shape[1]
    return next(period for lag, (period, _) in by_lag.items() if errors[lag] <= good_enough)


def self_similar_lags(y: Array, most: int = 200) -> list[int]:
    """Return the lags of local minima of the mean of (y_n - y_{n+lag})^2, the lowest first.

    Lags of up to half the length of `y` are considered.
    """
    difference = _differences(y)
    # With infinity behind it, the last lag can be a minimum too.
    minima = scipy.signal.argrelmin(np.append(difference, np.inf))[0]
    ranked = minima[np.argsort(difference[minima], kind="stable")]
    return [1 + int(i) for i in ranked[:most]] or [len(difference)]


def _differences(y: Array) -> Array:
    """Return the mean of (y_n - y_{n+lag})^2 for the lags 1, 2, ... to half of `y` `(time, ny)`.

    The mean is taken over pairs of measured samples, and is infinite where these are few. The
    channels are summed, each in units of its variance.
    """
    n = len(y)
    lags = np.arange(1, n // 2 + 1)
    difference, doubtful = np.zeros(len(lags)), np.zeros(len(lags), dtype=np.bool_)
    for channel in (y / spread(y)).T:
        measured = (~np.isnan(channel)).astype(np.float64)
        centred = np.nan_to_num(channel - np.nanmean(channel))
        # (a - b)^2 = a^2 - 2 a b + b^2, each term a correlation.
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
    return difference


def seasons(y: Array, lag: int) -> Array:
    """Reshape `y` `(time, ny)` to `(season, lag, ny)`, the first season padded with NaN."""
    count = -(-len(y) // lag)
    padded = np.full((count * lag, y.shape[1]), np.nan)
    padded[-len(y) :] = y
    return padded.reshape(count, lag, -1)


def all_around(period: Array) -> Array:
    """Fill NaN in a period `(lag, ny)` by periodic linear interpolation."""
    filled, phase = period.copy(), np.arange(len(period))
    for channel in filled.T:
        seen = ~np.isnan(channel)
        channel[~seen] = np.interp(phase[~seen], phase[seen], channel[seen], period=len(period))
    return filled


def _last_period(y: Array, lag: int) -> tuple[Array, Array]:
    """Return the last measured sample by phase, `(lag, ny)`, and mean squared errors, `(ny,)`.

    The errors compare all earlier samples with it; a channel without any gets its variance.
    """
    by_season = seasons(y, lag)
    count = len(by_season)
    last = count - 1 - (~np.isnan(by_season))[::-1].argmax(axis=0)
    period = np.take_along_axis(by_season, last[None], axis=0)[0]
    errors = by_season - period
    errors[np.arange(count)[:, None, None] >= last] = np.nan
    compared = (~np.isnan(errors)).sum(axis=(0, 1))
    error = np.nanvar(y, axis=0)
    np.divide(np.nansum(errors**2, axis=(0, 1)), compared, out=error, where=compared > 0)
    return all_around(period), error
