"""Find the period of a record: repeat the last period, or fit a Fourier series to all periods.

The response of a periodically driven system usually becomes periodic after the decay of free
vibrations. Seasonal-naive repeats one period with its noise; a Fourier series averages over all
periods, and its period need not be a whole number of samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from splitband.baselines.sinusoids import (
    FAST_DAMPING,
    RATE,
    SinusoidRegression,
    Sinusoids,
    bic,
    known,
    recent,
    trend,
)
from splitband.metrics import spread
from splitband.runtime.arrays import Array

MOST_HARMONICS = 30
"""Largest number of harmonics of a period. Bounds the time."""
VIBRATIONS = 4
"""Largest number of decaying sinusoids beside a Fourier series. Bounds the time."""
LAGS = 4
"""Number of self-similar lags in the choice of a period. Bounds the time."""
FEWEST_PERIODS = 2.5
"""Fewest periods in the record of a Fourier series: two may be similar by chance. By eye."""
ENOUGH_PAIRS = 0.25
"""Fewest pairs of measured samples at a lag, as a share of the largest number at any lag: fewer may
agree by chance. By eye."""

_COMPARED, _FEWEST_LAGS, _MOST_LAGS = 20_000_000, 8, 200
"""Values compared with the last period, over all lags, and limits of the number of lags. Bounds the
time."""


def nearest(time: float) -> int:
    """Return the nearest whole number; halves round up, which keeps distances of a sample."""
    return math.floor(time + 0.5)


@dataclass(frozen=True, eq=False)
class LastPeriod:
    """The last period of the training samples, repeated on a trend; use `LastPeriod.fit`.

    period : The samples of the period, without the trend, `(lag, ny)`.
    end : Index after the last sample of the period.
    trend : Trends by channel.
    """

    period: Array
    end: int
    trend: SinusoidRegression

    @classmethod
    def fit(cls, y: Array) -> LastPeriod:
        """Choose the lag with the best fit to `y` `(time, ny)` of its last period, repeated.

        A trend (`sinusoids.trend`) is removed first. Gaps (NaN) are filled from the period before.
        The candidates are the self-similar lags up to half the record: local minima of the mean
        squared difference at a lag.
        """
        begin, end = recent(y)
        trends = SinusoidRegression(tuple(trend(channel) for channel in end.T), begin)
        return cls(last_period(y - trends.predict(0, len(y))), len(y), trends)

    @property
    def lag(self) -> int:
        """Return the number of samples in a period."""
        return len(self.period)

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples from `start` on, `(steps, ny)`; 0 is the record's first sample."""
        begin = nearest(start)
        index = begin + np.arange(steps)
        return self.period[(index - self.end) % self.lag] + self.trend.predict(begin, steps)

    def __str__(self) -> str:
        return f"the last {self.lag} training samples, repeated on {self.trend}"


def periodic(y: Array) -> SinusoidRegression:
    """Fit a Fourier series and decaying vibrations to the channels of `y` `(time, ny)`.

    The period is a self-similar lag of the channel, or an integer fraction of such a lag.
    """

    def of_channel(y: Array) -> Sinusoids:
        slow = trend(y)
        level = slow.refined(y)
        if len(known(y)) < 2:
            return level
        channel = slow.residual(y)[:, None]
        # Of tied multiples of a period, seasonal-naive has the shortest.
        lags = {len(last_period(channel)), *self_similar_lags(channel, LAGS)}
        lags = {lag for lag in lags if FEWEST_PERIODS * lag <= len(y)}
        tried = [level, *(_series(y, level, lag) for lag in sorted(lags))]
        best = min(tried, key=lambda fit: fit.bic(y, strict=True))
        if not best.harmonics:
            return best
        moved = best.refined(y).grown(y, FAST_DAMPING / len(y), VIBRATIONS)
        # The best series has one of few lags, which counts as one parameter instead of `RATE`.
        penalty = (RATE - 1) * np.log(len(known(y)))
        return moved if moved.bic(y, strict=True) + penalty < best.bic(y, strict=True) else best

    return SinusoidRegression.fit(y, of_channel)


