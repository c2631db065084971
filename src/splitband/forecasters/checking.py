"""Check a fitted forecaster: fits, residual tests, stability, ranges, and step responses.

Residuals are the record minus the simulation. See L. Ljung, System Identification: Theory for the
User (2nd ed., 1999, section 16.6). If residuals depend on past inputs, the model misses dynamics
that the inputs drive. If they depend on their own past alone, a disturbance acts.

Whether they depend on the inputs is an F test of nested regressions, after C. W. J. Granger (1969):
do past inputs help to predict the residuals, beyond their own past? Under the hypothesis the inputs
may be anything, a single step or a few sinusoids, as the regression is conditional on them. Powers
of the simulated output are tested with them, as in the RESET test of J. B. Ramsey (1969): a static
nonlinearity that the model misses need not be correlated with the inputs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.data import Record, require_records
from splitband.data.signals import first_after
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction
from splitband.metrics import (
    Extrapolation,
    ExtrapolationWarning,
    fit_percent,
    leaves_range,
)
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings

LEVEL = 0.99
"""Confidence level: for an adequate model, 1 test in 100 is rejected by chance. As in MATLAB's
`resid`."""
SIGNIFICANT = 0.005
"""p-value below which residuals depend on the inputs. With 1,000 samples and inputs of all kinds
(`benchmarks.residuals`), 1.5 % of right models have a p-value below 1 %."""
LAGS = 25
"""Largest lag of the correlations, in samples, as in MATLAB's `resid`."""
MAX_ORDER = 20
"""Largest order of the autoregressive model of the residuals. By eye."""
MAX_LAG, LAG_MEANS = 100, 12
"""Past inputs in the regression: up to this lag in samples, or a tenth of the record if that is
less, as means over so many intervals whose lengths grow with the lag. By eye."""
POWERS, POWER_LAG, POWER_MEANS = (2, 3), 30, 4
"""The same for the powers of the simulated output. By eye."""
SMALL_COMPONENT = 1e-3
"""Regressors have to differ: principal components whose singular value is below this share of the
largest one are left out. By eye."""
COLLINEAR = 1e-8
"""The same for several inputs together. By eye."""
EXPLAINED = 1e-12
"""Share of the residuals' energy below which nothing is left of them. By eye."""
EXACT = 1e-6
"""Residuals below this share of the signal's deviation are rounding errors. By eye."""


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
    inputs : For each input that changes: correlation with its past, both filtered by the
        autoregressive model of the residuals, and the F test of this input beside the others.
    p : The p-value of the F test of all inputs together.
    """

    output: str
    whiteness: Correlation
    inputs: tuple[Correlation, ...]
    p: float = 1.0

    @property
    def white(self) -> bool:
        """Return whether the residuals may be white noise."""
        return self.whiteness.p >= 1 - LEVEL

    @property
    def dependent(self) -> list[str]:
        """Return the inputs that the residuals depend on; `LEVEL` holds for all of them together.

        Where all inputs together are significant and none beside the others, all are returned.
        """
        if self.p >= SIGNIFICANT:
            return []
        least = SIGNIFICANT / max(len(self.inputs), 1)
        return [each.of for each in self.inputs if each.p < least] or [i.of for i in self.inputs]

    @property
    def accepted(self) -> bool:
        """Return whether the residuals do not depend on the inputs or, without any, are white."""
        return not self.dependent if self.inputs else self.white

    def verdict(self) -> str:
        """Return the result of the tests, in a sentence."""
        if self.dependent:
            *first, last = (f"`{name}`" for name in self.dependent)
            names, whose = (f"{', '.join(first)} and {last}", "their") if first else (last, "its")
            return (
                f"Rejected at {100 * LEVEL:.0f} %: the residuals of {self.output} still depend on "
                f"{names}, so the model does not capture {whose} full effect."
            )
        if self.inputs:
            noise = " and are white noise." if self.white else (
                ". They are not white: a disturbance acts, too.")  # fmt: skip
            return f"Accepted: the residuals of {self.output} do not depend on the inputs{noise}"
        if self.white:
            return f"Accepted: the residuals of {self.output} are white noise."
        return f"The residuals of {self.output} are not white: a better model may exist."


def residual_tests(
    residuals: Array,
    u: Array | None,
    columns: Sequence[str],
    inputs: Sequence[str],
    simulated: Array | None = None,
) -> tuple[ResidualTests, ...]:
    """Test the residuals of each output.

    Parameters
    ----------
    residuals : `(time, ny)`, NaN in gaps.
    u : The inputs, `(time, nu)`; they may begin earlier, and end with the residuals.
    columns, inputs : Names of outputs and inputs.
    simulated : The output of the model, `(time, ny)`, whose powers are tested, too.
    """
    found = []
    simulated = np.zeros_like(residuals) if simulated is None else simulated
    for column, e, y in zip(columns, residuals.T, simulated.T, strict=True):
        pairs = [] if u is None else zip(inputs, u.T, strict=True)
        driven = {name: x for name, x in pairs if np.ptp(x[-len(e) - MAX_LAG :]) > 0}
        p, tested = _dependence(e, y, driven) if driven else (1.0, ())
        found.append(ResidualTests(column, _whiteness(e), tested, p))
    return tuple(found)


def _whiteness(e: Array) -> Correlation:
    """Return the autocorrelation, and the test of Ljung and Box (1978)."""
    x, samples = _centred(e)
    r = _correlation(x, x)[1:]
    lags = np.arange(1, LAGS + 1)
    statistic = samples * (samples + 2) * np.sum(r**2 / np.maximum(samples - lags, 1))
    return _correlated("residuals", r, samples, float(scipy.stats.chi2.sf(statistic, LAGS)))


def _dependence(
    e: Array, simulated: Array, inputs: Mapping[str, Array]
) -> tuple[float, tuple[Correlation, ...]]:
    """Return the p-value of the test of all inputs, and the tests of each of them."""
    x, samples = _centred(e)
    past, rows = _own_past(x, ~np.isnan(e))
    y, longest = x[rows], min(MAX_LAG, len(x) // 10)
    most = max(len(y) // (4 * len(inputs)), 1)
    of_inputs = [
        _components(_lag_means(u, len(x), longest, LAG_MEANS)[rows], most) for u in inputs.values()
    ]
    powers = _components(_powers(simulated)[rows], len(y) // 8)
    test = _NestedTest(y, past, [*of_inputs, powers])
    if math.sqrt(y @ y) <= EXACT * float(np.linalg.norm(_centred(e + simulated)[0])):
        chances = [1.0] * (1 + len(inputs))
    else:
        every = [*range(len(inputs) + 1)]
        chances = [test.p([]), *(test.p([k for k in every if k != i]) for i in every[:-1])]
    a = np.append(1.0, -np.linalg.lstsq(past[:, : test.order], y, rcond=None)[0])
    white = scipy.signal.lfilter(a, [1.0], x)
    tests = []
    for (name, u), p in zip(inputs.items(), chances[1:], strict=True):
        r = _correlation(white, scipy.signal.lfilter(a, [1.0], u - u.mean())[-len(x) :])
        tests.append(_correlated(name, r, samples, p))
    return chances[0], tuple(tests)


class _NestedTest:
    """Test by F which groups of regressors help to predict a signal beside its own past.

    The autoregression has all orders there are, as choosing the order raises the level: by AIC to
    2 %, and by BIC, for a slow disturbance with white noise and 5 steps, to 15 %. Where nothing is
    left beside all groups, it has the first order that does: a higher one would explain sinusoids
    alone.
    """

    def __init__(self, y: Array, past: Array, groups: Sequence[Array]) -> None:
        self._y, self._past, self._groups = y, past, groups
        self._span = self._basis(range(len(groups)))
        q, _ = np.linalg.qr(_outside(self._span, past))
        explained = np.cumsum((q.T @ y) ** 2)
        left = float(np.sum(_outside(self._span, y) ** 2)) - np.append(0.0, explained)
        least = EXPLAINED * float(y @ y) + np.finfo(float).tiny
        self.order = int(np.argmax(np.append(left[:-1] <= least, True)))
        self._left = max(float(left[self.order]), least)

    def p(self, kept: Sequence[int]) -> float:
        """Return the p-value of the hypothesis that the `kept` groups alone do as well."""
        span = self._basis(kept)
        fewer = self._span.shape[1] - span.shape[1]
        freedom = len(self._y) - self._span.shape[1] - self.order
        if fewer < 1 or freedom < 1:
            return 1.0
        q, _ = np.linalg.qr(_outside(span, self._past[:, : self.order]))
        left = _outside(q, _outside(span, self._y))
        ratio = (float(left @ left) - self._left) / fewer / (self._left / freedom)
        return float(scipy.stats.f.sf(ratio, fewer, freedom))

    def _basis(self, kept: Iterable[int]) -> Array:
        """Return an orthonormal basis of a constant and the groups."""
        constant = np.full((len(self._y), 1), len(self._y) ** -0.5)
        every = np.hstack([constant, *(self._groups[i] for i in kept)])
        return _span(every, COLLINEAR)


def _own_past(x: Array, known: npt.NDArray[np.bool_]) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return the past of a signal, `(rows, order)`, and the rows where it is measured.

    Gaps limit the order: half of the measured samples remain at least.
    """
    rows, past = known, list[Array]()
    for k in range(1, min(MAX_ORDER, len(x) // 10) + 1):
        fewer = rows & np.append(np.zeros(k, dtype=bool), known[:-k])
        if 2 * fewer.sum() < known.sum():
            break
        rows, past = fewer, [*past, np.append(np.zeros(k), x[:-k])]
    return np.stack([*past, x], axis=1)[rows, :-1], rows


def _lag_means(u: Array, samples: int, longest: int, means: int) -> Array:
    """Return means of a signal's past by lag, `(samples, means)`, over longer and longer intervals.

    Before its first sample, it is assumed to have been constant.
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
    """Return an orthonormal basis of columns, without components below this share of the first."""
    u, s, _ = np.linalg.svd(x, full_matrices=False)
    return np.asarray(u[:, s > max(least * s[0], np.finfo(float).tiny)])


def _outside(basis: Array, x: Array) -> Array:
    """Return what is orthogonal to an orthonormal basis."""
    return np.asarray(x - basis @ (basis.T @ x))


def _correlated(of: str, r: Array, samples: int, p: float) -> Correlation:
    band = float(scipy.special.ndtri(0.5 + LEVEL / 2)) / math.sqrt(samples)
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


AHEAD = (1, 10)
"""Horizons in samples of the predictions from within the record. By eye."""
ORIGINS = 100
"""Largest number of origins of these predictions, evenly spaced. By eye."""
LONGER = 10
"""Length of the free run that must stay in range, in multiples of the record. By eye."""
WARMUP = 50
"""Most samples before the simulation, for a forecaster without a warm-up. By eye."""


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """Hold the results of checking a forecaster on a record.

    Attributes
    ----------
    method : Name of the forecaster.
    record : The record of the check.
    simulation : The free run from a warm-up on the first samples to the end.
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
        """Return whether no test rejects the model, and a long free run, if any, stays in range.

        Without inputs the residuals have to be white.
        """
        return self.leaves is None and all(test.accepted for test in self.tests)

    def in_words(self) -> list[str]:
        """Return the results in sentences, without the fits."""
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
        """Return all results, for a JSON file."""
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
    require_records("record", record)
    record = record.prepared_as(fitted.record)
    other = not forecaster.anchored
    with without_warnings(ExtrapolationWarning):
        free = _free_run(forecaster, record)
        begin = len(record) - len(free)
        fits = {"simulation": _fit(record.truth[begin:], free.y)}
        fits |= _ahead(forecaster, record, begin, other)
        unchecked = ""
        if "simulator" in forecaster.needs:
            unchecked = "it needs the simulator's output beyond the record"
        leaves = None if unchecked else _leaves(forecaster, record, begin, other)
    tests = tests_of(record, free)
    return ModelCheck(forecaster.name, record, free, fits, tests, leaves, unchecked,
                      tuple(fitted.inputs_beyond(record.u)))  # fmt: skip


def tests_of(record: Record, simulated: Prediction) -> tuple[ResidualTests, ...]:
    """Test the residuals of a simulation or forecast to the end of a record.

    Returns nothing where it has fewer than 2 `LAGS` samples.
    """
    if len(simulated) < 2 * LAGS:
        return ()
    left = record.seen[len(record) - len(simulated) :] - simulated.y
    return residual_tests(left, record.u, record.columns, record.inputs, simulated.y)


def tests_on(forecaster: Forecaster, record: Record) -> tuple[ResidualTests, ...]:
    """Test the residuals of a fitted forecaster on a record that it was not fitted to, as `check`.

    Returns nothing where `check` would not find enough samples.
    """
    record = record.prepared_as(forecaster.require_fitted().record)
    if _begin(forecaster, record) is None:
        return ()
    with without_warnings(ExtrapolationWarning):
        return tests_of(record, _free_run(forecaster, record))


def _begin(forecaster: Forecaster, record: Record) -> int | None:
    """Return the end of the warm-up; None without one, or with too few samples after it."""
    warmup = forecaster.warmup or max(min(WARMUP, len(record) // 10), 2)
    begin = first_after(record.complete, warmup)
    return None if begin is None or len(record) - begin < 2 * LAGS else begin


def _free_run(forecaster: Forecaster, record: Record) -> Prediction:
    """Simulate a record to its end, from a warm-up on its first samples."""
    begin = _begin(forecaster, record)
    if begin is None:
        raise InputError(
            f"record must have {2 * LAGS} samples after the warm-up of {forecaster.name}, "
            f"got {len(record)}"
        )
    other = not forecaster.anchored
    return forecaster.predict(len(record) - begin, record[:begin], other_record=other)


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
            continue  # a gap in the warm-up
    return {
        f"{k} step{'s' if k > 1 else ''} ahead": _fit(
            np.stack([record.truth[at + k - 1] for at in made]),
            np.stack([y[k - 1] for y in made.values()]),
        )
        for k in AHEAD
        if made
    }


def _leaves(forecaster: Forecaster, record: Record, begin: int, other: bool) -> int | None:
    """Return after how many samples a long free run, with inputs repeated, leaves the range."""
    steps = LONGER * len(record)
    u = None if record.u is None else np.tile(record.u, (LONGER + 1, 1))[begin : begin + steps]
    long = forecaster.predict(steps, record[:begin], u=u, other_record=other)
    return leaves_range(forecaster.require_fitted().y_range, long.y)


SHARE = 0.1
"""Size of the step, as a share of the input's range in training. By eye."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Hold the response of each output to a small step of each input around an operating point.

    Attributes
    ----------
    y : Change of the outputs for a unit step at index 0, `(steps, ny, nu)`.
    sampling_time : In seconds.
    columns, inputs : Names of outputs and inputs.
    at : The operating point, `(nu,)`.
    size : Sizes of the simulated steps, `(nu,)`.
    """

    y: Array
    sampling_time: float
    columns: tuple[str, ...]
    inputs: tuple[str, ...]
    at: Array
    size: Array

    @property
    def time(self) -> Array:
        """Return the times after the step in seconds, `(steps,)`."""
        return np.asarray(np.arange(len(self.y)) * self.sampling_time, dtype=np.float64)

    def frequency_response(self) -> tuple[Array, npt.NDArray[np.complex128]]:
        """Return frequencies above 0 in Hz, and the small-signal gain there, `(n, ny, nu)`.

        It is the Fourier transform of the impulse response, over the length of the step response.
        """
        impulse = np.diff(self.y, axis=0, prepend=np.zeros_like(self.y[:1]))
        frequencies = np.fft.rfftfreq(len(impulse), self.sampling_time)
        return np.asarray(frequencies[1:], np.float64), np.fft.rfft(impulse, axis=0)[1:]


def respond(
    forecaster: Forecaster, steps: int, at: npt.ArrayLike | None, size: npt.ArrayLike | None
) -> Responses:
    """Return the responses of a fitted forecaster; see `Forecaster.step_responses`."""
    fitted = forecaster.require_fitted()
    record, steps = fitted.record, whole("steps", steps)
    if fitted.u_summary is None:
        raise InputError(f"{forecaster.name} must have inputs to respond to, it has none")
    if "simulator" in forecaster.needs:
        raise InputError(
            f"{forecaster.name} cannot respond by itself: its simulator stays outside of it"
        )
    low, high, mean = fitted.u_summary
    held = mean if at is None else _each("at", at, record.nu)
    sizes = SHARE * (high - low) if size is None else _each("size", size, record.nu)
    if not sizes.all():
        raise InputError(
            "size must not be 0: give one for an input that was constant in training, "
            f"got {sizes.tolist()}"
        )
    found = np.empty((steps, record.ny, record.nu))
    for i, of_input in enumerate(sizes):
        # Up and down: even-order nonlinearities cancel.
        ends = []
        for half in (0.5 * of_input, -0.5 * of_input):
            u = np.tile(held, (2 * steps, 1))
            u[steps:, i] += half
            with without_warnings(ExtrapolationWarning):
                ends.append(forecaster.predict(2 * steps, u=u).y[steps:])
        found[:, :, i] = (ends[0] - ends[1]) / of_input
    return Responses(found, record.sampling_time, record.columns, record.inputs, held, sizes)


def _each(what: str, value: npt.ArrayLike, nu: int) -> Array:
    """Return a number for each input."""
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape not in ((), (nu,)) or not np.isfinite(numbers).all():
        raise InputError(f"{what} must be a finite number for each of {nu} inputs, got {value!r}")
    return np.broadcast_to(numbers, (nu,))
