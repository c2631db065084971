"""Thin long curves out without losing a peak."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array

Drawn = npt.NDArray[np.float32] | Array

MAX_ROUNDING = 1e-4
"""Largest change of a curve by single precision, as a share of its range: less than a pixel of a
plot. Otherwise the curve stays double."""


def bin_size(samples: int, most: int) -> int:
    """Return the samples in a bin, of which two are drawn, for `most` points; 1: all are drawn."""
    return 1 if samples <= most else math.ceil(2 * samples / most)


def places(samples: int, size: int) -> npt.NDArray[np.int64]:
    """Return the rows at which the two values of each bin are drawn, `(points,)`.

    They are the same for all curves, whose extremes lie within three quarters of a bin of them.
    """
    if size == 1:
        return np.arange(samples)
    begins = np.arange(0, samples, size)
    pairs = np.stack([begins + size // 4, begins + 3 * size // 4], axis=1).ravel()
    return np.minimum(pairs, samples - 1)


def thinned(y: Array, size: int) -> Drawn:
    """Return the lowest and the highest value of each bin, in their order in time.

    They are NaN if a bin holds nothing else.
    """
    if size == 1:
        return compact(y)
    least, most, rising = _extremes(y, size)
    pairs = np.where(rising[:, None], np.stack([least, most], 1), np.stack([most, least], 1))
    return compact(pairs.ravel())


def envelope(lower: Array, upper: Array, size: int) -> tuple[Drawn, Drawn]:
    """Return the lowest lower and the highest upper edge of an interval in each bin, each twice."""
    if size == 1:
        return compact(lower), compact(upper)
    least, most = _extremes(lower, size)[0], _extremes(upper, size)[1]
    return compact(np.repeat(least, 2)), compact(np.repeat(most, 2))


def compact(y: Array) -> Drawn:
    """Return a curve in single precision if the difference is invisible."""
    seen = y[np.isfinite(y)]
    if not len(seen) or abs(seen).max() > np.finfo(np.float32).max:
        return y
    single = y.astype(np.float32)
    worst = abs(single[np.isfinite(y)].astype(np.float64) - seen).max()
    return single if worst <= MAX_ROUNDING * np.ptp(seen) else y


def _extremes(y: Array, size: int) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Return the lowest and the highest value of each bin, and whether the lowest is first."""
    whole = np.full(math.ceil(len(y) / size) * size, np.nan)
    whole[: len(y)] = y
    binned = whole.reshape(-1, size)
    missing = np.isnan(binned)
    low, high = np.where(missing, np.inf, binned), np.where(missing, -np.inf, binned)
    some = ~missing.all(axis=1)
    least, most = (np.where(some, y, np.nan) for y in (low.min(axis=1), high.max(axis=1)))
    return least, most, low.argmin(axis=1) <= high.argmax(axis=1)
