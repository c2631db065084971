"""Fit the parameters of a simulator to records, and assess their identifiability.

`scipy.optimize.least_squares` starts from the middle of the ranges and from points of a Sobol
sequence. Every other start begins with short windows, see `shooting`, which then grow: a short
simulation determines parameters even where a long one loses its phase.
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

from splitband.data import Record, require_records
from splitband.metrics import spread
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
"""The search stops after so many starts with the same error. So many are tried in parallel, on any
number of processes, so that the result does not depend on it. By eye."""
PATIENCE, _HARDLY_BETTER = 8, 0.02
"""The search stops if the last `PATIENCE` starts lowered the error by less than this share.
By eye."""
SAME_ERROR = 1e-3
"""Relative difference within which errors count as the same. Rounding."""
SHORTEST, _GROWTH, _WINDOWS = 16, 4, 32
"""Samples of the shortest windows, the factor by which they grow from stage to stage, and how many
the longest record has at most in the first one. By eye."""
_PULL = 1e-6
"""Residual of an unknown that moves from its start by its unit: those that the records do not tell
stay where they are. Rounding."""
QUICK, SLOW = 2.0, 20.0
"""Seconds. Starts that are quicker than the first number run in one process: further ones would
first have to start and to compile the equation, 4 s here. If the first start takes longer than the
second number, by eye, they are slow.
"""
_ROUNDS, LAST_ROUNDS = 30, 100
"""Most evaluations in a search, and in the last one, from the best values. Bounds the time."""
_SAME_PLACE = 0.02
"""Distance, as a share of a range, within which values count as the same. By eye."""
WINDOWS_FROM_ERROR, _WORTH_WINDOWS = 0.6, 0.3
"""Error of a simulation of whole records, in deviations, from which on windows are considered, and
the share of it below which they are used. By eye."""
_DEFECTS = (NameError, AttributeError, ImportError)
"""Errors of code that do not depend on parameter values."""


@dataclass(frozen=True)
class StartOutcome:
    """Hold what one starting point led to.

    `found`: places in the ranges and error, in deviations, by length of the windows; `failure`: of
    the last failed run; `cut`: whether the deadline passed before the search was done.
    """

    number: int
    found: dict[int, tuple[list[float], float]] = field(default_factory=dict)
    failure: str = ""
    cut: bool = False


@dataclass(frozen=True)
class Effort:
    """Limit the effort of a fit.

    Attributes
    ----------
    starts : Most starting points.
    seconds : Time limit, after which the best result so far is used; None for no limit.
    workers : Number of processes that try starts in parallel, or an executor.
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
    records : Records of which all samples are used; each has its own initial values.
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
    # Without states every window begins with the record: a shorter one leaves out the rest.
    window = _window(outcomes, longest if simulator.states else math.inf)
    ranked = sorted((o.found[window][1], o.number) for o in outcomes if window in o.found)
    best = next(o for o in outcomes if o.number == ranked[0][1])
    fractions = np.array(best.found[window][0])
    with within(NEVER):  # the result is evaluated even after the deadline
        precise = Shooting(simulator.precise(), experiments, scale)
        unknowns = precise.divide(window, fractions)
        rough = not _runs(precise, unknowns)  # as its solver cannot be that precise
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
    more = {
        "standard errors are rough, as the solver cannot keep smaller tolerances": rough,
        f"{len(lost)} of {len(outcomes)} starting points could not be simulated: {reason}": lost,
        "the time was over before every starting point was tried": cut,
        f"simulated in windows of {window} samples, {lost_whole}": window < longest,
    }
    remarks = [*estimate.remarks, *_alternatives(shooting, outcomes, window, estimate, fractions)]
    remarks += [remark for remark, holds in more.items() if holds]
    remarks += simulator.remarks
    agreed = len(agreeing), len(ranked)
    doubt = _doubt(shooting, unknowns, window, deadline)
    return replace(estimate, remarks=tuple(remarks), starts=agreed, cut=cut, doubt=doubt)


