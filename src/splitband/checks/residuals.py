"""Test the residuals of a model: the record minus the simulation.

See L. Ljung, System Identification: Theory for the User (2nd ed., 1999, section 16.6). If residuals
depend on past inputs, the model lacks dynamics driven by the inputs. If residuals depend on their
own past alone, either a disturbance acts or the model lacks dynamics not excited in this record.

Dependence on the inputs is an F test of nested regressions, after C. W. J. Granger (1969): do past
inputs help to predict the residuals, beyond the residuals' own past? The regression is conditional
on the inputs, which may be arbitrary, a single step or a few sinusoids. Powers of the simulated
output are tested, too, as in the RESET test of J. B. Ramsey (1969): a static nonlinearity missing
in the model need not be correlated with the inputs.

Unrelated signals that wander like a random walk seem to depend on one another, and so do residuals
of models of them: the spurious regression of C. W. J. Granger and P. Newbold (1974). If the output
wanders, the inputs must also help to predict its changes.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from splitband.filters.spectrum import periodogram
from splitband.records.signals import usual_distance
from splitband.runtime.arrays import Array

CONFIDENCE = 0.99
"""Confidence level: for an adequate model, 1 test in 100 is rejected by chance. As in MATLAB's
`resid`."""
SIGNIFICANT = 0.005
"""p-value below which residuals depend on the inputs. With 1,000 samples and inputs of all kinds
(`benchmarks.residuals`), 1.5 % of right models have a p-value below 1 %."""
LAGS = 25
"""Largest lag of the correlations, in samples, as in MATLAB's `resid`."""
MOST_TESTED = 100_000
"""Largest number of samples of a test: the last ones, as `finding` says. Bounds the time."""
MOST_LAGS = 500
"""Largest lag of `Correlation.around`. Bounds the time."""
MAX_ORDER = 20
"""Largest order of the autoregressive model of the residuals. Bounds the time."""
MAX_LAG, LAG_MEANS = 100, 12
"""Largest lag of past inputs in samples, or a tenth of the record, and the number of means over
intervals of growing lengths. By eye."""
UNIT_ROOT = -4.1
"""Least Dickey-Fuller statistic of a wandering signal: one random walk in 1,000 lies below it, by
J. G. MacKinnon (1994)."""
RELATED = 0.001
"""p-value below which inputs help to predict the changes of a wandering signal: the level of
`UNIT_ROOT`."""
SAMPLES_PER_LAG = 50
"""Samples per lag of the autoregressive model of changes. Of 1,600 unrelated walks with 350 samples
9 pass for related; with half as many lags 4, and more effects pass for chance."""
POWERS = 2, 3
"""Powers of the simulated output. Convention, of statsmodels' `linear_reset`."""
POWER_LAG, POWER_MEANS = 30, 4
"""Largest lag and number of means of these powers. By eye."""
SMALL_COMPONENT = 1e-3
"""Smallest singular value of a principal component of regressors, as a share of the largest.
Rounding."""
COLLINEAR = 1e-8
"""Smallest singular value of several inputs together, as a share of the largest. Rounding."""
EXPLAINED = 1e-12
"""Energy of fully explained residuals, as a share of the residuals' energy. Rounding."""
EXACT = 1e-6
"""Largest residuals of an exact model, as a share of the signal's deviation. Rounding."""


Outcome = Literal["accepted", "not rejected", "rejected"]
"""Accepted: white noise. Not rejected: other noise, not explained by the inputs."""