def _series(y: Array, level: Sinusoids, lag: int) -> Sinusoids:
    """Return the Fourier series of a period on a `level`, with harmonics chosen by the BIC."""
    index = known(y)
    most = min(MOST_HARMONICS, lag // 2, (len(index) - 2) // 4)
    left = level.residual(y)
    complete = left[len(y) % lag :]
    if most < 1 or not len(known(complete)):
        return level
    by_season = seasons(complete[:, None], lag)
    with np.errstate(invalid="ignore"):  # 0 / 0 at a phase without measurements
        mean_period = np.nansum(by_season, axis=0) / (~np.isnan(by_season)).sum(axis=0)
    mean_period = fill_gaps_periodically(mean_period)[:, 0]
    strength = abs(np.fft.rfft(mean_period)[1 : lag // 2 + 1])
    strongest = 1 + np.argsort(-strength, kind="stable")[:most]
    phase = 2 * np.pi * np.outer(index, strongest) / lag
    pairs = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(index), -1)
    straight = level.basis(index)
    straight = straight[:, straight.any(axis=0)]
    directions = np.linalg.qr(np.hstack([straight, pairs]))[0][:, straight.shape[1] :]
    criteria = [level.bic(y, strict=True)]
    for j in range(len(strongest)):
        pair = directions[:, 2 * j : 2 * j + 2]
        left[index] -= pair @ (pair.T @ left[index])
        criteria.append(bic(y, left, straight.shape[1] + RATE + 2 * (j + 1), strict=True))
    harmonics = strongest[: int(np.argmin(criteria))]
    if not len(harmonics):
        return level
    # If all are harmonics of a fraction of the lag, this fraction is the period. Weak harmonics in
    # between are included.
    whole = int(np.gcd.reduce(harmonics))
    order = np.arange(1, min(harmonics.max() // whole, MOST_HARMONICS) + 1)
    frequencies = np.append(order * whole / lag, level.frequencies)
    dampings = np.append(np.zeros(len(order)), level.dampings)
    series = replace(level, frequencies=frequencies, dampings=dampings, harmonics=len(order))
    return series.solved(y)


def last_period(y: Array) -> Array:
    """Return the last period of `y` `(time, ny)`, `(lag, ny)`, for the best lag."""
    most = int(np.clip(_COMPARED // y.size, _FEWEST_LAGS, _MOST_LAGS))
    by_lag = {lag: _last_period(y, lag) for lag in sorted(self_similar_lags(y, most))}
    # A period and its multiples fit equally well up to rounding: take the shortest.
    negligible = np.maximum(1e-24 * np.nanmean(y**2, axis=0), np.finfo(np.float64).tiny)
    errors = {lag: np.log(error + negligible).sum() for lag, (_, error) in by_lag.items()}
    good_enough = min(errors.values()) + 1e-9 * y.shape[1]
    return next(period for lag, (period, _) in by_lag.items() if errors[lag] <= good_enough)


def self_similar_lags(y: Array, most: int = _MOST_LAGS) -> list[int]:
    """Return the lags of local minima of the mean of (y_n - y_{n+lag})^2, the lowest first.

    Lags of up to half the length of `y` are considered.
    """
    difference = _differences(y)
    # With infinity appended, the last lag can be a minimum, too.
    minima = scipy.signal.argrelmin(np.append(difference, np.inf))[0]
    ranked = minima[np.argsort(difference[minima], kind="stable")]
    return [1 + int(i) for i in ranked[:most]] or [len(difference)]


def _differences(y: Array) -> Array:
    """Return the mean of (y_n - y_{n+lag})^2 for the lags 1, 2, ... to half of `y` `(time, ny)`.

    The mean is taken over pairs of measured samples, and is infinite for few pairs. Channels are
    summed in units of their variances.
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


def fill_gaps_periodically(period: Array) -> Array:
    """Fill NaN in a period `(lag, ny)` by periodic linear interpolation."""
    filled, phase = period.copy(), np.arange(len(period))
    for channel in filled.T:
        measured = ~np.isnan(channel)
        channel[~measured] = np.interp(
            phase[~measured], phase[measured], channel[measured], period=len(period)
        )
    return filled


def _last_period(y: Array, lag: int) -> tuple[Array, Array]:
    """Return the last measured sample by phase, `(lag, ny)`, and mean squared errors, `(ny,)`.

    The errors are those of all earlier samples; a channel without earlier ones has its variance.
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
    return fill_gaps_periodically(period), error
