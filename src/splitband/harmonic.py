"""Harmonic regression: sinusoids that may decay, by least squares on a record.

A naive baseline (see `splitband.naive`), and a strong one: what a driven linear system does is a
sum of such sinusoids.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.naive import known, recent, units

Array = npt.NDArray[np.float64]

RESOLUTION = 0.1
"""Sinusoids too close to be told apart are fitted as one: singular values below this are cut."""
STRONG_EVIDENCE = 6.0
"""Of decays, by the information criterion: noise taken for one is carried beyond the record."""
AS_HIGH = 0.95
"""Of the highest peak's power: noise makes a difference of that size."""
FASTEST_DECAY = 20.0
"""Over the whole record, as an exponent: what is gone faster is not worth a sinusoid."""


@dataclass(frozen=True, eq=False)
class HarmonicRegression:
    """A sum of sinusoids and an offset, by least squares; use `HarmonicRegression.fit`.

    Attributes
    ----------
    frequencies : In cycles per sample, one array for each channel.
    coefficients : Offset, then cosine and sine amplitudes, one array for each channel.
    dampings : Decay rates per sample, one array for each channel; zero for what goes on for ever.
    begin : Index of the first sample that was fitted, from which they decay.
    """

    frequencies: tuple[Array, ...]
    coefficients: tuple[Array, ...]
    dampings: tuple[Array, ...]
    begin: int = 0

    @classmethod
    def fit(cls, y: Array, sinusoids: int | None = None, damped: bool = True) -> HarmonicRegression:
        """Fit `y` `(time, ny)`, each channel by itself; NaN is what was not measured.

        Sinusoids are added one by one at the peak of the residual's spectrum and then moved
        together to the least squares. By default as many as the Bayesian information criterion
        is willing to pay for, at most 10. With `damped` each may decay where that pays too, as the
        free vibrations of a driven system do: without, two that beat against each other take the
        place of one that decays, and grow again after the record. Of a long record the last
        `naive.LONGEST` samples are fitted.
        """
        begin, y = recent(y)
        fitted = [_fit_channel(channel, sinusoids, damped) for channel in y.T]
        return cls.of(fitted, begin)

    @classmethod
    def of(cls, channels: Sequence[Modes], begin: int) -> HarmonicRegression:
        """From the sinusoids of each channel."""
        return cls(
            tuple(m.frequencies for m in channels),
            tuple(m.coefficients for m in channels),
            tuple(m.dampings for m in channels),
            begin,
        )

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        index = np.arange(start, start + steps) - self.begin
        channels = zip(self.frequencies, self.dampings, self.coefficients, strict=True)
        return np.stack([_basis(f, d, index) @ c for f, d, c in channels], axis=1)

    def __str__(self) -> str:
        counts = "+".join(str(len(f)) for f in self.frequencies)
        decaying = sum(int((d > 0).sum()) for d in self.dampings)
        some = f", {decaying} of them decaying," if decaying else ""
        return f"{counts} sinusoid(s){some} and an offset"


def _basis(frequencies: Array, dampings: Array, index: npt.NDArray[np.int_]) -> Array:
    phase = 2 * np.pi * np.outer(index, frequencies)
    size = np.exp(-np.outer(np.maximum(index, 0), dampings))  # no growth backwards
    return np.hstack([np.ones((len(index), 1)), size * np.cos(phase), size * np.sin(phase)])


def _solve(frequencies: Array, dampings: Array, y: Array) -> tuple[Array, Array]:
    """Amplitudes, and what they leave of the measured samples."""
    index = known(y)
    basis = _basis(frequencies, dampings, index)
    coefficients = np.linalg.lstsq(basis, y[index], rcond=RESOLUTION)[0].astype(np.float64)
    return coefficients, y[index] - basis @ coefficients


