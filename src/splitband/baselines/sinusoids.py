"""Fit sustained or decaying sinusoids and a trend to channels by least squares.

A strong baseline for records without inputs: the free response of a linear system is a sum of
decaying sinusoids and exponentials, its response to sinusoids a sum of sinusoids. The Bayesian
information criterion (BIC) decides on the number of sinusoids, on decay and on a trend.
`baselines.seasonal` fits Fourier series with the same code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import check

MAX_FIT_SAMPLES = 4000
"""Largest number of measured samples of a channel in a least-squares fit. Bounds the time."""
MAX_ROWS_BACK = 10 * MAX_FIT_SAMPLES
"""Largest number of rows before a record's end with these samples, if it has gaps. Bounds the time.
"""
MOST_SINUSOIDS = 10
"""Largest number of sinusoids of a channel. Bounds the time."""
MOST_BESIDE_TREND = 6
"""Largest number of sinusoids beside a trend. Bounds the time."""
DAMPING = 0.3
"""Initial decay rate of a sinusoid in a fit, in e-foldings over the record. By eye."""
FAST_DAMPING = 3.0
"""Initial decay rate of an exponential, or of a vibration beside a Fourier series. By eye."""
RATE = 3
"""Weight in the strict BIC of a frequency, a decay rate or a slope, in parameters: its information
grows with the third power of the number of samples (P. M. Djuric, IEEE Transactions on Signal
Processing 44, 1996). Chosen on development records (docs/developers/rules.md)."""
RESOLUTION = 0.1
"""Smallest singular value of regressors, as a share of the largest: sinusoids of nearly equal
frequencies count as one. By eye."""
AS_HIGH = 0.95
"""Least power of a peak as high as the highest, as a share of it. Of several, the peak of the
lowest frequency is chosen, as gaps create images at higher ones. By eye."""
FASTEST_DECAY = 20.0
"""Largest decay rate of a sinusoid in a fit: a faster one leaves few samples to fit. By eye."""
FEWEST_CYCLES = 0.5
"""Fewest cycles of a sinusoid within the record: a slower one resembles a constant. By eye."""
MOST_BLOCKS, FEWEST_BLOCKS = 256, 15
"""Largest and smallest number of block means in the fit of a trend. Bounds the time."""


@dataclass(frozen=True, eq=False)
class Sinusoids:
    """The sinusoids of one channel `y` `(time,)`, NaN in gaps, with an offset and a line.

    A sinusoid with less than one cycle in the record is not distinguishable from a drift: it is
    constant before and after the record.

    frequencies : Frequencies in cycles per sample; 0 for a decaying exponential.
    dampings : Decay rates per sample; zero for sustained sinusoids.
    coefficients : Offset, cosine and sine amplitudes, and the size of a line.
    samples : Number of fitted samples, from index 0 on.
    line : Whether there is a straight line, constant before index 0.
    harmonics : Number of leading frequencies tied as multiples of the first one.
    """

    frequencies: Array
    dampings: Array
    coefficients: Array
    samples: int
    line: bool = False
    harmonics: int = 0

    def basis(self, index: npt.NDArray[np.number]) -> Array:
        """Return the regressors of the coefficients, `(len(index), coefficients)`."""
        slow = (self.frequencies > 0) & (self.frequencies * self.samples < 1)
        within = np.clip(index, 0, self.samples - 1)
        at = np.where(slow, within[:, None], index[:, None])
        phase = 2 * np.pi * at * self.frequencies
        cosine, sine = np.cos(phase), np.sin(phase)
        if self.dampings.any():
            # Before the record the amplitude is constant: it would grow there.
            size = np.exp(-np.maximum(at, 0) * self.dampings)
            cosine, sine = size * cosine, size * sine
        columns = [np.ones((len(index), 1)), cosine, sine]
        if self.line:  # of mean 0 and deviation 1
            columns.append(np.sqrt(12) * (np.maximum(index, 0) / self.samples - 0.5)[:, None])
        return np.hstack(columns)

    def predict(self, index: npt.NDArray[np.number]) -> Array:
        """Return the values at these indices, counted from the first fitted sample."""
        return self.basis(index) @ self.coefficients

    def residual(self, y: Array) -> Array:
        """Return the residual of `y`, `(time,)`."""
        return y - self.predict(np.arange(len(y)))

    @property
    def leaders(self) -> list[int]:
        """Return the indices of free frequencies: the first harmonic, but no other, no zeros."""
        tied = range(1, self.harmonics)
        return [i for i, f in enumerate(self.frequencies) if f > 0 and i not in tied]

    def bic(self, y: Array, strict: bool = False) -> float:
        """Return the Bayesian information criterion of the fit to `y`; see `bic`."""
        amplitudes = 2 * len(self.frequencies) - int((self.frequencies == 0).sum())
        rates = self.line + len(self.leaders) + int((self.dampings > 0).sum())
        weight = RATE if strict else 1
        return bic(y, self.residual(y), 1 + amplitudes + weight * rates, strict)

    def with_another(self, y: Array, damping: float) -> Sinusoids:
        """Add a sinusoid at the peak of the residual's spectrum, and refine all sinusoids.

        `damping`: decay rate per sample; 0 for a sustained sinusoid. The spectrum is that of the
        residual times the decay.
        """
        left = np.nan_to_num(self.residual(y)) * np.exp(-damping * np.arange(len(y)))
        frequencies, power = scipy.signal.periodogram(left, nfft=8 * len(y), detrend=False)
        power[0] = 0.0
        peaks = scipy.signal.argrelmax(power)[0]
        high = peaks[power[peaks] >= AS_HIGH * power.max()]
        peak = high[0] if len(high) else int(np.argmax(power))
        extended = np.append(self.frequencies, frequencies[peak]), np.append(self.dampings, damping)
        return replace(self, frequencies=extended[0], dampings=extended[1]).refined(y)

    def solved(self, y: Array) -> Sinusoids:
        """Return the fit with the best coefficients for `y`."""
        rows = known(y)
        return replace(self, coefficients=_solver(self.basis(rows))(y[rows]))

    def refined(self, y: Array) -> Sinusoids:
        """Return the local optimum of frequencies and dampings for `y` by variable projection.

        The coefficients are eliminated; the Jacobian is Kaufman's approximation (L. Kaufman, BIT
        15, 1975).
        """
        rows, count = known(y), len(self.frequencies)
        values, decaying = y[rows], self.dampings > 0
        free, multiples = self.frequencies[self.leaders], np.eye(count)[:, self.leaders]
        if self.harmonics:
            series = self.frequencies[: self.harmonics]
            multiples[: self.harmonics, 0] = series / series[0]

        @lru_cache(maxsize=1)  # the solver asks for residual and Jacobian at the same values
        def at(*moved: float) -> tuple[Sinusoids, Array]:
            """Return the fit, and a triangular factor of the columns of Jacobian and residual.

            The solver needs only inner products of the columns, which are those of the factor.
            """
            check()
            dampings = np.zeros(count)
            dampings[decaying] = moved[len(free) :]
            new = replace(
                self, frequencies=multiples @ np.array(moved[: len(free)]), dampings=dampings
            )
            basis = new.basis(rows)
            solved = _solver(basis)
            coefficients = solved(values)
            a, b = coefficients[1 : 1 + count], coefficients[1 + count : 1 + 2 * count]
            cosine, sine = basis[:, 1 : 1 + count], basis[:, 1 + count : 1 + 2 * count]
            turned = 2 * np.pi * rows[:, None] * (b * cosine - a * sine)
            shrunk = -rows[:, None] * (a * cosine + b * sine)
            slopes = np.hstack([turned @ multiples, shrunk[:, decaying]])
            columns = [basis @ solved(slopes) - slopes, (values - basis @ coefficients)[:, None]]
            triangle: Array = np.asarray(np.linalg.qr(np.hstack(columns), mode="r"))
            return replace(new, coefficients=coefficients), triangle

        def left(moved: Array) -> Array:
            return at(*moved)[1][:, -1]

        def jacobian(moved: Array) -> Array:
            return at(*moved)[1][:, :-1]

        if not len(free) and not decaying.any():
            return self.solved(y)
        reach = 1 / len(y)
        # The highest harmonic moves by a multiple of the step of the fundamental.
        around = reach / multiples.max(axis=0)
        slowest, decay = FEWEST_CYCLES * reach, FASTEST_DECAY * reach
        ones, dampings = np.ones(decaying.sum()), self.dampings[decaying]
        low = np.append(np.clip(free - around, slowest, 0.5), 0 * ones)
        high = np.append(np.clip(free + around, 1.01 * slowest, 0.5 + 1e-9), decay * ones)
        begin = np.append(free, np.clip(dampings, 1e-3 * reach, 0.99 * decay))
        minimum = scipy.optimize.least_squares(
            left,
            np.clip(begin, low, high),
            jac=jacobian,
            bounds=(low, high),
            x_scale=np.append(around, reach * ones),
            ftol=1e-8,
            xtol=1e-12,
            max_nfev=50,
        )
        return at(*minimum.x)[0]

    def grown(self, y: Array, damping: float, most: int, strict: bool = False) -> Sinusoids:
        """Return the fit with the lowest BIC among those with up to `most` further sinusoids.

        Sinusoids are added one by one, with the initial decay rate `damping`; 0 stays 0.
        """
        fits = [self]
        for _ in range(most):
            fits.append(fits[-1].with_another(y, damping))
        return min(fits, key=lambda fit: fit.bic(y, strict))

    def sustained(self, y: Array) -> Sinusoids:
        """Return the fit without decays that raise the BIC, the slowest first."""
        best = self
        for i in np.argsort(self.dampings):
            if best.dampings[i] > 0 and best.frequencies[i] > 0:
                dampings = np.where(np.arange(len(best.dampings)) == i, 0.0, best.dampings)
                new = replace(best, dampings=dampings).refined(y)
                best = min(best, new, key=lambda fit: fit.bic(y))
        return best


@dataclass(frozen=True, eq=False)
class SinusoidRegression:
    """Sinusoids, offsets and lines by channel; `harmonic` fits them.

    channels : The sinusoids by channel.
    begin : Index of the first fitted sample, at which decays begin.
    """

    channels: tuple[Sinusoids, ...]
    begin: int = 0

    @classmethod
    def fit(cls, y: Array, of_channel: Callable[[Array], Sinusoids]) -> SinusoidRegression:
        """Fit the channels of `y` `(time, ny)`, NaN in gaps, scaled to their ranges.

        The last `MAX_FIT_SAMPLES` samples of a long record are fitted.
        """
        begin, y = recent(y)
        channels = []
        for channel in y.T:
            offset, scale = units(channel)
            sinusoids = of_channel((channel - offset) / scale)
            coefficients = scale * sinusoids.coefficients
            coefficients[0] += offset
            channels.append(replace(sinusoids, coefficients=coefficients))
        return cls(tuple(channels), begin)

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples from `start` on, `(steps, ny)`; 0 is the record's first sample."""
        index = start - self.begin + np.arange(steps)
        return np.stack([channel.predict(index) for channel in self.channels], axis=1)

    def __str__(self) -> str:
        return "; ".join(map(_described, self.channels))


