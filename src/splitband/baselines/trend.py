"""Find the trend of a channel: a straight line, or an exponential that settles at a limit.

A trend is kept only if its held-out forecasts (`baselines.origins`) are better than a constant and
than the last value. Sinusoids are fitted together with it, so that neither is mistaken for the
other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.common import known, recent, units
from splitband.baselines.origins import is_better, origins
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

SLOWEST, FASTEST = 0.5, 20.0
"""E-foldings of an exponential within the record. A slower one is nearly a straight line, a faster
one leaves little to fit. By eye."""
MOST_BLOCKS = 256
"""Most block means to which a trend is fitted: it is slow, and this saves time. By eye."""
FEWEST = 15
"""Smallest number of blocks for held-out tests; with fewer there is no trend. By eye."""
SINUSOIDS = 6
"""Largest number of sinusoids that are fitted along with a trend. By eye."""
EVIDENCE = 3.0
"""Sum of squares that a sinusoid or the trend must explain, by the residual's mean square and the
logarithm of the number of blocks. Noise has peaks too, and the residual of an incomplete period has
a slope. By eye."""
NEGLIGIBLE = 1e-16
"""Mean square that counts as zero, in units of the record's range squared."""
_RANK = 0.03
"""Singular values below this share are cut in fits of a trend with sinusoids. By eye."""


@saved
class Shape(NamedTuple):
    """Represent a line or exponential with mean 0 and deviation 1 over the fitted samples.

    Attributes
    ----------
    rate : Decay of the exponential per sample; 0 for a straight line.
    begin, samples : First fitted sample, and their number. The shape is constant before `begin`.
    """

    rate: float
    begin: int
    samples: int

    def __call__(self, index: npt.NDArray[np.number]) -> Array:
        """Return its values at these samples, `(len(index),)`."""
        elapsed = np.maximum(index - self.begin, 0) / self.samples
        folds = self.rate * self.samples
        if not folds:
            return np.sqrt(12) * (elapsed - 0.5)
        mean, deviation = self._moments()
        return (np.exp(-folds * elapsed) - mean) / deviation

    def by_rate(self, index: npt.NDArray[np.number]) -> Array:
        """Return the derivative of an exponential with respect to its rate, `(len(index),)`.

        Mean and deviation are treated as constants: the fitted offset and size compensate.
        """
        since = np.maximum(index - self.begin, 0)
        return np.asarray(-since * np.exp(-self.rate * since) / self._moments()[1])

    def _moments(self) -> tuple[float, float]:
        """Return mean and deviation of the exponential over the fitted samples."""
        folds = self.rate * self.samples
        mean = -np.expm1(-folds) / folds
        return float(mean), float(np.sqrt(-np.expm1(-2 * folds) / (2 * folds) - mean**2))

    def __str__(self) -> str:
        if self.rate == 0:
            return "a straight line"
        return f"an exponential with a time constant of {1 / self.rate:.4g} samples"


@saved
class Trend(NamedTuple):
    """Represent a trend, `offset + size * shape`; see `find`."""

    shape: Shape
    offset: float
    size: float

    def predict(self, index: npt.NDArray[np.number]) -> Array:
        """Return its values at these samples, `(len(index),)`."""
        return self.offset + self.size * self.shape(index)


def find(y: Array) -> Trend | None:
    """Return the trend of a channel `(time,)`, NaN in gaps, or None if none lowers the error.

    Four forecasts are compared over rolling origins: the last value, and a constant, a line and an
    exponential, each with the strongest sinusoids. A line must be better than the last value and
    the constant; an exponential better than the line, or than those two if no line is kept. In the
    fit to the whole record, the trend must also stand out from the residual.
    """
    begin, end = recent(y[:, None])
    offset, scale = units(end[:, 0])
    at, blocks = _blocks((end[:, 0] - offset) / scale, begin)
    rows = known(blocks)
    if len(rows) < FEWEST:
        return None
    line = [Shape(0.0, begin, len(end))]
    folds = np.geomspace(SLOWEST, FASTEST, 25)
    exponentials = [Shape(float(rate), begin, len(end)) for rate in folds / len(end)]
    cuts = [int(rows[origin]) for origin in origins(len(rows))]
    without = _held_out(at, blocks, cuts, [])
    last = np.array([_rms(blocks[cut:] - _last(blocks[:cut])) for cut in cuts])
    best, simpler = None, [without, last]
    for shapes in (line, exponentials):  # the simpler one first
        errors = _held_out(at, blocks, cuts, shapes)
        if all(is_better(errors, other) for other in simpler):
            best, simpler = shapes, [errors]
    if best is None:
        return None
    fitted = _TrendFit.fit(at, blocks, best)
    return fitted.trend(offset, scale) if fitted.stands_out(at, blocks) else None


def trending(trends: Sequence[Trend | None], index: npt.NDArray[np.number]) -> Array:
    """Return the trend of each channel, `(len(index), ny)`; 0 for a channel without one."""
    none = np.zeros(len(index))
    return np.stack([trend.predict(index) if trend else none for trend in trends], axis=1)


def described(shapes: Sequence[Shape | None]) -> str:
    """Return a description of the channels' trends; empty without any."""
    kinds = [str(shape) for shape in shapes if shape is not None]
    return f", on {' and '.join(dict.fromkeys(kinds))}" if kinds else ""


