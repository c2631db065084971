"""Naive baselines: what a trained model has to beat to be worth its training.

Each is fitted on the training samples and predicts by time index, which counts from the first of
them: `predict(start, steps, last)` gives the samples `start`..`start + steps - 1`, `last` being the
measured sample before them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt
import scipy

Array = npt.NDArray[np.float64]
Fitted = TypeVar("Fitted")

MOST_ROUNDS = 8
CLEARLY = 0.6
SETTLED = 1e-3
"""Of a channel's range: what fills the gaps moves no more than that from one round to the next."""


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
class Mean:
    """The mean of the training samples: what is left where nothing can be foreseen.

    Attributes
    ----------
    y : By channel, `(ny,)`.
    """

    y: Array

    def predict(self, start: int, steps: int, last: Array) -> Array:
        """See `Naive`."""
        return np.tile(self.y, (steps, 1))

    def __str__(self) -> str:
        return "the mean of the training samples"


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
        errors = {lag: _backward_error(y, lag) for lag in sorted(self_similar_lags(y))}
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


def around_gaps(
    fit: Callable[[Array], Fitted],
    says: Callable[[Fitted], Array],
    y: Array,
    measured: npt.NDArray[np.bool_] | None,
    guess: Array | None = None,
) -> Fitted:
    """What is fitted to a record with gaps, these being filled by what it says itself.

    Repeated until that changes no more, least squares come to what they would be of the measured
    samples alone.

    Parameters
    ----------
    fit : Of `(time, ny)`.
    says : What has been fitted says of the same samples, `(time, ny)`.
    y, measured : `(time, ny)` each: the record, and where it was measured; None for everywhere.
    guess : What may fill the gaps to begin with, rather than `y`. That is gone back to where it
        ends with less than `CLEARLY` of the squared error, as it may be for the more freedom only.
    """
    if measured is None:
        return fit(y)
    plain = _settled(fit, says, y, measured)
    if guess is None:
        return plain
    guessed = _settled(fit, says, np.where(measured, y, guess), measured)
    scale = np.ptp(y, axis=0) + np.finfo(np.float64).tiny
    left = [float(np.sum(((says(f) - y) / scale)[measured] ** 2)) for f in (plain, guessed)]
    return plain if left[0] < CLEARLY * left[1] else guessed


def _settled(
    fit: Callable[[Array], Fitted],
    says: Callable[[Fitted], Array],
    y: Array,
    measured: npt.NDArray[np.bool_],
) -> Fitted:
    found = fit(y)
    for _ in range(MOST_ROUNDS):
        before, y = y, np.where(measured, y, says(found))
        found = fit(y)
        if (abs(y - before).max(axis=0) <= SETTLED * np.ptp(y, axis=0)).all():
            break
    return found


def self_similar_lags(y: Array, most: int = 200) -> list[int]:
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