def check_runs(simulator: Any, record: Record) -> Any:
    """Return the simulator for a record's channels and inputs, if it runs at its start values.

    Raises ValueError, with the reason, for one that fails wherever a search begins, as code with a
    wrong type does; where a function of the parameters is not defined, a run is a bad one. Also
    raises it where another number of channels comes than the record has.
    """
    simulator = matched(simulator, record.columns, record.inputs)
    begin, known = Experiment.of(record, simulator).part(0, 3), simulator.known
    reason: Exception | None = None
    for fractions in starting_points(STARTS if known.free else 1, max(len(known.free), 1)):
        at = dict(zip(known.free, fractions, strict=False))
        values = {name: known.value_at(name, at.get(name, 0.5)) for name in known.given}
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
    where = ", ".join(f"{name} = {value:.4g}" for name, value in known.middle().items())
    raise InputError(
        f"simulator must run at its start values{where and f' ({where})'}: {failure(reason)}"
    ) from reason


def _window(outcomes: Sequence[StartOutcome], longest: float) -> int:
    """Return the longest window length, unless shorter windows fit far better."""
    found = [(n, error) for each in outcomes for n, (_, error) in each.found.items()]
    lengths = sorted({n for n, _ in found}, reverse=True)
    best, chosen = {n: min(e for m, e in found if m == n) for n in lengths}, lengths[0]
    if chosen < longest or best[chosen] < WINDOWS_FROM_ERROR:
        return chosen
    return next((n for n in lengths[1:] if best[n] < _WORTH_WINDOWS * best[chosen]), chosen)


