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


RESOLUTION = 0.1
"""Sinusoids too close to be told apart are fitted as one: singular values below this are cut."""


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

        Compared are the lags up to half the record at which the record resembles itself: the
        local minima of its mean squared difference at a lag.
        """
        errors = {lag: _backward_error(y, lag) for lag in sorted(_self_similar_lags(y))}
        # A period and its multiples tie up to rounding: the shortest one is meant.
        good_enough = min(errors.values()) * (1 + 1e-9) + 1e-24 * float(np.mean(y**2))
        lag = next(lag for lag, error in errors.items() if error <= good_enough)
        return cls(y[len(y) - lag :].copy(), len(y))

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


@dataclass(frozen=True, eq=False)
class HarmonicRegression:
    """A sum of sinusoids and an offset, by least squares; use `HarmonicRegression.fit`.

    Attributes
    ----------
    frequencies : In cycles per sample, one array for each channel.
    coefficients : Offset, then cosine and sine amplitudes, one array for each channel.
    """

    frequencies: tuple[Array, ...]
    coefficients: tuple[Array, ...]

    @classmethod
    def fit(cls, y: Array, sinusoids: int | None = None) -> HarmonicRegression:
        """Fit `y` `(time, ny)`, each channel by itself.

        Sinusoids are added one by one at the peak of the residual's spectrum and then moved
        together to the least squares. By default as many as the Bayesian information criterion
        is willing to pay for, at most 10.
        """
        fitted = [_fit_channel(channel, sinusoids) for channel in y.T]
        return cls(tuple(f for f, _ in fitted), tuple(c for _, c in fitted))

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        index = np.arange(start, start + steps)
        channels = zip(self.frequencies, self.coefficients, strict=True)
        return np.stack([_basis(f, index) @ c for f, c in channels], axis=1)

    def __str__(self) -> str:
        counts = "+".join(str(len(f)) for f in self.frequencies)
        return f"{counts} sinusoid(s) and an offset"


def _self_similar_lags(y: Array, most: int = 200) -> list[int]:
    """Lags up to half of `y` with the smallest local minima of mean (y_n - y_{n+lag})^2."""
    n = len(y)
    lags = np.arange(1, n // 2 + 1)
    centred = y - y.mean(axis=0)
    power = np.concatenate([[0.0], np.cumsum((centred**2).sum(axis=1))])
    products = sum(
        scipy.signal.correlate(c, c, mode="full", method="fft")[n - 1 :] for c in centred.T
    )
    products = np.asarray(products)[lags]
    difference = (power[n - lags] + power[n] - power[lags] - 2 * products) / (n - lags)
    minima = scipy.signal.argrelmin(np.append(difference, np.inf))[0]  # the last lag may be one
    ranked = minima[np.argsort(difference[minima], kind="stable")]
    return [int(lags[i]) for i in ranked[:most]] or [int(lags[-1])]


def _backward_error(y: Array, lag: int) -> float:
    """Mean squared error of the last period repeated over all earlier samples."""
    period, earlier = y[-lag:], y[:-lag]
    repeated = period[(np.arange(len(earlier)) - len(y)) % lag]
    return float(np.mean((earlier - repeated) ** 2))


def _basis(frequencies: Array, index: npt.NDArray[np.int_]) -> Array:
    phase = 2 * np.pi * np.outer(index, frequencies)
    return np.hstack([np.ones((len(index), 1)), np.cos(phase), np.sin(phase)])


def _solve(frequencies: Array, y: Array) -> tuple[Array, Array]:
    basis = _basis(frequencies, np.arange(len(y)))
    coefficients = np.linalg.lstsq(basis, y, rcond=RESOLUTION)[0].astype(np.float64)
    return coefficients, y - basis @ coefficients


def _fit_channel(y: Array, sinusoids: int | None) -> tuple[Array, Array]:
    """Frequencies and coefficients, found in units of the signal's own range."""
    offset, scale = float(y.mean()), float(np.ptp(y)) or 1.0
    frequencies, coefficients = _fit_scaled((y - offset) / scale, sinusoids)
    coefficients = coefficients * scale
    coefficients[0] += offset
    return frequencies, coefficients


def _fit_scaled(y: Array, sinusoids: int | None) -> tuple[Array, Array]:
    n = len(y)
    most = min(10 if sinusoids is None else sinusoids, max((n - 2) // 3, 0))
    frequencies = np.empty(0)
    best = (frequencies, *_solve(frequencies, y))
    best_score = _information(best[2], y, 0)
    residual = best[2]
    for count in range(1, most + 1):
        peak = scipy.signal.periodogram(residual, nfft=8 * n, detrend=False)
        frequencies = _refine(np.append(frequencies, peak[0][1:][np.argmax(peak[1][1:])]), y)
        coefficients, residual = _solve(frequencies, y)
        score = _information(residual, y, count)
        if sinusoids is not None or score < best_score:
            best, best_score = (frequencies, coefficients, residual), score
    return best[0], best[1]


def _refine(frequencies: Array, y: Array) -> Array:
    """Move the frequencies to the least squares, the amplitudes being eliminated."""
    reach = 1 / len(y)
    # A sinusoid of less than a cycle in the record would be a drift, and run away beyond it.
    low = np.clip(frequencies - reach, reach, 0.5)
    high = np.clip(frequencies + reach, 1.01 * reach, 0.5 + 1e-9)

    def residual(moved: Array) -> Array:
        return _solve(moved, y)[1]

    found = scipy.optimize.least_squares(
        residual,
        np.clip(frequencies, low, high),
        bounds=(low, high),
        x_scale=reach,
        ftol=1e-12,
        xtol=1e-12,
        max_nfev=50,
    )
    return np.asarray(found.x)


def _information(residual: Array, y: Array, sinusoids: int) -> float:
    """Bayesian information criterion of a Gaussian residual, taken as 1e-8 of y at least."""
    n = len(residual)
    variance = max(float(np.mean(residual**2)), 1e-16 * float(np.mean(y**2)), 1e-300)
    return n * float(np.log(variance)) + (1 + 3 * sinusoids) * float(np.log(n))