@dataclass(frozen=True, eq=False)
class Correlation:
    """The correlation of residuals with their own past, or with an input's past.

    Attributes
    ----------
    of : "residuals", or the input's name.
    values : By lag: from 1 on for residuals, from 0 on for an input.
    band : Confidence limit: without correlation, `CONFIDENCE` of the values lie within +- `band`.
    p : The p-value of the test.
    around : The same by lag from -n to n, n being twice the slowest period of the output. Residuals
        that follow an input have values at positive lags, an input that follows them at negative
        ones.
    """

    of: str
    values: tuple[float, ...]
    band: float
    p: float
    around: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """The tests of one output's residuals.

    Attributes
    ----------
    output : Name of the output.
    whiteness : Correlation with their own past, and the Ljung-Box test.
    inputs : By varying input: correlation of residuals with the input's past, both filtered by the
        autoregressive model of the residuals, and the F test of the input beside the others.
    p : The p-value of the F test of all inputs together.
    size : RMS of the residuals as a share of the output's standard deviation; None for a constant
        output.
    unrelated : Whether the output wanders, and the inputs do not help to predict its changes.
    last : Number of tested samples of a record with more than `MOST_TESTED`; else 0.
    """

    output: str
    whiteness: Correlation
    inputs: tuple[Correlation, ...]
    p: float = 1.0
    size: float | None = None
    unrelated: bool = False
    last: int = 0

    @property
    def white(self) -> bool:
        """Return whether the residuals may be white noise."""
        return self.whiteness.p >= 1 - CONFIDENCE

    @property
    def dependent(self) -> list[str]:
        """Return the inputs with an effect on the residuals, at `CONFIDENCE` for all together.

        If all inputs together are significant and none beside the others, all are returned.
        """
        if self.p >= SIGNIFICANT or self.unrelated:
            return []
        return self._alone or [correlation.of for correlation in self.inputs]

    @property
    def _alone(self) -> list[str]:
        """Return the significant inputs beside the others."""
        least = SIGNIFICANT / max(len(self.inputs), 1)
        return [correlation.of for correlation in self.inputs if correlation.p < least]

    @property
    def outcome(self) -> Outcome:
        """Return the result of the tests: dependence on the inputs rejects a model."""
        if self.dependent:
            return "rejected"
        return "accepted" if self.white else "not rejected"

    @property
    def accepted(self) -> bool:
        """Return whether no test rejects the model."""
        return self.outcome != "rejected"

    def finding(self) -> str:
        """Return the finding of the tests in a sentence or two, with the size of the residuals."""
        if self.unrelated:
            return (
                f"The inputs may be unrelated to {self.output}, which wanders like a random "
                "walk: they do not help to predict its changes. An effect in the model may be "
                "chance."
            )
        facts = list[str]()
        if self.size is not None:
            facts.append(f"have an RMS of {100 * self.size:.2g} % of its standard deviation")
        if self.dependent:
            *first, last = self.dependent
            effect = f"{', '.join(first)} and {last}" if first else last
            effect += "" if self._alone else ", perhaps a nonlinear one"
            facts.append(f"still contain an effect of {effect}, which the model does not describe")
        else:
            facts += ["do not depend on the inputs"] if self.inputs else []
            facts.append("are white noise" if self.white else "are not white noise")
        link = " and " if self.dependent or self.white else ", but "
        said = link.join(filter(None, [", ".join(facts[:-1]), facts[-1]]))
        said = f"The residuals of {self.output} {said} (tested at {100 * CONFIDENCE:.0f} %)."
        if not (self.dependent or self.white):
            said += (
                " Either a disturbance acts or the model lacks dynamics; this record cannot tell "
                "which."
            )
        return said + (f" Tested are the last {self.last:,} samples." if self.last else "")

    def as_json(self) -> dict[str, Any]:
        """Return the tests for a JSON file."""
        facts = asdict(self) | {"outcome": self.outcome, "verdict": self.finding()}
        for each in (facts["whiteness"], *facts["inputs"]):
            del each["around"]  # for a plot
        return facts