class Modes(NamedTuple):
    """Sinusoids of one channel `y` `(time,)`, NaN in its gaps, and their amplitudes.

    Attributes
    ----------
    frequencies, dampings, coefficients : As those of a channel of `HarmonicRegression`.
    harmonics : The first so many are multiples of the first one, and move with it.
    """

    frequencies: Array
    dampings: Array
    coefficients: Array
    harmonics: int = 1

    @classmethod
    def solved(cls, frequencies: Array, dampings: Array, y: Array, harmonics: int = 1) -> Modes:
        """With the amplitudes that fit `y` best."""
        return cls(frequencies, dampings, _solve(frequencies, dampings, y)[0], harmonics)

    def refined(self, y: Array) -> Modes:
        """With the frequencies and dampings nearby that fit `y` best, amplitudes as in `solved`."""
        moved = _refine(self.frequencies, self.dampings, y, self.harmonics)
        return Modes.solved(*moved, y, self.harmonics)

    def with_another(self, y: Array, damping: float, weight: float = 0.0) -> Modes:
        """With one more, at the peak of the residual's spectrum, and refined.

        A damping of zero stays. A `weight` lets the beginning of the record count more.
        """
        left = np.nan_to_num(self.residual(y)) * np.exp(-weight * np.arange(len(y)) / len(y))
        frequencies, power = scipy.signal.periodogram(left, nfft=8 * len(y), detrend=False)
        found = frequencies[_highest(power, whole=not np.isnan(y).any())]
        more = np.append(self.frequencies, found), np.append(self.dampings, damping)
        return self._replace(frequencies=more[0], dampings=more[1]).refined(y)

    def predict(self, index: npt.NDArray[np.int_]) -> Array:
        """The samples of these indices, counted from the first that was fitted."""
        return _basis(self.frequencies, self.dampings, index) @ self.coefficients

    def residual(self, y: Array) -> Array:
        """What they leave of `y`."""
        return y - self.predict(np.arange(len(y)))

    def information(self, y: Array) -> float:
        """Bayesian information criterion of a Gaussian residual, taken as 1e-8 of y at least."""
        samples, left = len(known(y)), float(np.nanmean(self.residual(y) ** 2))
        variance = max(left, 1e-16 * float(np.nanmean(y**2)), 1e-300)
        count = len(self.frequencies)
        moving = count - max(min(self.harmonics, count) - 1, 0) + int((self.dampings > 0).sum())
        parameters = 1 + 2 * count + moving
        return samples * float(np.log(variance)) + parameters * float(np.log(samples))

    def in_units(self, offset: float, scale: float) -> Modes:
        """Those of `offset + scale * y`."""
        coefficients = self.coefficients * scale
        coefficients[0] += offset
        return self._replace(coefficients=coefficients)


def _fit_channel(y: Array, sinusoids: int | None, damped: bool) -> Modes:
    """What fits a channel best, in its units; found in units of its own range."""
    offset, scale = units(y)
    scaled = (y - offset) / scale
    best = _greedy(scaled, sinusoids, 0.0)
    if damped:
        decaying = _sustained(_greedy(scaled, sinusoids, 0.3 / len(y)), scaled)
        if decaying.information(scaled) < best.information(scaled) - STRONG_EVIDENCE:
            best = decaying
    return best.in_units(offset, scale)


def _highest(power: Array, whole: bool) -> int:
    """Of a spectrum's peaks; with gaps the first of those that are as good as equally high.

    What is measured now and then has images of its frequencies above them.
    """
    highest = 1 + int(np.argmax(power[1:]))
    if whole:
        return highest
    peaks = scipy.signal.argrelmax(power)[0]
    as_high = peaks[power[peaks] >= AS_HIGH * power[highest]]
    return int(as_high[0]) if len(as_high) else highest