def _blocks(y: Array, begin: int) -> tuple[Array, Array]:
    """Return centres and means of blocks of equal length; NaN for blocks without measurements."""
    length = -(-len(y) // MOST_BLOCKS)
    first = len(y) % length
    by_block = y[first:].reshape(-1, length)
    counts = (~np.isnan(by_block)).sum(axis=1)
    means = np.full(len(counts), np.nan)
    np.divide(np.nansum(by_block, axis=1), counts, out=means, where=counts > 0)
    return begin + first + (length - 1) / 2 + length * np.arange(len(means), dtype=float), means


def _last(blocks: Array) -> float:
    return float(blocks[known(blocks)[-1]])


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.nanmean(errors**2)))


def _held_out(at: Array, blocks: Array, cuts: list[int], shapes: list[Shape]) -> Array:
    """Return the RMSE of the forecast after each cut, fitted before it."""
    errors = []
    for cut in cuts:
        fitted = _TrendFit.fit(at[:cut], blocks[:cut], shapes)
        errors.append(_rms(blocks[cut:] - fitted.predict(at[cut:])))
    return np.array(errors)


class _TrendFit(NamedTuple):
    """Hold a fit of the strongest sinusoids (cycles per sample), with or without a trend."""

    shape: Shape | None
    frequencies: list[float]
    coefficients: Array

    @classmethod
    def fit(cls, at: Array, y: Array, shapes: list[Shape]) -> _TrendFit:
        """Fit the best shape out of `shapes` with sinusoids, by orthogonal matching pursuit.

        Sinusoids are added one by one at the peak of the residual's spectrum, among frequencies of
        at least one cycle per record.
        """
        rows = known(y)
        times, values = at[rows], y[rows]
        step, count = float(at[1] - at[0]), len(y)
        frequencies: list[float] = []
        while True:
            sinusoids = _sinusoids(times, frequencies)
            shape = _best(shapes, times, values, sinusoids)
            basis = _with(shape, times, sinusoids)
            coefficients = np.linalg.lstsq(basis, values, rcond=_RANK)[0].astype(np.float64)
            left = np.zeros(count)
            left[rows] = values - basis @ coefficients
            power = abs(np.fft.rfft(left, 8 * count)[: 4 * count]) ** 2
            peak = 8 + int(np.argmax(power[8:]))
            gained = 2 * float(power[peak]) / len(rows)
            # Without noise only rounding error is left, which must not count as sinusoids.
            remaining = max(float(np.mean(left[rows] ** 2)), NEGLIGIBLE)
            too_weak = gained <= EVIDENCE * np.log(len(rows)) * remaining
            if too_weak or len(frequencies) == min(SINUSOIDS, (len(rows) - 4) // 3):
                return cls(shape, frequencies, coefficients)
            frequencies.append(peak / (8 * count * step))

    def predict(self, at: Array) -> Array:
        """Return the values at these times, in samples."""
        return np.asarray(
            _with(self.shape, at, _sinusoids(at, self.frequencies)) @ self.coefficients
        )

    def stands_out(self, at: Array, y: Array) -> bool:
        """Return whether the trend has more power than it would have by chance."""
        rows = known(y)
        left = y[rows] - self.predict(at[rows])
        free = max(len(rows) - len(self.coefficients), 1)
        remaining = max(float(left @ left) / free, NEGLIGIBLE)
        gained = len(rows) * float(self.coefficients[-1]) ** 2
        return gained > EVIDENCE * np.log(len(rows)) * remaining

    def trend(self, offset: float, scale: float) -> Trend:
        """Return the trend of `offset + scale * y`."""
        assert self.shape is not None
        constant, size = float(self.coefficients[0]), float(self.coefficients[-1])
        return Trend(self.shape, offset + scale * constant, scale * size)


def _sinusoids(at: Array, frequencies: list[float]) -> Array:
    """Return a constant and sinusoids as regressors, `(time, 1 + 2 * frequencies)`."""
    phase = 2 * np.pi * np.outer(at, frequencies)
    return np.hstack([np.ones((len(at), 1)), np.cos(phase), np.sin(phase)])


def _with(shape: Shape | None, at: Array, sinusoids: Array) -> Array:
    return sinusoids if shape is None else np.column_stack([sinusoids, shape(at)])


def _best(shapes: list[Shape], at: Array, y: Array, sinusoids: Array) -> Shape | None:
    """Return the shape that fits `y` best; the rate of an exponential is refined."""
    if len(shapes) < 2:
        return shapes[0] if shapes else None
    directions = np.linalg.qr(sinusoids)[0]
    left = y - directions @ (directions.T @ y)

    def explained(shape: Shape) -> float:
        column = shape(at)
        column = column - directions @ (directions.T @ column)
        return float(column @ left) ** 2 / max(float(column @ column), 1e-12)

    best = int(np.argmax([explained(shape) for shape in shapes]))
    around = [np.log(shape.rate) for shape in shapes[max(best - 1, 0) : best + 2]]
    minimum = scipy.optimize.minimize_scalar(
        lambda rate: -explained(shapes[0]._replace(rate=float(np.exp(rate)))),
        bounds=(around[0], around[-1]),
        method="bounded",
        options={"xatol": 1e-3},
    )
    return shapes[0]._replace(rate=float(np.exp(minimum.x)))