def residual_tests(
    residuals: Array,
    u: Array | None,
    columns: Sequence[str],
    inputs: Sequence[str],
    simulated: Array | None = None,
) -> tuple[ResidualTests, ...]:
    """Test the residuals `(time, ny)` by output, NaN in gaps.

    The inputs `u` may begin earlier, and end with the residuals. Powers of the `simulated` outputs,
    `(time, ny)`, are tested with the inputs. An output that is slower than others is tested at its
    own rate, and one of fewer than 2 `LAGS` samples is left out.
    """
    tests, last = [], MOST_TESTED if len(residuals) > MOST_TESTED else 0
    simulated = np.zeros_like(residuals) if simulated is None else simulated
    residuals, simulated = residuals[-MOST_TESTED:], simulated[-MOST_TESTED:]
    for column, own, of_model in zip(columns, residuals.T, simulated.T, strict=True):
        pairs = [] if u is None else zip(inputs, u.T, strict=True)
        driven = {name: x for name, x in pairs if np.ptp(x[-len(own) - MAX_LAG :]) > 0}
        e, y, driven = _at_own_rate(own, of_model, driven)
        if len(e) < 2 * LAGS:
            continue
        p, tested = _dependence(e, y, driven) if driven else (1.0, ())
        white = _whiteness(e, _slow(e + y))
        unrelated = bool(driven) and white.p < 1 - CONFIDENCE and _unrelated(e + y, driven)
        tests.append(ResidualTests(column, white, tested, p, _size(e, y), unrelated, last))
    return tuple(tests)


def _at_own_rate(
    e: Array, y: Array, inputs: dict[str, Array]
) -> tuple[Array, Array, dict[str, Array]]:
    """Return every k-th sample of an output that has one in k, and means of the inputs between."""
    measured = ~np.isnan(e)
    if (k := usual_distance(measured)) < 2:
        return e, y, inputs
    first = int(measured.argmax()) % k
    after = (len(e) - 1 - first) % k
    ends = {name: x[: len(x) - after] for name, x in inputs.items()}
    means = {name: x[len(x) % k :].reshape(-1, k).mean(axis=1) for name, x in ends.items()}
    fewer = min(map(len, means.values()), default=len(e))
    return e[first::k][-fewer:], y[first::k][-fewer:], means


def _size(e: Array, simulated: Array) -> float | None:
    """Return the RMS of residuals as a share of the output's deviation; None for a constant."""
    deviation = float(np.nanstd(e + simulated))
    return float(np.sqrt(np.nanmean(e**2))) / deviation if deviation else None


