"""Check a fitted forecaster against a record: fits, residual tests, stability, ranges.

The residual tests are those of L. Ljung, System Identification: Theory for the User (2nd ed., 1999,
section 16.6). Residuals are what the simulation leaves of the record. Where they depend on past
inputs, the model misses dynamics that the inputs drive. Where they depend on their own past, there
is a disturbance that the model does not describe, or dynamics that it misses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import scipy

from splitband.data import Record
from splitband.data.gaps import first_after
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction
from splitband.metrics import (
    Extrapolation,
    ExtrapolationWarning,
    fit_percent,
    leaves_range,
)
from splitband.runtime.arrays import Array
from splitband.runtime.threads import without_warnings

LEVEL = 0.99
"""Probability that what is tested lies within the bands: a test is rejected where chance alone
exceeds it in fewer than 1 of 100 records. As MATLAB's `resid` has it."""
LAGS = 25
"""Samples back that residuals are compared with, as MATLAB's `resid` does."""
AHEAD = (1, 10)
"""Horizons in samples of the predictions from within the record. By eye."""
ORIGINS = 100
"""From which these predictions are made, at even distances. By eye."""
LONGER = 10
"""Times the record: the length of the free run that must stay in range. By eye."""
WARMUP = 50
"""Samples before the simulation, of a forecaster that does not say how many it needs. By eye."""
_MOST_ORDER = 20
"""Largest order of the autoregressive models that whiten a signal. By eye."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """Hold the correlation of residuals with their own past, or with that of an input.

    Attributes
    ----------
    of : "residuals", or the input's name.
    values : By lag; of residuals from 1 on, of an input from 0 on.
    band : Chance alone keeps `LEVEL` of the values within this, on either side of 0.
    p : How probable values as large as these are by chance.
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
        """Tell whether the residuals may be white noise."""
        return self.whiteness.p >= 1 - LEVEL

    @property
    def dependent(self) -> list[str]:
        """Return the inputs that the residuals depend on; all tests together have the level."""
        least = (1 - LEVEL) / max(len(self.inputs), 1)
        return [each.of for each in self.inputs if each.p < least]

    def verdict(self) -> str:
        """Return what the tests say, in a sentence."""
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


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """Hold what the check of a forecaster on a record found.

    Attributes
    ----------
    method : Its name.
    record : What it was checked on.
    simulation : Its free run from a warm-up on the first samples, to the end.
    fits : Fit in percent of each output: "simulation", and "1 step ahead" and so on.
    tests : Of the residuals of each output.
    leaves : Samples of a free run of `LONGER` times the record before it leaves the range of the
        training record by far; None where it stays.
    unchecked : Why there is no such run; empty where there is one.
    beyond : Inputs outside their range in training.
    """

    method: str
    record: Record
    simulation: Prediction
    fits: Mapping[str, tuple[float, ...]]
    tests: tuple[ResidualTests, ...]
    leaves: int | None = None
    unchecked: str = ""
    beyond: Sequence[Extrapolation] = field(default_factory=tuple)

    @property
    def accepted(self) -> bool:
        """Tell whether no test rejects the model, and its long free run stays in range.

        Without inputs the residuals have to be white.
        """
        tested = (not test.dependent if test.inputs else test.white for test in self.tests)
        return self.leaves is None and all(tested)

    def in_words(self) -> list[str]:
        """Return what was found, in sentences."""
        said = [test.verdict() for test in self.tests]
        if self.unchecked:
            said.append(f"Stability was not checked: {self.unchecked}.")
        elif self.leaves is None:
            said.append(f"The free run over {LONGER} times the record stays in range.")
        else:
            said.append(
                f"The free run over {LONGER} times the record, with its inputs repeated, leaves "
                f"the range of the training record by far after {self.leaves:,} samples."
            )
        names = self.record.inputs
        return said + [each.describe(names[each.channel]) for each in self.beyond]

    def __str__(self) -> str:
        fits = [
            f"{column}: fit {of[i]:.1f} % ({horizon})"
            for i, column in enumerate(self.record.columns)
            for horizon, of in self.fits.items()
        ]
        return "\n".join([f"{self.method} on {self.record.name or 'the record'}", *fits,
                          *self.in_words()])  # fmt: skip

    def as_json(self) -> dict[str, Any]:
        """Return all numbers."""
        return {
            "method": self.method,
            "record": self.record.name,
            "samples": len(self.record),
            "accepted": self.accepted,
            "level": LEVEL,
            "fit": {
                horizon: {
                    column: fit if math.isfinite(fit) else None
                    for column, fit in zip(self.record.columns, fits, strict=True)
                }
                for horizon, fits in self.fits.items()
            },
            "residuals": [asdict(test) for test in self.tests],
            "leaves_range_after": self.leaves,
            "unchecked": self.unchecked,
            "inputs_beyond_training": [asdict(each) for each in self.beyond],
            "in_words": self.in_words(),
        }


