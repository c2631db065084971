"""Fit sinusoids, which may decay, and a trend to each channel by least squares.

A strong baseline for records without inputs: the free response of a linear system is a sum of
decaying sinusoids and exponentials, its response to sinusoids a sum of these. One rule decides how
many sinusoids there are, which of them decay, and whether there is a trend: the Bayesian
information criterion (BIC).
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
"""Most measured samples of a channel in a least-squares fit, to limit its time. Bounds the time."""
MAX_ROWS_BACK = 10 * MAX_FIT_SAMPLES
"""Where there are gaps, only so many rows before a record's end are searched for them. Bounds the
time."""
MOST_SINUSOIDS = 10
"""Largest number of sinusoids of a channel. Bounds the time."""
MOST_BESIDE_TREND = 6
"""Largest number of sinusoids that are fitted along with a trend. Bounds the time."""
DAMPING = 0.3
"""Decay within the record, in e-foldings, with which the fit of a decaying sinusoid begins.
By eye."""
FAST_DAMPING = 3.0
"""The same of an exponential, and of a vibration beside a Fourier series. By eye."""
RATE = 3
"""Parameters of the strict BIC that a frequency, a decay rate or a slope counts as: its information
grows with the third power of the number of samples (P. M. Djuric, IEEE Transactions on Signal
Processing 44, 1996). Chosen on development records (docs/results/rules.md)."""
RESOLUTION = 0.1
"""Singular values below this share are cut: sinusoids of nearly the same frequency count as one.
By eye."""
AS_HIGH = 0.95
"""Of several peaks of the spectrum with at least this share of the highest one's power the first
is taken: gaps create images of a frequency at higher ones. By eye."""
FASTEST_DECAY = 20.0
"""Most e-foldings of a sinusoid within the record: a faster decay leaves little to fit. By eye."""
FEWEST_CYCLES = 0.5
"""Fewest cycles of a sinusoid within the record: a slower one resembles a constant. By eye."""
MOST_BLOCKS, FEWEST_BLOCKS = 256, 15
"""Most block means by which a trend is found, to limit its time; with fewer than 15 there is none.
Bounds the time."""


@dataclass(frozen=True, eq=False)
class Sinusoids:
    """Hold the sinusoids of one channel `y` `(time,)`, NaN in gaps, with an offset and a line.

    A sinusoid with less than one cycle in the record cannot be told from a drift. It describes the
    drift within the record, and is held constant before and after it.

    Attributes
    ----------
    frequencies : Frequencies in cycles per sample; 0 for an exponential that decays.
    dampings : Decay rates per sample; zero for sustained sinusoids.
    coefficients : Offset, cosine and sine amplitudes, and the size of the line if there is one.
    samples : Number of samples that were fitted, from index 0 on.
    line : Whether there is a straight line, constant before index 0.
    harmonics : Number of leading frequencies that stay multiples of the first one.
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
            # Before the record the amplitude is held, as it would grow there.
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
        """Return which frequencies are free: no other harmonics than the first, no zeros."""
        tied = range(1, self.harmonics)
        return [i for i, f in enumerate(self.frequencies) if f > 0 and i not in tied]

    def bic(self, y: Array, strict: bool = False) -> float:
        """Return the Bayesian information criterion of the fit to `y`; see `bic`."""
        amplitudes = 2 * len(self.frequencies) - int((self.frequencies == 0).sum())
        rates = self.line + len(self.leaders) + int((self.dampings > 0).sum())
        each = RATE if strict else 1
        return bic(y, self.residual(y), 1 + amplitudes + each * rates, strict)

    def with_another(self, y: Array, damping: float) -> Sinusoids:
        """Add a sinusoid at the peak of the residual's spectrum, and refine all of them.

        `damping`: its decay rate per sample; 0 for one that stays sustained. The samples count the
        less in the spectrum the more it has decayed.
        """
        left = np.nan_to_num(self.residual(y)) * np.exp(-damping * np.arange(len(y)))
        frequencies, power = scipy.signal.periodogram(left, nfft=8 * len(y), detrend=False)
        power[0] = 0.0
        peaks = scipy.signal.argrelmax(power)[0]
        high = peaks[power[peaks] >= AS_HIGH * power.max()]
        peak = high[0] if len(high) else int(np.argmax(power))
        more = np.append(self.frequencies, frequencies[peak]), np.append(self.dampings, damping)
        return replace(self, frequencies=more[0], dampings=more[1]).refined(y)

    def solved(self, y: Array) -> Sinusoids:
        """Return it with the coefficients that fit `y` best."""
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

            It has the same inner products as the columns, which is all that the solver needs.
            """
            check()
            dampings = np.zeros(count)
            dampings[decaying] = moved[len(free) :]
            new = replace(
                self, frequencies=multiples @ np.array(moved[: len(free)]), dampings=dampings
            )
            basis = new.basis(rows)
            solved = _solver(basis)
            found = solved(values)
            a, b = found[1 : 1 + count], found[1 + count : 1 + 2 * count]
            cosine, sine = basis[:, 1 : 1 + count], basis[:, 1 + count : 1 + 2 * count]
            turned = 2 * np.pi * rows[:, None] * (b * cosine - a * sine)
            shrunk = -rows[:, None] * (a * cosine + b * sine)
            slopes = np.hstack([turned @ multiples, shrunk[:, decaying]])
            columns = [basis @ solved(slopes) - slopes, (values - basis @ found)[:, None]]
            triangle: Array = np.asarray(np.linalg.qr(np.hstack(columns), mode="r"))
            return replace(new, coefficients=found), triangle

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
        each, dampings = np.ones(decaying.sum()), self.dampings[decaying]
        low = np.append(np.clip(free - around, slowest, 0.5), 0 * each)
        high = np.append(np.clip(free + around, 1.01 * slowest, 0.5 + 1e-9), decay * each)
        begin = np.append(free, np.clip(dampings, 1e-3 * reach, 0.99 * decay))
        minimum = scipy.optimize.least_squares(
            left,
            np.clip(begin, low, high),
            jac=jacobian,
            bounds=(low, high),
            x_scale=np.append(around, reach * each),
            ftol=1e-8,
            xtol=1e-12,
            max_nfev=50,
        )
        return at(*minimum.x)[0]

    def grown(self, y: Array, damping: float, most: int, strict: bool = False) -> Sinusoids:
        """Return the fit with the lowest BIC of those with up to `most` further sinusoids.

        They are added one by one, with the initial decay rate `damping`; 0 stays 0.
        """
        found = [self]
        for _ in range(most):
            found.append(found[-1].with_another(y, damping))
        return min(found, key=lambda fit: fit.bic(y, strict))

    def sustained(self, y: Array) -> Sinusoids:
        """Return it without the decays that raise the BIC, the slowest first."""
        best = self
        for i in np.argsort(self.dampings):
            if best.dampings[i] > 0 and best.frequencies[i] > 0:
                kept = np.where(np.arange(len(best.dampings)) == i, 0.0, best.dampings)
                new = replace(best, dampings=kept).refined(y)
                best = min(best, new, key=lambda fit: fit.bic(y))
        return best


@dataclass(frozen=True, eq=False)
class SinusoidRegression:
    """Describe each channel by sinusoids, an offset and a line; `harmonic` fits them.

    Attributes
    ----------
    channels : The sinusoids of each channel.
    begin : Index of the first fitted sample, from which on they decay.
    """

    channels: tuple[Sinusoids, ...]
    begin: int = 0

    @classmethod
    def fit(cls, y: Array, of_channel: Callable[[Array], Sinusoids]) -> SinusoidRegression:
        """Fit `y` `(time, ny)`, NaN in gaps, each channel by itself, scaled to its range.

        The last `MAX_FIT_SAMPLES` samples of a long record are fitted.
        """
        begin, y = recent(y)
        channels = []
        for channel in y.T:
            offset, scale = units(channel)
            found = of_channel((channel - offset) / scale)
            coefficients = scale * found.coefficients
            coefficients[0] += offset
            channels.append(replace(found, coefficients=coefficients))
        return cls(tuple(channels), begin)

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples from `start` on, `(steps, ny)`; 0 is the first of the record."""
        index = start - self.begin + np.arange(steps)
        return np.stack([channel.predict(index) for channel in self.channels], axis=1)

    def __str__(self) -> str:
        return "; ".join(map(_described, self.channels))


