"""Test the residuals of a model: the record minus the simulation.

See L. Ljung, System Identification: Theory for the User (2nd ed., 1999, section 16.6). If residuals
depend on past inputs, the model misses dynamics that the inputs drive. If they depend on their own
past, the model misses a disturbance or dynamics.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from splitband.runtime.arrays import Array

LEVEL = 0.99
"""Confidence level: for an adequate model, 1 test in 100 is rejected by chance. As in MATLAB's
`resid`."""
LAGS = 25
"""Largest lag of the correlations, in samples, as in MATLAB's `resid`."""
_MOST_ORDER = 20
"""Largest order of the autoregressive models that whiten a signal. By eye."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """Hold the correlation of residuals with their own past, or with that of an input.

    Attributes
    ----------
    of : "residuals", or the input's name.
    values : By lag: from 1 on for residuals, from 0 on for an input.
    band : Confidence limit: without correlation, `LEVEL` of the values lie within +- this.
    p : The p-value of the test.
    """

    of: str
    values: tuple[float, ...]
    band: float
    p: float


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Hold the tests of one output's residuals.

    Attributes
    ----------
    output : Its name.
    whiteness : Correlation with their own past, and the Ljung-Box test.
    inputs : Correlation with each input, both whitened, and Haugh's test.
    """

    output: str
    whiteness: Correlation
    inputs: tuple[Correlation, ...]

    @property
    def white(self) -> bool:
        """Return whether the residuals may be white noise."""
        return self.whiteness.p >= 1 - LEVEL

    @property
    def dependent(self) -> list[str]:
        """Return the inputs that the residuals depend on; `LEVEL` holds for all tests together."""
        least = (1 - LEVEL) / max(len(self.inputs), 1)
        return [each.of for each in self.inputs if each.p < least]

    def verdict(self) -> str:
        """Return the result of the tests, in a sentence."""
        if self.dependent:
            return (
                f"{self.output}: rejected at {100 * LEVEL:.0f} %: the residuals depend on "
                f"{', '.join(self.dependent)}, whose effect it does not describe in full."
            )
        if self.inputs:
            noise = ", and they are white noise." if self.white else (
                ". They are not white: a disturbance acts, too.")  # fmt: skip
            return f"{self.output}: accepted: the residuals do not depend on the inputs{noise}"
        if self.white:
            return f"{self.output}: accepted: the residuals are white noise."
        return f"{self.output}: the residuals are not white: a better model may exist."


def residual_tests(
    residuals: Array, u: Array | None, columns: Sequence[str], inputs: Sequence[str]
) -> tuple[ResidualTests, ...]:
    """Test the residuals of each output, `(time, ny)`, NaN in gaps, with inputs `(time, nu)`."""
    found = []
    for column, e in zip(columns, residuals.T, strict=True):
        pairs = [] if u is None else zip(inputs, u.T, strict=True)
        driven = tuple(_dependence(name, e, x) for name, x in pairs)
        found.append(ResidualTests(column, _whiteness(e), driven))
    return tuple(found)


def _whiteness(e: Array) -> Correlation:
    """Return the autocorrelation, and the test of Ljung and Box (1978)."""
    x, samples = _centred(e)
    r = _correlation(x, x)[1:]
    lags = np.arange(1, LAGS + 1)
    statistic = samples * (samples + 2) * np.sum(r**2 / np.maximum(samples - lags, 1))
    return _correlated("residuals", r, samples, statistic)


def _dependence(name: str, e: Array, u: Array) -> Correlation:
    """Return the correlation with an input's past, and the test of Haugh (1976).

    Each signal is whitened by its own autoregressive model first, as autocorrelation would look
    like correlation between them.
    """
    x, samples = _centred(e)
    r = _correlation(_whitened(x), _whitened(_centred(u)[0]))
    lags = np.arange(LAGS + 1)
    statistic = samples**2 * np.sum(r**2 / np.maximum(samples - lags, 1))
    return _correlated(name, r, samples, statistic)


def _correlated(of: str, r: Array, samples: int, statistic: float) -> Correlation:
    band = float(scipy.special.ndtri(0.5 + LEVEL / 2)) / math.sqrt(samples)
    p = float(scipy.stats.chi2.sf(statistic, len(r)))
    return Correlation(of, tuple(map(float, r)), band, p)


def _centred(x: Array) -> tuple[Array, int]:
    """Return a signal minus its mean, 0 in gaps, and the number of measured samples."""
    known = ~np.isnan(x)
    return np.where(known, x - x[known].mean(), 0.0), max(int(known.sum()), 1)


def _correlation(later: Array, earlier: Array) -> Array:
    """Return the correlation of `later` with `earlier`, from 0 to `LAGS` samples before it."""
    n = len(later)
    size = math.sqrt(float(later @ later) * float(earlier @ earlier))
    r = np.array([later[k:] @ earlier[: n - k] for k in range(LAGS + 1)])
    return r / size if size else r


def _whitened(x: Array) -> Array:
    """Return the residuals of an autoregressive model of a signal, with the order of least BIC."""
    n, most = len(x), min(_MOST_ORDER, len(x) // 10)
    if most < 1 or not x.any():
        return x
    past = np.stack([x[most - k : n - k] for k in range(1, most + 1)], axis=1)
    q, r = np.linalg.qr(past)
    target = x[most:]
    explained = np.concatenate([[0.0], np.cumsum((q.T @ target) ** 2)])
    left = np.maximum(target @ target - explained, np.finfo(float).tiny)
    order = int(np.argmin(len(target) * np.log(left) + np.log(len(target)) * np.arange(most + 1)))
    if not order:
        return x
    a = np.linalg.lstsq(r[:order, :order], (q.T @ target)[:order], rcond=1e-10)[0]
    return np.asarray(scipy.signal.lfilter(np.append(1.0, -a), [1.0], x))