def _described(channel: Sinusoids) -> str:
    """Return the components of a channel in words."""
    count, series, parts = len(channel.frequencies), channel.harmonics, []
    decaying = int((channel.dampings[channel.frequencies > 0] > 0).sum())
    trend = "a constant"
    if channel.line:
        trend = "a straight line"
    elif (channel.frequencies == 0).any():
        trend = "an exponential"
    count -= int((channel.frequencies == 0).sum())
    if series:
        period = f"a period of {1 / channel.frequencies[0]:.6g} samples"
        parts.append(f"{series} harmonic{'s' * (series > 1)} of {period}")
    if count > series:
        of_them = f" ({decaying} decaying)" if decaying else ""
        parts.append(f"{count - series} sinusoid{'s' * (count - series > 1)}{of_them}")
    return ", ".join([*parts, trend])


def harmonic(y: Array) -> SinusoidRegression:
    """Fit a trend and sustained or decaying sinusoids to `y` `(time, ny)`."""

    def of_channel(y: Array) -> Sinusoids:
        most = min(MOST_SINUSOIDS, max((len(known(y)) - 2) // 4, 0))
        start = trend(y).refined(y)
        lasting = start.grown(y, 0.0, most)
        decaying = start.grown(y, DAMPING / len(y), most).sustained(y)
        return min(lasting, decaying, key=lambda fit: fit.bic(y))

    return SinusoidRegression.fit(y, of_channel)


def trend(y: Array) -> Sinusoids:
    """Return the trend of a channel, without an offset: nothing, a line or an exponential.

    Trend and sinusoids are fitted together, to block means: either could pass for the other.
    """
    offset, scale = units(y)
    length = -(-len(y) // MOST_BLOCKS)
    missing = -len(y) % length
    by_block = (np.append(np.full(missing, np.nan), y) - offset).reshape(-1, length) / scale
    counts = (~np.isnan(by_block)).sum(axis=1)
    means = np.full(len(counts), np.nan)
    np.divide(np.nansum(by_block, axis=1), counts, out=means, where=counts > 0)
    most = min(MOST_BESIDE_TREND, ((counts > 0).sum() - 3) // 4)
    none, blocks = np.zeros(0), len(means)
    level = Sinusoids(none, none, np.zeros(1), blocks)
    if (counts > 0).sum() < FEWEST_BLOCKS:
        return replace(level, samples=len(y))
    decaying = replace(level, frequencies=np.zeros(1), dampings=np.array([FAST_DAMPING / blocks]))
    starts = level, replace(level, line=True), decaying
    best = min(
        (start.refined(means).grown(means, 0.0, most, strict=True) for start in starts),
        key=lambda fit: fit.bic(means, strict=True),
    )
    centre = (length - 1) / 2 - missing  # sample at the centre of the first block
    decays = np.flatnonzero(best.frequencies == 0)
    sizes = best.coefficients[1 + decays] * np.exp(best.dampings[decays] * centre / length)
    line = [best.coefficients[-1] * len(y) / (blocks * length)] * best.line
    coefficients = scale * np.array([0.0, *sizes, *np.zeros(len(decays)), *line])
    dampings = best.dampings[decays] / length
    return Sinusoids(np.zeros(len(decays)), dampings, coefficients, len(y), best.line)


def bic(y: Array, left: Array, parameters: int, strict: bool = False) -> float:
    """Return the BIC of a fit to `y` with residuals `left`, NaN in gaps.

    Residuals are assumed white or, if `strict`, autoregressive of first order. A residual of 1e-8
    times the RMS of `y` is rounding error, so that the criterion can only rise.
    """
    measured = left[~np.isnan(left)]
    variance = float(np.mean(measured**2))
    if strict and len(measured) > 2 and (power := float(measured[:-1] @ measured[:-1])) > 0:
        alike = max(float(measured[:-1] @ measured[1:]) / power, 0.0)
        variance = min(variance, float(np.mean((measured[1:] - alike * measured[:-1]) ** 2)))
    variance = max(variance, 1e-16 * float(np.nanmean(y**2)), 1e-300)
    return float(len(measured) * np.log(variance) + parameters * np.log(len(measured)))


def recent(y: Array) -> tuple[int, Array]:
    """Return the first fitted index of `y` `(time, ny)`, and `y` from there on.

    All but the last `MAX_FIT_SAMPLES` measured samples of a channel become NaN, as do samples more
    than `MAX_ROWS_BACK` rows before the end, unless a channel has no later ones.
    """
    y = y.copy()
    for channel in y.T:
        last = known(channel)[-MAX_FIT_SAMPLES:]
        near = last[last >= len(y) - MAX_ROWS_BACK]
        channel[: near[0] if len(near) else last[0]] = np.nan
    begin = min(int(known(channel)[0]) for channel in y.T)
    return begin, y[begin:]


def known(y: Array) -> npt.NDArray[np.int_]:
    """Return the indices of the measured samples of a channel `(time,)`."""
    return np.flatnonzero(~np.isnan(y))


def units(y: Array) -> tuple[float, float]:
    """Return the mean and range of a channel; for a constant channel its value and 1."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    return (float(np.nanmean(y)), high - low) if low < high else (low, 1.0)


def _solver(basis: Array) -> Callable[[Array], Array]:
    """Return a function from values `(time, ...)` to the columns' best coefficients.

    The Gram matrix excludes nearly dependent directions, in a tenth of the time of a singular value
    decomposition. A second step corrects rounding errors of the first.
    """
    squares, directions = scipy.linalg.eigh(basis.T @ basis)
    strong = squares > RESOLUTION**2 * squares[-1]
    inverse = (directions[:, strong] / squares[strong]) @ directions[:, strong].T

    def solved(values: Array) -> Array:
        solution = inverse @ (basis.T @ values)
        return np.asarray(solution + inverse @ (basis.T @ (values - basis @ solution)))

    return solved