def _described(found: Sinusoids) -> str:
    """Return what a channel consists of."""
    count, series, said = len(found.frequencies), found.harmonics, []
    decaying = int((found.dampings[found.frequencies > 0] > 0).sum())
    trend = "a constant"
    if found.line:
        trend = "a straight line"
    elif (found.frequencies == 0).any():
        trend = "an exponential"
    count -= int((found.frequencies == 0).sum())
    if series:
        period = f"a period of {1 / found.frequencies[0]:.6g} samples"
        said.append(f"{series} harmonic{'s' * (series > 1)} of {period}")
    if count > series:
        of_them = f" ({decaying} decaying)" if decaying else ""
        said.append(f"{count - series} sinusoid{'s' * (count - series > 1)}{of_them}")
    return ", ".join([*said, trend])


def harmonic(y: Array) -> SinusoidRegression:
    """Fit a trend and sinusoids, each sustained or decaying, to `y` `(time, ny)`."""

    def of_channel(y: Array) -> Sinusoids:
        most = min(MOST_SINUSOIDS, max((len(known(y)) - 2) // 4, 0))
        start = trend(y).refined(y)
        lasting = start.grown(y, 0.0, most)
        decaying = start.grown(y, DAMPING / len(y), most).sustained(y)
        return min(lasting, decaying, key=lambda fit: fit.bic(y))

    return SinusoidRegression.fit(y, of_channel)


def trend(y: Array) -> Sinusoids:
    """Return the trend of a channel, without an offset: nothing, a line or an exponential.

    Sinusoids are fitted along with it, to block means, so that neither is mistaken for the other.
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
    # The centre of the first block is at this sample.
    centre = (length - 1) / 2 - missing
    kept = np.flatnonzero(best.frequencies == 0)
    sizes = best.coefficients[1 + kept] * np.exp(best.dampings[kept] * centre / length)
    line = [best.coefficients[-1] * len(y) / (blocks * length)] * best.line
    coefficients = scale * np.array([0.0, *sizes, *np.zeros(len(kept)), *line])
    dampings = best.dampings[kept] / length
    return Sinusoids(np.zeros(len(kept)), dampings, coefficients, len(y), best.line)


def bic(y: Array, left: Array, parameters: int, strict: bool = False) -> float:
    """Return the BIC of a fit to `y` with residuals `left`, NaN in gaps.

    They are taken to be white, or, if it is `strict`, to be autoregressive of first order. A
    residual of 1e-8 times the RMS of `y` is rounding error, so that the criterion can only rise.
    """
    seen = left[~np.isnan(left)]
    variance = float(np.mean(seen**2))
    if strict and len(seen) > 2 and (power := float(seen[:-1] @ seen[:-1])) > 0:
        alike = max(float(seen[:-1] @ seen[1:]) / power, 0.0)
        variance = min(variance, float(np.mean((seen[1:] - alike * seen[:-1]) ** 2)))
    variance = max(variance, 1e-16 * float(np.nanmean(y**2)), 1e-300)
    return float(len(seen) * np.log(variance) + parameters * np.log(len(seen)))


def recent(y: Array) -> tuple[int, Array]:
    """Return the first index of `y` `(time, ny)` that is fitted, and `y` from there on.

    The last `MAX_FIT_SAMPLES` measured samples of each channel are kept; others become NaN.
    Samples more than `MAX_ROWS_BACK` rows before the end are dropped too, unless a channel has no
    later ones.
    """
    y = y.copy()
    for channel in y.T:
        last = known(channel)[-MAX_FIT_SAMPLES:]
        near = last[last >= len(y) - MAX_ROWS_BACK]
        channel[: near[0] if len(near) else last[0]] = np.nan
    begin = min(int(known(channel)[0]) for channel in y.T)
    return begin, y[begin:]


def known(y: Array) -> npt.NDArray[np.int_]:
    """Return the indices at which a channel `(time,)` was measured."""
    return np.flatnonzero(~np.isnan(y))


def units(y: Array) -> tuple[float, float]:
    """Return the mean and range of a channel; for a constant channel its value and 1."""
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    return (float(np.nanmean(y)), high - low) if low < high else (low, 1.0)


def _solver(basis: Array) -> Callable[[Array], Array]:
    """Return a function from values `(time, ...)` to the columns' best coefficients.

    Nearly dependent directions are left out, by the Gram matrix, in a tenth of the time of a
    singular value decomposition. A second step corrects rounding errors of the first.
    """
    squares, directions = scipy.linalg.eigh(basis.T @ basis)
    kept = squares > RESOLUTION**2 * squares[-1]
    inverse = (directions[:, kept] / squares[kept]) @ directions[:, kept].T

    def solved(values: Array) -> Array:
        found = inverse @ (basis.T @ values)
        return np.asarray(found + inverse @ (basis.T @ (values - basis @ found)))

    return solved
