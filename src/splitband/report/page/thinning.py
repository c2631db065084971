"""Long curves with fewer points, none of whose peaks is lost."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Drawn = npt.NDArray[np.float32] | Array

ROUGHEST = 1e-4
"""Of a curve's range: by how much single precision may change it; otherwise it stays double."""


def bin_size(samples: int, most: int) -> int:
    """Samples of a bin, of which two are drawn, for `most` points at most; 1: all are drawn."""
    return 1 if samples <= most else math.ceil(2 * samples / most)


def places(samples: int, size: int) -> npt.NDArray[np.int64]:
    """The rows at which the two values of each bin are drawn, `(points,)`.

    They are the same for all curves, whose own extremes lie within half a bin of them.
    """
    if size == 1:
        return np.arange(samples)
    begins = np.arange(0, samples, size)
    pairs = np.stack([begins + size // 4, begins + 3 * size // 4], axis=1).ravel()
    return np.minimum(pairs, samples - 1)


def thinned(y: Array, size: int) -> Drawn:
    """The lowest and the highest value of each bin, in the order they have there, `(points,)`.

    NaN where a bin holds nothing else.
    """
    if size == 1:
        return compact(y)
    binned, empty = _binned(y, size)
    low, high = np.where(empty, np.inf, binned), np.where(empty, -np.inf, binned)
    rising = low.argmin(axis=1) <= high.argmax(axis=1)
    least, most = low.min(axis=1), high.max(axis=1)
    pairs = np.where(rising[:, None], np.stack([least, most], 1), np.stack([most, least], 1))
    return compact(np.where(np.isfinite(pairs), pairs, np.nan).ravel())


def envelope(lower: Array, upper: Array, size: int) -> tuple[Drawn, Drawn]:
    """Of an interval the lowest lower and the highest upper edge of each bin, both times."""
    if size == 1:
        return compact(lower), compact(upper)
    edges = []
    for edge, sign in ((lower, -1.0), (upper, 1.0)):
        binned, empty = _binned(sign * edge, size)
        most = np.where(empty, -np.inf, binned).max(axis=1)
        edges.append(compact(np.repeat(np.where(np.isfinite(most), sign * most, np.nan), 2)))
    return edges[0], edges[1]


def compact(y: Array) -> Drawn:
    """In single precision where nobody would see the difference."""
    seen = y[np.isfinite(y)]
    if not len(seen) or abs(seen).max() > np.finfo(np.float32).max:
        return y
    single = y.astype(np.float32)
    worst = abs(single[np.isfinite(y)].astype(np.float64) - seen).max()
    return single if worst <= ROUGHEST * np.ptp(seen) else y


def _binned(y: Array, size: int) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Bins as rows, filled up with NaN, and where they hold nothing."""
    padded = np.full(math.ceil(len(y) / size) * size, np.nan)
    padded[: len(y)] = y
    binned = padded.reshape(-1, size)
    return binned, np.isnan(binned)