def _greedy(y: Array, sinusoids: int | None, damping: float) -> Modes:
    """Add sinusoids one by one; each begins with `damping`, which stays if it is zero."""
    n = len(known(y))
    most = min(10 if sinusoids is None else sinusoids, max((n - 2) // (4 if damping else 3), 0))
    modes = best = Modes.solved(np.empty(0), np.empty(0), y)
    for _ in range(most):
        modes = modes.with_another(y, damping)
        if sinusoids is not None or modes.information(y) < best.information(y):
            best = modes
    return best


def _sustained(modes: Modes, y: Array) -> Modes:
    """Drop each damping that does not pay for itself, the slowest decay first."""
    for i in np.argsort(modes.dampings):
        kept = np.where(np.arange(len(modes.dampings)) == i, 0.0, modes.dampings)
        without = modes._replace(dampings=kept).refined(y)
        if without.information(y) < modes.information(y):
            modes = without
    return modes


def _refine(
    frequencies: Array, dampings: Array, y: Array, harmonics: int = 1
) -> tuple[Array, Array]:
    """Move frequencies and dampings to the least squares, the amplitudes being eliminated.

    The first `harmonics` stay multiples of the first. A damping of zero stays.
    """
    count, reach = len(frequencies), 1 / len(y)
    tied = min(harmonics, count)
    multiples: Array = scipy.linalg.block_diag(
        (frequencies[:tied] / frequencies[0])[:, None], np.eye(count - tied)
    )
    free = np.delete(frequencies, np.arange(1, tied))
    # What moves the fundamental moves its highest harmonic by a multiple of that.
    around = reach / multiples.max(axis=0, initial=1)
    decaying = dampings > 0
    # A sinusoid of less than a cycle in the record would be a drift, and run away beyond it.
    low = np.clip(free - around, reach, 0.5)
    high = np.clip(free + around, 1.01 * reach, 0.5 + 1e-9)
    begin = np.clip(free, low, high)
    fastest = FASTEST_DECAY * reach
    low = np.append(low, np.zeros(decaying.sum()))
    high = np.append(high, np.full(decaying.sum(), fastest))
    begin = np.append(begin, np.clip(dampings[decaying], 1e-3 * reach, 0.99 * fastest))

    def parts(moved: Array) -> tuple[Array, Array]:
        rates = np.zeros(count)
        rates[decaying] = moved[len(free) :]
        return np.asarray(multiples @ moved[: len(free)]), rates

    def residual(moved: Array) -> Array:
        return _solve(*parts(moved), y)[1]

    def slopes(moved: Array) -> Array:
        by_each = _slopes(*parts(moved), y)
        return np.hstack([by_each[:, :count] @ multiples, by_each[:, count:][:, decaying]])

    found = scipy.optimize.least_squares(
        residual,
        begin,
        jac=slopes,
        bounds=(low, high),
        x_scale=np.append(around, np.full(decaying.sum(), reach)),
        ftol=1e-12,
        xtol=1e-12,
        max_nfev=50,
    )
    return parts(np.asarray(found.x))


def _slopes(frequencies: Array, dampings: Array, y: Array) -> Array:
    """What the residual of `_solve` does when each frequency, then each damping moves.

    The derivative of the basis, as far as the basis itself cannot make up for it (Kaufman's
    approximation of variable projection).
    """
    index = known(y)
    basis = _basis(frequencies, dampings, index)
    left, sizes, right = np.linalg.svd(basis, full_matrices=False)
    kept = sizes > RESOLUTION * sizes[0]
    left, sizes, right = left[:, kept], sizes[kept], right[kept]
    coefficients = right.T @ ((left.T @ y[index]) / sizes)
    count = len(frequencies)
    cosine, sine = basis[:, 1 : 1 + count], basis[:, 1 + count :]
    a, b = coefficients[1 : 1 + count], coefficients[1 + count :]
    turned = 2 * np.pi * index[:, None] * (b * cosine - a * sine)
    shrunk = -index[:, None] * (a * cosine + b * sine)
    moved = np.hstack([turned, shrunk])
    return np.asarray(left @ (left.T @ moved) - moved)
