"""Fit sinusoids that may decay, an offset and a trend to one channel by least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.common import known
from splitband.baselines.trend import FASTEST, SLOWEST, Shape
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import check
from splitband.runtime.options import saved

RESOLUTION = 0.1
"""Singular values below this share are cut: sinusoids of nearly the same frequency count as one.
By eye."""
AS_HIGH = 0.95
"""Peaks of the spectrum with at least this share of the highest one's power count as equally high.
By eye."""
FASTEST_DECAY = 20.0
"""Most e-foldings of a sinusoid within the record: a faster decay leaves little to fit. By eye."""
FEWEST_CYCLES = 0.5
"""Fewest cycles of a sinusoid within the record: a slower one resembles a constant. By eye."""


@saved
class Modes(NamedTuple):
    """Hold the sinusoids of one channel `y` `(time,)`, NaN in gaps, with an offset and a trend.

    A sinusoid with less than one cycle in the record cannot be told from a drift. It describes the
    drift within the record, and is held constant before and after it.

    Attributes
    ----------
    frequencies : Frequencies in cycles per sample.
    dampings : Decay rates per sample; zero for sustained sinusoids.
    coefficients : Offset, cosine and sine amplitudes, and the size of the trend if there is one.
    samples : Number of samples that were fitted, from index 0 on.
    shape : Shape of the trend; None without one.
    harmonics : Number of leading frequencies that stay multiples of the first one.
    """

    frequencies: Array
    dampings: Array
    coefficients: Array
    samples: int
    shape: Shape | None = None
    harmonics: int = 1

    @classmethod
    def solved(
        cls,
        frequencies: Array,
        dampings: Array,
        y: Array,
        shape: Shape | None = None,
        harmonics: int = 1,
    ) -> Modes:
        """Return these sinusoids with the coefficients that fit `y` best."""
        return cls(frequencies, dampings, np.empty(0), len(y), shape, harmonics)._solve(y)

    @classmethod
    def none(cls, y: Array, shape: Shape | None = None) -> Modes:
        """Return the offset and trend that fit `y` best, without sinusoids."""
        return cls.solved(np.empty(0), np.empty(0), y, shape)

    def _solve(self, y: Array) -> Modes:
        rows = known(y)
        return self._replace(coefficients=_Span.of(self.basis(rows)).coefficients(y[rows]))

    def refined(self, y: Array) -> Modes:
        """Return the local optimum of frequencies, dampings and trend rate for `y`."""
        return _Refinement(self, y).result()

    def with_another(self, y: Array, damping: float, weight: float = 0.0) -> Modes:
        """Add a sinusoid at the peak of the residual's spectrum, and refine all of them.

        A damping of zero stays zero. A positive `weight` emphasises the beginning of the record in
        the search for the peak.
        """
        left = np.nan_to_num(self.residual(y)) * np.exp(-weight * np.arange(len(y)) / len(y))
        frequencies, power = scipy.signal.periodogram(left, nfft=8 * len(y), detrend=False)
        frequency = frequencies[_highest(power, whole=not np.isnan(y).any())]
        more = np.append(self.frequencies, frequency), np.append(self.dampings, damping)
        return self._replace(frequencies=more[0], dampings=more[1]).refined(y)

    def basis(self, index: npt.NDArray[np.number]) -> Array:
        """Return the regressors of the coefficients, `(len(index), coefficients)`."""
        slow = self.frequencies * self.samples < 1
        within = np.clip(index, 0, self.samples - 1)
        at = np.where(slow, within[:, None], index[:, None])
        phase = 2 * np.pi * at * self.frequencies
        cosine, sine = np.cos(phase), np.sin(phase)
        if self.dampings.any():
            # Before the record the amplitude is held, as it would grow there.
            size = np.exp(-np.maximum(at, 0) * self.dampings)
            cosine, sine = size * cosine, size * sine
        columns = [np.ones((len(index), 1)), cosine, sine]
        return np.hstack(columns if self.shape is None else [*columns, self.shape(index)[:, None]])

    def predict(self, index: npt.NDArray[np.number]) -> Array:
        """Return the values at these indices, counted from the first fitted sample."""
        return self.basis(index) @ self.coefficients

    @property
    def beat_slowly(self) -> bool:
        """Return whether two frequencies differ by less than a cycle over the record."""
        return bool((np.diff(np.sort(self.frequencies)) * self.samples < 1).any())

    def residual(self, y: Array) -> Array:
        """Return the residual of `y`, `(time,)`."""
        return y - self.predict(np.arange(len(y)))

    def exact(self, y: Array) -> bool:
        """Return whether the residual is rounding error, so that `information` can only rise."""
        return float(np.nanmean(self.residual(y) ** 2)) <= _rounding(y)

    def information(self, y: Array) -> float:
        """Return the BIC for a Gaussian residual, of at least 1e-8 times the RMS of y."""
        samples, left = len(known(y)), float(np.nanmean(self.residual(y) ** 2))
        variance = max(left, _rounding(y))
        count = len(self.frequencies)
        moving = count - max(min(self.harmonics, count) - 1, 0) + int((self.dampings > 0).sum())
        parameters = 1 + 2 * count + moving
        return samples * float(np.log(variance)) + parameters * float(np.log(samples))

    def in_units(self, offset: float, scale: float) -> Modes:
        """Return the modes of `offset + scale * y`."""
        coefficients = self.coefficients * scale
        coefficients[0] += offset
        return self._replace(coefficients=coefficients)


def _rounding(y: Array) -> float:
    """Return the mean square below which a residual is rounding error: (1e-8 RMS of y) squared."""
    return max(1e-16 * float(np.nanmean(y**2)), 1e-300)


def _highest(power: Array, whole: bool) -> int:
    """Return the index of the highest peak; with gaps, of the first peak of nearly that height.

    Gaps create images of a frequency at higher frequencies.
    """
    highest = 1 + int(np.argmax(power[1:]))
    if whole:
        return highest
    peaks = scipy.signal.argrelmax(power)[0]
    as_high = peaks[power[peaks] >= AS_HIGH * power[highest]]
    return int(as_high[0]) if len(as_high) else highest


class _Refinement:
    """Optimise the nonlinear parameters by least squares; the linear ones are eliminated.

    The nonlinear parameters are, in this order, the frequencies (harmonics stay multiples of the
    first one), the dampings that are not zero, and the rate of an exponential trend.
    """

    def __init__(self, modes: Modes, y: Array) -> None:
        self.modes, self.rows = modes, known(y)
        self.y, self.values = y, y[self.rows]
        self.decaying = modes.dampings > 0
        self.bent = modes.shape is not None and modes.shape.rate > 0
        count = len(modes.frequencies)
        tied = min(modes.harmonics, count)
        self.free = np.delete(modes.frequencies, np.arange(1, tied))
        self.multiples = np.eye(count)
        if tied > 1:
            ratios = (modes.frequencies[:tied] / modes.frequencies[0])[:, None]
            self.multiples = scipy.linalg.block_diag(ratios, np.eye(count - tied))
        self._last: tuple[Array, Modes, Array] | None = None

    def result(self) -> Modes:
        """Return the modes at the local minimum."""
        begin, low, high, scale = (np.concatenate(values) for values in self._limits())
        if not len(begin):
            return self.modes._solve(self.y)
        minimum = scipy.optimize.least_squares(
            self.left,
            np.clip(begin, low, high),
            jac=self.slopes,
            bounds=(low, high),
            x_scale=scale,
            ftol=1e-12,
            xtol=1e-12,
            max_nfev=50,
        )
        return self._at(np.asarray(minimum.x))[0]

    def _limits(self) -> tuple[list[Array], list[Array], list[Array], list[Array]]:
        """Return initial values, lower and upper bounds, and step scales of the parameters."""
        reach = 1 / len(self.y)
        # The highest harmonic moves by a multiple of the step of the fundamental.
        around = reach / self.multiples.max(axis=0, initial=1)
        slowest = FEWEST_CYCLES * reach
        low = np.clip(self.free - around, slowest, 0.5)
        high = np.clip(self.free + around, 1.01 * slowest, 0.5 + 1e-9)
        dampings = self.modes.dampings[self.decaying]
        rate = np.array([self.modes.shape.rate] if self.modes.shape and self.bent else [])
        each = np.full(len(dampings), reach)
        return (
            [self.free, np.clip(dampings, 1e-3 * reach, 0.99 * FASTEST_DECAY * reach), rate],
            [low, 0 * each, np.full(len(rate), SLOWEST * reach)],
            [high, FASTEST_DECAY * each, np.full(len(rate), FASTEST * reach)],
            [around, each, np.full(len(rate), reach)],
        )

    def left(self, moved: Array) -> Array:
        """Return the compressed residual of the measured samples, see `_at`."""
        return self._at(moved)[1][:, -1]

    def slopes(self, moved: Array) -> Array:
        """Return the Jacobian of the compressed residual."""
        return self._at(moved)[1][:, :-1]

    def _at(self, moved: Array) -> tuple[Modes, Array]:
        """Return the modes with these values, and a triangular factor of Jacobian and residual.

        The factor has the same inner products as the Jacobian and the residual, which is all that
        the solver needs, and far fewer rows. The last result is cached, as the solver evaluates the
        residual and then the Jacobian at the same values.
        """
        if self._last is None or not np.array_equal(self._last[0], moved):
            check()
            modes = self._with(moved)
            span = _Span.of(modes.basis(self.rows))
            modes = modes._replace(coefficients=span.coefficients(self.values))
            left = self.values - span.basis @ modes.coefficients
            columns = np.column_stack([self._slopes(modes, span), left])
            triangle: Array = np.asarray(np.linalg.qr(columns, mode="r"))
            self._last = moved.copy(), modes, triangle
        return self._last[1], self._last[2]

    def _with(self, moved: Array) -> Modes:
        """Return the modes with these values, without updating their coefficients."""
        modes, free = self.modes, len(self.free)
        rates = np.zeros(len(modes.frequencies))
        rates[self.decaying] = moved[free : free + self.decaying.sum()]
        shape = modes.shape
        if shape is not None and self.bent:
            shape = shape._replace(rate=float(moved[-1]))
        frequencies = np.asarray(self.multiples @ moved[:free])
        return modes._replace(frequencies=frequencies, dampings=rates, shape=shape)

    def _slopes(self, modes: Modes, span: _Span) -> Array:
        """Return the Jacobian of the residual with respect to the parameters.

        This is the derivative of the basis, projected onto the complement of its span (Kaufman's
        approximation of variable projection).
        """
        basis, index = span.basis, self.rows
        count = len(modes.frequencies)
        cosine, sine = basis[:, 1 : 1 + count], basis[:, 1 + count : 1 + 2 * count]
        a, b = modes.coefficients[1 : 1 + count], modes.coefficients[1 + count : 1 + 2 * count]
        turned = 2 * np.pi * index[:, None] * (b * cosine - a * sine)
        shrunk = -index[:, None] * (a * cosine + b * sine)
        columns = [turned @ self.multiples, shrunk[:, self.decaying]]
        if modes.shape is not None and self.bent:
            columns.append((modes.coefficients[-1] * modes.shape.by_rate(index))[:, None])
        by_value = np.hstack(columns)
        return np.asarray(basis @ span.coefficients(by_value) - by_value)


class _Span(NamedTuple):
    """Represent the span of a basis `(time, n)`, without nearly dependent directions.

    It is computed from the Gram matrix, in a tenth of the time of a singular value decomposition of
    the basis. The loss of precision is harmless: the directions that `RESOLUTION` keeps have a
    condition number of 10 at most.

    Attributes
    ----------
    basis : The columns.
    inverse : The pseudo-inverse of their Gram matrix, `(n, n)`.
    """

    basis: Array
    inverse: Array

    @classmethod
    def of(cls, basis: Array) -> _Span:
        """Return the span of these columns."""
        squares, directions = scipy.linalg.eigh(basis.T @ basis)
        kept = squares > RESOLUTION**2 * squares[-1]
        directions = directions[:, kept]
        return cls(basis, (directions / squares[kept]) @ directions.T)

    def coefficients(self, values: Array) -> Array:
        """Return the columns' coefficients that fit `values` `(time, ...)` best."""
        found = self.inverse @ (self.basis.T @ values)
        # A second step corrects rounding errors of the first.
        left = values - self.basis @ found
        return np.asarray(found + self.inverse @ (self.basis.T @ left))
