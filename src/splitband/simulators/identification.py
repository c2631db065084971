"""Fit the parameters of a simulator to records, and assess their identifiability.

`scipy.optimize.least_squares` starts from the middle of the ranges and from points of a Sobol
sequence. Every other start begins with short windows, see `shooting`, which then grow: a short
simulation determines parameters even if a long one loses its phase.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from splitband.metrics import spread
from splitband.records import Record, require_records
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import NEVER, Deadline, DeadlineError, current, now, within
from splitband.runtime.errors import InputError
from splitband.runtime.workers import Workers, ended_from_outside, run_jobs
from splitband.simulators.base import matched
from splitband.simulators.parameters import (
    Adjustable,
    Estimate,
    Name,
    favours,
    labelled,
    uncertainty,
)
from splitband.simulators.shooting import BAD, Experiment, Shooting, projected
from splitband.simulators.user_code import failure

STARTS = 32
"""Default limit of starting points. Bounds the time."""
ENOUGH = 4
"""Number of starts with equal errors at the end of the search, and of starts in a batch, for any
number of processes, so that results do not depend on it. Bounds the time."""
PATIENCE, _HARDLY_BETTER = 8, 0.02
"""Number of last starts, and their gain as a share of the error, at the end of the search. Bounds
the time."""
SAME_ERROR = 1e-3
"""Relative difference of equal errors. Rounding."""
SHORTEST = 16
"""Samples of the shortest windows. By eye."""
_GROWTH, _WINDOWS = 4, 32
"""Growth of windows from stage to stage, and the largest number of windows of the longest record in
the first stage. Bounds the time."""
_PULL = 1e-6
"""Residual of an unknown at a unit's distance from its start: unobservable unknowns do not move.
Rounding."""
QUICK, SLOW = 2.0, 20.0
"""Seconds. Quicker starts than the first number run in one process: further processes would have to
start and to compile the equation, 4 s here. After a first start slower than the second number, the
time of a start is not measured. Bounds the time."""
_ROUNDS, LAST_ROUNDS = 30, 100
"""Largest number of evaluations in a search, and in the last search from the best values. Bounds
the time."""
_SAME_PLACE = 0.02
"""Distance of equal values, as a share of a range. By eye."""
WINDOWS_FROM_ERROR, _WORTH_WINDOWS = 0.6, 0.3
"""Least error of a simulation of whole records, in deviations, with windows as an alternative, and
the largest error of useful windows, as a share of the first error. By eye."""
_DEFECTS = (NameError, AttributeError, ImportError)
"""Errors of code, independent of parameter values."""


@dataclass(frozen=True)
class StartOutcome:
    """The outcome of one starting point.

    `found`: positions in the ranges and error, in deviations, by length of the windows; `failure`:
    message of the last failed run; `cut`: whether the deadline ended the search.
    """

    number: int
    found: dict[int, tuple[list[float], float]] = field(default_factory=dict)
    failure: str = ""
    cut: bool = False


@dataclass(frozen=True)
class Effort:
    """Limits of the effort of a fit.

    Attributes
    ----------
    starts : Largest number of starting points.
    seconds : Time limit, at which the best result so far is used; None for no limit.
    workers : Number of processes for starts in parallel, or an executor.
    progress : Called with the number of finished starts and of all starts.
    """

    starts: int = STARTS
    seconds: float | None = None
    workers: int | Executor = 1
    progress: Callable[[int, int], None] | None = None


def identify(simulator: Adjustable, *records: Record, effort: Effort | None = None) -> Estimate:
    """Fit the parameters of a simulator to the measured samples of records.

    Parameters
    ----------
    simulator : Simulator with ranges for the fitted parameters, such as an `Ode`.
    records : Whole records to fit, with separate initial values.
    effort : Limits of the search.

    Returns
    -------
    Estimate
        Values with standard errors, and remarks on identifiability.

    Raises
    ------
    ValueError
        If no run of the simulator succeeds; the message gives the reason.
    """
    require_records("records", *records)
    effort = effort or Effort()
    simulator = check_runs(simulator, records[0])
    experiments = [Experiment.of(record, simulator) for record in records]
    scale = spread(np.concatenate([e.y for e in experiments]))
    shooting = Shooting(simulator, experiments, scale)
    longest, deadline = shooting.longest, min(current(), Deadline.after(effort.seconds))
    if not shooting.names:
        unknowns = shooting.divide(longest, np.empty(0))
        estimate = _build_estimate(shooting, unknowns, 0)
        return replace(estimate, doubt=_doubt(shooting, unknowns, longest, deadline))
    outcomes = tried(shooting, effort, deadline)
    if not any(o.found for o in outcomes):
        over = "the time was over before the first one was done"
        reason = next((o.failure for o in outcomes if o.failure), over)
        raise InputError(f"simulator must run for some parameters in their ranges: {reason}")
    # Without states every window begins with the record: a shorter one omits the rest.
    window = _window(outcomes, longest if simulator.states else math.inf)
    ranked = sorted((o.found[window][1], o.number) for o in outcomes if window in o.found)
    best = next(o for o in outcomes if o.number == ranked[0][1])
    fractions = np.array(best.found[window][0])
    with within(NEVER):  # the result is evaluated even after the deadline
        precise = Shooting(simulator.precise(), experiments, scale)
        unknowns = precise.divide(window, fractions)
        rough = not _runs(precise, unknowns)  # the solver cannot keep smaller tolerances
        if rough:
            unknowns = shooting.divide(window, fractions)
        else:
            shooting = precise
        if not (best.cut or deadline.over):
            unknowns, _ = descend(shooting, unknowns, LAST_ROUNDS)
        estimate = _build_estimate(shooting, unknowns, window if window < longest else 0)
    fractions = unknowns[: len(fractions)]
    agreeing = [error for error, _ in ranked if error <= ranked[0][0] * (1 + SAME_ERROR)]
    lost = [o.failure for o in outcomes if o.failure and not (o.found or o.cut)]
    reason = next(iter(lost), "")
    cut = any(o.cut for o in outcomes) or deadline.over
    lost_whole = "as a simulation of the whole record is lost"
    further = {
        "standard errors are rough, as the solver cannot keep smaller tolerances": rough,
        f"{len(lost)} of {len(outcomes)} starting points could not be simulated: {reason}": lost,
        "the time was over before every starting point was tried": cut,
        f"simulated in windows of {window} samples, {lost_whole}": window < longest,
    }
    remarks = [*estimate.remarks, *_alternatives(shooting, outcomes, window, estimate, fractions)]
    remarks += [remark for remark, holds in further.items() if holds]
    remarks += simulator.remarks
    agreed = len(agreeing), len(ranked)
    doubt = _doubt(shooting, unknowns, window, deadline)
    return replace(estimate, remarks=tuple(remarks), starts=agreed, cut=cut, doubt=doubt)


def check_runs(simulator: Any, record: Record) -> Any:
    """Return the simulator for a record's channels and inputs, if it runs at its start values.

    Raises ValueError, with the reason, for failure at all starting points, as of defective code; a
    failure at some of them is only a bad run. Also raises it for a wrong number of channels.
    """
    simulator = matched(simulator, record.columns, record.inputs)
    begin, parameters = Experiment.of(record, simulator).part(0, 3), simulator.known
    reason: Exception | None = None
    for fractions in starting_points(
        STARTS if parameters.free else 1, max(len(parameters.free), 1)
    ):
        at = dict(zip(parameters.free, fractions, strict=False))
        values = {name: parameters.value_at(name, at.get(name, 0.5)) for name in parameters.given}
        try:
            with np.errstate(all="ignore"):
                y, _ = simulator.respond(begin.time, begin.u, [(values, None)])[0]
        except DeadlineError:
            raise
        except Exception as error:
            reason = reason or error
            if isinstance(error, _DEFECTS):
                break
            continue
        if y.shape != begin.y.shape:
            raise InputError(
                f"simulator must return the record's {record.ny} channel(s), "
                f"{', '.join(record.columns)}, as {begin.y.shape}: got {y.shape}"
            )
        return simulator
    assert reason is not None
    where = ", ".join(f"{name} = {value:.4g}" for name, value in parameters.middle().items())
    raise InputError(
        f"simulator must run at its start values{where and f' ({where})'}: {failure(reason)}"
    ) from reason


def _window(outcomes: Sequence[StartOutcome], longest: float) -> int:
    """Return the longest window length, unless shorter windows fit far better."""
    errors = [(n, error) for outcome in outcomes for n, (_, error) in outcome.found.items()]
    lengths = sorted({n for n, _ in errors}, reverse=True)
    best, chosen = {n: min(e for m, e in errors if m == n) for n in lengths}, lengths[0]
    if chosen < longest or best[chosen] < WINDOWS_FROM_ERROR:
        return chosen
    return next((n for n in lengths[1:] if best[n] < _WORTH_WINDOWS * best[chosen]), chosen)


def _build_estimate(shooting: Shooting, unknowns: Array, window: int) -> Estimate:
    """Return the estimate at the best unknowns, with standard errors."""
    fractions = unknowns[: len(shooting.names)]
    by_channel = _by_channel(shooting, unknowns)
    jacobian = projected(shooting.jacobian(unknowns), len(fractions))
    parameters = shooting.simulator.known
    errors, correlations, remarks = uncertainty(
        shooting.names, parameters, fractions, by_channel, jacobian
    )
    named = [*zip(shooting.names, fractions, errors, strict=True)]
    values = {labelled(name): parameters.value_at(name[0], float(at)) for name, at, _ in named}
    deviations = {labelled(name): float(error) for name, _, error in named}
    rmse = np.sqrt(np.nanmean(by_channel**2, axis=0)) * shooting.scale
    rest = tuple(map(float, rmse)), tuple(remarks), window
    return Estimate(values, deviations, correlations, *rest)


def _by_channel(shooting: Shooting, unknowns: Array) -> Array:
    """Return the residuals in deviations of the channels, `(samples, ny)`, NaN in gaps."""
    measured = np.concatenate([window.part.y for window in shooting.windows])
    residuals = shooting.residuals(unknowns).reshape(measured.shape)
    return np.where(np.isnan(measured), np.nan, residuals)


def _doubt(shooting: Shooting, unknowns: Array, window: int, deadline: Deadline) -> str:
    """Return a sentence if the other course of inputs between samples fits decisively better.

    The other course is fitted from the best values, if there is time.
    """
    simulator = shooting.simulator.otherwise()
    if simulator is None:
        return ""
    other = Shooting(simulator, shooting.experiments, shooting.scale)
    try:
        with within(min(current(), deadline)):
            at = other.divide(window, unknowns[: len(shooting.names)])
            if len(at) and _runs(other, at):
                at, _ = descend(other, at, _ROUNDS)
    except DeadlineError:
        return ""
    with within(NEVER):
        both = [_by_channel(shooting, unknowns), _by_channel(other, at)]
    if not favours(*both):
        return ""
    here, there = (f"{np.sqrt(np.nanmean(residuals**2)):.2g}" for residuals in both)
    better = "held" if simulator.hold == "zoh" else "interpolated"
    return (
        f"the record favours inputs that are {better} between samples, hold={simulator.hold!r} "
        f"(--simulator-hold {simulator.hold}): RMSE {there} instead of {here} standard deviations "
        "of the output"
    )


def _alternatives(
    shooting: Shooting,
    outcomes: Sequence[StartOutcome],
    window: int,
    estimate: Estimate,
    fractions: Array,
) -> list[str]:
    """Return remarks on equally good minima with other values of identifiable parameters."""
    identified = np.isfinite([*estimate.errors.values()])
    fits = [outcome.found[window] for outcome in outcomes if window in outcome.found]
    most, parameters = min(error for _, error in fits) * (1 + SAME_ERROR), shooting.simulator.known
    minima = [fractions]
    for other in (np.array(at) for at, error in fits if error <= most and identified.any()):
        if all(np.abs(other - minimum)[identified].max() > _SAME_PLACE for minimum in minima):
            minima.append(other)

    def in_words(name: Name, place: float) -> str:
        return f"{labelled(name)} = {parameters.value_at(name[0], float(place)):.4g}"

    texts = [map(in_words, shooting.names, other) for other in minima[1:4]]
    return [f"fits as well with {', '.join(values)}" for values in texts]


def starting_points(count: int, dimensions: int) -> Array:
    """Return fractions, `(count, dimensions)`: the middle of the ranges and a Sobol sequence."""
    sobol = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(0))
    drawn = sobol.random_base2(max(int(np.ceil(np.log2(max(count, 2)))), 1))
    return np.concatenate([np.full((1, dimensions), 0.5), drawn])[:count]


def tried(problem: Shooting, effort: Effort, deadline: Deadline) -> list[StartOutcome]:
    """Try starting points in order until enough of them agree; return the outcomes."""
    points = starting_points(effort.starts, len(problem.names))
    done: dict[int, StartOutcome] = {}
    work, workers = partial(_try, problem, points, deadline), effort.workers
    for first in range(0, len(points), ENOUGH):
        batch = [*range(first, min(first + ENOUGH, len(points)))]
        if done and deadline.over:
            break
        # The first start runs in this process: its time decides on further processes.
        alone, began = batch[: problem.simulator.survives and first == 0], now()
        for part in (alone, batch[len(alone) :]):
            for outcome in _side_by_side(work, part, 1 if part is alone else workers):
                done[outcome.number] = outcome
                if effort.progress is not None:
                    effort.progress(len(done), len(points))
            # The time may include compilation, negligible only in a slow start.
            quick = part is alone and alone and now() - began < SLOW
            if quick and _seconds(problem, points[0], deadline) < QUICK:
                workers = 1
        if _settled([done[i] for i in sorted(done)], problem.longest):
            break
    return [done[i] for i in sorted(done)]


def _seconds(problem: Shooting, fractions: Array, deadline: Deadline) -> float:
    """Return the estimated time of a start in s, from its first runs."""
    shooting = Shooting(problem.simulator, problem.experiments, problem.scale)
    with suppress(DeadlineError), within(min(current(), deadline)):
        unknowns = shooting.divide(shooting.longest, fractions)
        began = now()
        shooting.jacobian(unknowns)
        return (now() - began) * _ROUNDS
    return math.inf


def _side_by_side(
    work: Any, batch: Sequence[int], workers: int | Executor
) -> Iterator[StartOutcome]:
    """Yield the outcomes of several starts; the end of a start's process is a failure."""
    pool = Workers(workers) if isinstance(workers, int) and workers > 1 else None
    executor = pool if isinstance(workers, int) else workers
    try:
        for number, future in run_jobs(work, batch, executor):
            error = future.exception()
            if error is None:
                yield future.result()
            elif message := ended_from_outside(error):
                yield StartOutcome(number, failure=message)
            else:
                raise error
    finally:
        if pool is not None:
            pool.shutdown()