def _build_estimate(shooting: Shooting, unknowns: Array, window: int) -> Estimate:
    """Return the estimate at the best unknowns, with standard errors."""
    fractions = unknowns[: len(shooting.names)]
    by_channel = _by_channel(shooting, unknowns)
    jacobian = projected(shooting.jacobian(unknowns), len(fractions))
    known = shooting.simulator.known
    errors, correlations, remarks = uncertainty(
        shooting.names, known, fractions, by_channel, jacobian
    )
    named = [*zip(shooting.names, fractions, errors, strict=True)]
    values = {labelled(name): known.value_at(name[0], float(at)) for name, at, _ in named}
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
    """Return a sentence where the other course of inputs between samples fits decisively better.

    It is fitted once more from the values that were found, if there is time.
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
        found = [_by_channel(shooting, unknowns), _by_channel(other, at)]
    if not favours(*found):
        return ""
    here, there = (f"{np.sqrt(np.nanmean(each**2)):.2g}" for each in found)
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
    """Return remarks on minima that fit as well, with other values of identifiable parameters."""
    told = np.isfinite([*estimate.errors.values()])
    fits = [each.found[window] for each in outcomes if window in each.found]
    most, known = min(error for _, error in fits) * (1 + SAME_ERROR), shooting.simulator.known
    found = [fractions]
    for other in (np.array(at) for at, error in fits if error <= most and told.any()):
        if all(np.abs(other - each)[told].max() > _SAME_PLACE for each in found):
            found.append(other)

    def in_words(name: Name, place: float) -> str:
        return f"{labelled(name)} = {known.value_at(name[0], float(place)):.4g}"

    texts = [map(in_words, shooting.names, other) for other in found[1:4]]
    return [f"fits as well with {', '.join(each)}" for each in texts]


def starting_points(count: int, dimensions: int) -> Array:
    """Return fractions, `(count, dimensions)`: the middle of the ranges and a Sobol sequence."""
    sobol = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(0))
    drawn = sobol.random_base2(max(int(np.ceil(np.log2(max(count, 2)))), 1))
    return np.concatenate([np.full((1, dimensions), 0.5), drawn])[:count]


def tried(problem: Shooting, effort: Effort, deadline: Deadline) -> list[StartOutcome]:
    """Try starting points in order until enough of them agree, and return their outcomes."""
    points = starting_points(effort.starts, len(problem.names))
    done: dict[int, StartOutcome] = {}
    work, workers = partial(_try, problem, points, deadline), effort.workers
    for first in range(0, len(points), ENOUGH):
        batch = [*range(first, min(first + ENOUGH, len(points)))]
        if done and deadline.over:
            break
        # The first start, in this process, shows whether others are worth starting.
        alone, began = batch[: problem.simulator.survives and first == 0], now()
        for part in (alone, batch[len(alone) :]):
            for outcome in _side_by_side(work, part, 1 if part is alone else workers):
                done[outcome.number] = outcome
                if effort.progress is not None:
                    effort.progress(len(done), len(points))
            # It may have compiled an equation; only of a slow one is that a small part.
            quick = part is alone and alone and now() - began < SLOW
            if quick and _seconds(problem, points[0], deadline) < QUICK:
                workers = 1
        if _settled([done[i] for i in sorted(done)], problem.longest):
            break
    return [done[i] for i in sorted(done)]


def _seconds(problem: Shooting, fractions: Array, deadline: Deadline) -> float:
    """Return about how long a start takes, of whose runs the first ones are done."""
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
    """Yield the outcomes of several starts; a start whose process has ended has failed."""
    own = Workers(workers) if isinstance(workers, int) and workers > 1 else None
    executor = own if isinstance(workers, int) else workers
    try:
        for number, future in run_jobs(work, batch, executor):
            error = future.exception()
            if error is None:
                yield future.result()
            elif said := ended_from_outside(error):
                yield StartOutcome(number, failure=said)
            else:
                raise error
    finally:
        if own is not None:
            own.shutdown()


def _settled(outcomes: Sequence[StartOutcome], longest: int) -> bool:
    """Return whether enough starts agree on the lowest error, or it has hardly fallen lately."""
    errors = [o.found[longest][1] for o in outcomes if longest in o.found]
    if sum(e <= min(errors) * (1 + SAME_ERROR) for e in errors) >= ENOUGH:
        return True
    before = [o.found[longest][1] for o in outcomes[:-PATIENCE] if longest in o.found]
    return min(before, default=np.inf) <= min(errors, default=0.0) * (1 + _HARDLY_BETTER)


def _try(problem: Shooting, points: Array, deadline: Deadline, number: int) -> StartOutcome:
    """Fit from one starting point."""
    shooting = Shooting(problem.simulator, problem.experiments, problem.scale)
    found: dict[int, tuple[list[float], float]] = {}
    fractions, cut = points[number], False
    try:
        with within(min(current(), deadline)):
            for length in _lengths(shooting.longest, growing=number % 2 == 1):
                unknowns = shooting.divide(length, fractions)
                if _runs(shooting, unknowns):
                    unknowns, error = descend(shooting, unknowns, _ROUNDS)
                    fractions = unknowns[: len(fractions)]
                    found[length] = fractions.tolist(), error
    except DeadlineError:
        cut = True
    return StartOutcome(number, found, shooting.failure, cut)


def _lengths(longest: int, growing: bool) -> list[int]:
    """Return the window lengths of all stages, the shortest first."""
    lengths = [longest]
    while growing and lengths[0] > max(_GROWTH * SHORTEST, longest // _WINDOWS):
        lengths.insert(0, -(-lengths[0] // _GROWTH))
    return lengths


def descend(shooting: Shooting, unknowns: Array, rounds: int) -> tuple[Array, float]:
    """Minimise the error within the ranges; return the best unknowns and their error.

    After the deadline the best ones so far are returned.
    """
    least, best = np.inf, None

    def residuals(at: Array) -> Array:
        nonlocal least, best
        found = shooting.residuals(at)
        error = _error(found)
        if error < least:
            least, best = error, at.copy()
        return np.concatenate([found, _PULL * (at - begin)])

    def jacobian(at: Array) -> Array:
        return np.vstack([shooting.jacobian(at), _PULL * np.eye(len(at))])

    ranged = np.arange(len(unknowns)) < len(shooting.names)  # the states are not
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
    """Return whether most of the records can be simulated."""
    return _error(shooting.residuals(unknowns)) < 0.5 * BAD


def _error(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2)))