def check(forecaster: Forecaster, record: Record) -> ModelCheck:
    """Check a fitted forecaster on a record; see `Forecaster.check_residuals`."""
    fitted = forecaster.require_fitted()
    record = record.prepared_as(fitted.record)
    begin = first_after(record.complete, forecaster.warmup or min(WARMUP, len(record) // 10))
    if begin is None or begin < 2 or len(record) - begin < 2 * LAGS:
        raise ValueError(
            f"record must have {2 * LAGS} samples after the warm-up of {forecaster.name}, "
            f"got {len(record)}"
        )
    other = not forecaster.anchored
    with without_warnings(ExtrapolationWarning):
        free = forecaster.predict(len(record) - begin, record[:begin], other_record=other)
        fits = {"simulation": _fit(record.truth[begin:], free.y)}
        fits |= _ahead(forecaster, record, begin, other)
        unchecked = ""
        if "simulator" in forecaster.needs:
            unchecked = "it needs the simulator's output beyond the record"
        leaves = None if unchecked else _leaves(forecaster, record, begin, other)
    left = record.seen[begin:] - free.y
    u = None if record.u is None else record.u[begin:]
    tests = residual_tests(left, u, record.columns, record.inputs)
    return ModelCheck(forecaster.name, record, free, fits, tests, leaves, unchecked,
                      tuple(fitted.inputs_beyond(record.u)))  # fmt: skip


def residual_tests(
    residuals: Array, u: Array | None, columns: Sequence[str], inputs: Sequence[str]
) -> tuple[ResidualTests, ...]:
    """Test the residuals `(time, ny)`, NaN in gaps, of each output, with inputs `(time, nu)`."""
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

    Each is whitened by an autoregressive model of its own, or their own correlation would look
    like one between them.
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
    """Return a signal less its mean, 0 in gaps, and how many samples were measured."""
    known = ~np.isnan(x)
    return np.where(known, x - x[known].mean(), 0.0), max(int(known.sum()), 1)


def _correlation(later: Array, earlier: Array) -> Array:
    """Return the correlation of `later` with `earlier`, from 0 to `LAGS` samples before it."""
    n = len(later)
    size = math.sqrt(float(later @ later) * float(earlier @ earlier))
    r = np.array([later[k:] @ earlier[: n - k] for k in range(LAGS + 1)])
    return r / size if size else r


def _whitened(x: Array) -> Array:
    """Return what an autoregressive model leaves of a signal; its order is that of least BIC."""
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


def _fit(y: Array, predicted: Array) -> tuple[float, ...]:
    return tuple(float(fit) for fit in fit_percent(y, predicted))


def _ahead(
    forecaster: Forecaster, record: Record, begin: int, other: bool
) -> dict[str, tuple[float, ...]]:
    """Return the fit of predictions a few samples ahead, from many origins."""
    last = len(record) - max(AHEAD)
    origins = np.unique(np.linspace(begin, last, min(ORIGINS, last - begin + 1)).astype(int))
    made: dict[int, Array] = {}
    for at in origins:
        try:
            made[at] = forecaster.predict(max(AHEAD), record[:at], other_record=other).y
        except ValueError:
            continue  # a gap where it has to warm up
    return {
        f"{k} step{'s' if k > 1 else ''} ahead": _fit(
            np.stack([record.truth[at + k - 1] for at in made]),
            np.stack([y[k - 1] for y in made.values()]),
        )
        for k in AHEAD
        if made
    }


def _leaves(forecaster: Forecaster, record: Record, begin: int, other: bool) -> int | None:
    """Return when a long free run, with the record's inputs repeated, leaves the range."""
    steps = LONGER * len(record)
    u = None if record.u is None else np.tile(record.u, (LONGER + 1, 1))[begin : begin + steps]
    long = forecaster.predict(steps, record[:begin], u=u, other_record=other)
    return leaves_range(forecaster.require_fitted().y_range, long.y)