def _settled(outcomes: Sequence[StartOutcome], longest: int) -> bool:
    """Return whether enough starts agree on the lowest error, or the last hardly lowered it."""
    errors = [o.found[longest][1] for o in outcomes if longest in o.found]
    if sum(e <= min(errors) * (1 + SAME_ERROR) for e in errors) >= ENOUGH:
        return True
    before = [o.found[longest][1] for o in outcomes[:-PATIENCE] if longest in o.found]
    return min(before, default=np.inf) <= min(errors, default=0.0) * (1 + _HARDLY_BETTER)


def _try(problem: Shooting, points: Array, deadline: Deadline, number: int) -> StartOutcome:
    """Fit from one starting point."""
    shooting = Shooting(problem.simulator, problem.experiments, problem.scale)
    outcomes: dict[int, tuple[list[float], float]] = {}
    fractions, cut = points[number], False
    try:
        with within(min(current(), deadline)):
            for length in _lengths(shooting.longest, growing=number % 2 == 1):
                unknowns = shooting.divide(length, fractions)
                if _runs(shooting, unknowns):
                    unknowns, error = descend(shooting, unknowns, _ROUNDS)
                    fractions = unknowns[: len(fractions)]
                    outcomes[length] = fractions.tolist(), error
    except DeadlineError:
        cut = True
    return StartOutcome(number, outcomes, shooting.failure, cut)