def _slow(y: Array) -> int:
    """Return twice the slowest period of a signal, in samples; see `Correlation.around`."""
    x, _ = _centred(y)
    slowest = min((f for f, _ in periodogram(x, 1.0).peaks()), default=1.0)
    return max(min(round(2 / slowest), len(x) // 4, MOST_LAGS), LAGS)


def _whiteness(e: Array, most: int) -> Correlation:
    """Return the autocorrelation, and the test of Ljung and Box (1978)."""
    x, samples = _centred(e)
    around = _correlation(x, x, most)
    r, lags = around[most + 1 :][:LAGS], np.arange(1, LAGS + 1)
    statistic = samples * (samples + 2) * np.sum(r**2 / np.maximum(samples - lags, 1))
    return _correlated("residuals", r, samples, float(scipy.stats.chi2.sf(statistic, LAGS)), around)


def _dependence(
    e: Array, simulated: Array, inputs: Mapping[str, Array]
) -> tuple[float, tuple[Correlation, ...]]:
    """Return the p-value of the test of all inputs, and the tests by input."""
    x, samples = _centred(e)
    past, rows = _own_past(x, ~np.isnan(e), MAX_ORDER)
    y, of_inputs = x[rows], _past_inputs(inputs, rows, min(MAX_LAG, len(x) // 10))
    powers = _components(_powers(simulated)[rows], len(y) // 8)
    test = _NestedTest(y, past, [*of_inputs, powers])
    if math.sqrt(y @ y) <= EXACT * float(np.linalg.norm(_centred(e + simulated)[0])):
        chances = [1.0] * (1 + len(inputs))
    else:
        every = [*range(len(inputs) + 1)]
        chances = [test.p([]), *(test.p([k for k in every if k != i]) for i in every[:-1])]
    a = np.append(1.0, -np.linalg.lstsq(past[:, : test.order], y, rcond=None)[0])
    white = scipy.signal.lfilter(a, [1.0], x)
    tests, most = [], _slow(e + simulated)
    for (name, u), p in zip(inputs.items(), chances[1:], strict=True):
        filtered = scipy.signal.lfilter(a, [1.0], u - u.mean())[-len(x) :]
        around = _correlation(white, filtered, most)
        tests.append(_correlated(name, around[most:][: LAGS + 1], samples, p, around))
    return chances[0], tuple(tests)


def _unrelated(y: Array, inputs: Mapping[str, Array]) -> bool:
    """Return whether a signal wanders, and past inputs do not help to predict its changes."""
    if not _wanders(y):
        return False
    changes = np.diff(y, prepend=np.nan)
    x, samples = _centred(changes)
    past, rows = _own_past(x, ~np.isnan(changes), max(samples // SAMPLES_PER_LAG, 1))
    groups = _past_inputs(inputs, rows, min(MAX_LAG, len(x) // 3))
    return _NestedTest(x[rows], past, groups).p([]) >= RELATED


def _wanders(y: Array) -> bool:
    """Return whether a signal may have a unit root: the test of S. E. Said and D. A. Dickey (1984).

    The number of lags is by G. W. Schwert (1989).
    """
    x, samples = _centred(y)
    past, rows = _own_past(x, ~np.isnan(y), 1 + int(4 * (samples / 100) ** 0.25))
    if not past.size:  # no sample follows another
        return False
    constant = np.ones((len(past), 1))
    regressors = np.hstack([past[:, :1], np.diff(past, axis=1), constant])
    change, inverse = x[rows] - past[:, 0], np.linalg.pinv(regressors)
    estimate = inverse @ change
    left = float(np.linalg.norm(change - regressors @ estimate))
    error = left * float(np.linalg.norm(inverse[0])) / math.sqrt(max(len(change) - len(inverse), 1))
    return bool(estimate[0] > UNIT_ROOT * error)


class _NestedTest:
    """F tests of groups of regressors as predictors of a signal beside its own past.

    The autoregression has the largest possible order, as choosing the order raises the level: by
    AIC to 2 %, and by BIC, for a slow disturbance with white noise and 5 steps, to 15 %. If the
    regression is exact, it has the least sufficient order: a higher one explains sinusoids alone.
    """

    def __init__(self, y: Array, past: Array, groups: Sequence[Array]) -> None:
        self._y, self._past, self._groups = y, past, groups
        span = self._basis(range(len(groups)))
        self._rank = span.shape[1]  # of a long record, the basis itself takes much memory
        q, _ = np.linalg.qr(_outside(span, past))
        explained = np.cumsum((q.T @ y) ** 2)
        left = float(np.sum(_outside(span, y) ** 2)) - np.append(0.0, explained)
        least = EXPLAINED * float(y @ y) + np.finfo(float).tiny
        self.order = int(np.argmax(np.append(left[:-1] <= least, True)))
        self._left = max(float(left[self.order]), least)

    def p(self, groups: Sequence[int]) -> float:
        """Return the p-value of the hypothesis that these groups alone are sufficient."""
        span = self._basis(groups)
        fewer = self._rank - span.shape[1]
        freedom = len(self._y) - self._rank - self.order
        if fewer < 1 or freedom < 1:
            return 1.0
        q, _ = np.linalg.qr(_outside(span, self._past[:, : self.order]))
        left = _outside(q, _outside(span, self._y))
        ratio = (float(left @ left) - self._left) / fewer / (self._left / freedom)
        return float(scipy.stats.f.sf(ratio, fewer, freedom))

    def _basis(self, groups: Iterable[int]) -> Array:
        """Return an orthonormal basis of a constant and these groups."""
        constant = np.full((len(self._y), 1), len(self._y) ** -0.5)
        every = np.hstack([constant, *(self._groups[i] for i in groups)])
        return _span(every, COLLINEAR)


def _past_inputs(
    inputs: Mapping[str, Array], rows: npt.NDArray[np.bool_], longest: int
) -> list[Array]:
    """Return the regressors by input of the past up to the `longest` lag."""
    most = max(int(rows.sum()) // (4 * len(inputs)), 1)
    means = (_lag_means(u, len(rows), longest, LAG_MEANS) for u in inputs.values())
    return [_components(of_input[rows], most) for of_input in means]


def _own_past(
    x: Array, measured: npt.NDArray[np.bool_], order: int
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the past of a signal, `(rows, order)`, and a mask of the rows with measurements.

    Gaps limit the order: at least half of the measured samples remain.
    """
    rows, past = measured, list[Array]()
    for k in range(1, min(order, MAX_ORDER, len(x) // 10) + 1):
        fewer = rows & np.append(np.zeros(k, dtype=bool), measured[:-k])
        if 2 * fewer.sum() < measured.sum():
            break
        rows, past = fewer, [*past, np.append(np.zeros(k), x[:-k])]
    return np.stack([*past, x], axis=1)[rows, :-1], rows


def _lag_means(u: Array, samples: int, longest: int, means: int) -> Array:
    """Return means of a signal's past by lag, `(samples, means)`, over growing intervals.

    The signal is assumed constant before its first sample.
    """
    edges = np.unique(np.append(0, np.geomspace(1, max(longest, 2), means).round().astype(int)))
    begun = np.append(np.full(edges[-1], u[0]), u)
    total = np.append(0.0, np.cumsum(begun))
    end = len(begun) + 1 - samples + np.arange(samples)
    ahead, behind = edges[:-1, None], edges[1:, None]
    return np.asarray((total[end - ahead] - total[end - behind]) / (behind - ahead)).T


def _powers(simulated: Array) -> Array:
    """Return means of the past of the output's powers, `(time, means)`; 0 for a constant output."""
    size = float(np.ptp(simulated))
    z = (simulated - simulated.mean()) / size if size else np.zeros(len(simulated))
    means = [_lag_means(z**k, len(z), POWER_LAG, POWER_MEANS) for k in POWERS]
    return np.hstack(means)


def _components(x: Array, most: int) -> Array:
    """Return the principal components of columns, `(rows, up to most)`, without constant ones."""
    return _span(x - x.mean(axis=0), SMALL_COMPONENT)[:, :most]


def _span(x: Array, least: float) -> Array:
    """Return an orthonormal basis of columns, without components below a `least` share."""
    u, s, _ = np.linalg.svd(x, full_matrices=False)
    return np.asarray(u[:, s > max(least * s[0], np.finfo(float).tiny)])


def _outside(basis: Array, x: Array) -> Array:
    """Return what is orthogonal to an orthonormal basis."""
    inside = basis @ (basis.T @ x)
    return np.asarray(np.subtract(x, inside, out=inside))


def _correlated(of: str, r: Array, samples: int, p: float, around: Array) -> Correlation:
    band = float(scipy.special.ndtri(0.5 + CONFIDENCE / 2)) / math.sqrt(samples)
    return Correlation(of, tuple(map(float, r)), band, p, around)


def _centred(x: Array) -> tuple[Array, int]:
    """Return a signal minus its mean, 0 in gaps, and the number of measured samples."""
    measured = ~np.isnan(x)
    return np.where(measured, x - x[measured].mean(), 0.0), max(int(measured.sum()), 1)


def _correlation(later: Array, earlier: Array, most: int) -> Array:
    """Return the correlation of `later` with `earlier` at lags from -`most` to `most`."""
    n = len(later)
    size = math.sqrt(float(later @ later) * float(earlier @ earlier))
    at = ((max(k, 0), max(-k, 0)) for k in range(-most, most + 1))
    r = np.array([later[i : n - j] @ earlier[j : n - i] for i, j in at])
    return r / size if size else r