def _lengths(longest: int, growing: bool) -> list[int]:
    """Return the window lengths of all stages, the shortest first."""
    lengths = [longest]
    while growing and lengths[0] > max(_GROWTH * SHORTEST, longest // _WINDOWS):
        lengths.insert(0, -(-lengths[0] // _GROWTH))
    return lengths


def descend(shooting: Shooting, unknowns: Array, rounds: int) -> tuple[Array, float]:
    """Minimise the error within the ranges; return the best unknowns so far, and their error."""
    least, best = np.inf, None

    def residuals(at: Array) -> Array:
        nonlocal least, best
        values = shooting.residuals(at)
        error = _error(values)
        if error < least:
            least, best = error, at.copy()
        return np.concatenate([values, _PULL * (at - begin)])

    def jacobian(at: Array) -> Array:
        return np.vstack([shooting.jacobian(at), _PULL * np.eye(len(at))])

    ranged = np.arange(len(unknowns)) < len(shooting.names)  # states have no range
    bounds = np.where(ranged, 0.0, -np.inf), np.where(ranged, 1.0, np.inf)
    begin = np.where(ranged, np.clip(unknowns, 1e-6, 1 - 1e-6), unknowns)
    how: Any = {"max_nfev": rounds, "x_scale": np.where(ranged, 0.1, 1.0)}
    how |= {"ftol": 1e-8, "xtol": 1e-8, "gtol": 1e-10}
    try:
        scipy.optimize.least_squares(residuals, begin, jacobian, bounds, **how)
    except DeadlineError:
        if best is None:
            raise
    assert best is not None
    return best, least


def _runs(shooting: Shooting, unknowns: Array) -> bool:
    """Return whether most of the records are simulated without failure."""
    return _error(shooting.residuals(unknowns)) < 0.5 * BAD


def _error(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2)))
