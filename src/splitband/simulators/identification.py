"""Fit the parameters of a simulator to records, and assess their identifiability.

`scipy.optimize.least_squares` starts from the middle of the ranges and from points of a Sobol
sequence. Every other start begins with short windows, see `shooting`, which then grow: a short
simulation determines parameters even if a long one loses its phase.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy

from splitband.metrics import spread
from splitband.records import Record, require_records
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import NEVER, Deadline, DeadlineError, current, now, within
from splitband.runtime.errors import InputError
from splitband.runtime.workers import Workers, ended_from_outside, run_jobs
from splitband.simulators.augmentation import (
    AS_GOOD,
    DECAYS,
    MEMBERS,
    beginnings,
    begun,
    held,
    prior,
)
from splitband.simulators.base import matched
from splitband.simulators.least_squares import BAD, minimise
from splitband.simulators.parameters import (
    MIN_NOISE,
    Adjustable,
    Estimate,
    Name,
    favours,
    labelled,
    uncertainty,
)
from splitband.simulators.shooting import (
    GROWTH,
    MOST_GROWTH,
    Compared,
    Experiment,
    Shooting,
)
from splitband.simulators.unknown import Trained
from splitband.simulators.user_code import failure, is_ours

STARTS = 16
"""Default limit of starting points. Bounds the time."""
ENOUGH = 4
"""Number of starts with equal errors at the end of the search, and of starts in a batch, for any
number of processes, so that results do not depend on it. Bounds the time."""
SAME_ERROR = 1e-3
"""Relative difference of equal errors. Rounding."""
SHORTEST, _WINDOWS = 16, 32
"""Samples of the shortest windows, and largest number of windows of the longest record. By eye."""
WORTH_PROCESSES = 10.0
"""Seconds of the first start from which on the others run in processes of their own, which have to
start and to compile the equation. Bounds the time."""
_ROUNDS, LAST_ROUNDS = 30, 300
"""Largest number of steps in a search, and in the last search from the best values. Bounds the
time."""
_PULL = 1e-6
"""Residual of an unknown at a unit's distance from its start: unobservable unknowns do not move.
Rounding."""
_LEAST_WEIGHT = 0.1
"""Least error of a channel, as a share of the largest one, by which channels are weighted. By eye.
"""
TAKEN = 10.0
"""Standard error of a parameter beside unknown terms, by that with these terms known, from which on
they can take its place. By eye."""
_NEAR = 3.0
"""Largest step from the given initial state to that of a first window, in errors of a state that
the window's samples determine, with which the given state is kept. By eye."""
LEAST_SLACK = 1e-2
"""Least slack between windows, see `Shooting`. Rounding."""
_SAME_PLACE = 0.02
"""Distance of equal values, as a share of a range. By eye."""
_DEFECTS = (NameError, AttributeError, ImportError)
"""Errors of code, independent of parameter values."""


@dataclass(frozen=True, eq=False)
class Fit:
    """What was found in windows of one length: unknowns of the windows, and what they rest on.

    `error`: RMS of the errors, in deviations; `sizes`, `noise`: see `Shooting`.
    """

    unknowns: Array
    error: float
    sizes: Array
    noise: Array


class Training(NamedTuple):
    """A fit in windows of some length, with the comparison that it is of."""

    shooting: Shooting
    length: int
    fit: Fit


@dataclass(frozen=True)
class StartOutcome:
    """The outcome of one starting point.

    `found`: fits by length of the windows; `failure`: message of the last failed run; `cut`:
    whether the deadline ended the search.
    """

    number: int
    found: dict[int, Fit] = field(default_factory=dict)
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
    seed : Of the weights of unknown terms.
    progress : Called with the number of finished starts and of all starts.
    """

    starts: int = STARTS
    seconds: float | None = None
    workers: int | Executor = 1
    seed: int = 0
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
    shooting = Shooting(simulator.coarse(), experiments, scale)
    longest, deadline = shooting.longest, min(current(), Deadline.after(effort.seconds))
    outcomes = tried(shooting, effort, deadline)
    if not any(o.found for o in outcomes):
        over = "the time was over before the first one was done"
        reason = next((o.failure for o in outcomes if o.failure), over)
        raise InputError(f"simulator must run for some parameters in their ranges: {reason}")
    window, remarks = _window(outcomes), list[str]()
    ranked = sorted((o.found[window].error, o.number) for o in outcomes if window in o.found)
    best = next(o for o in outcomes if o.number == ranked[0][1])
    fit, members = best.found[window], tuple[Trained, ...]()
    if any(term.free for term in simulator.terms):
        try:
            with within(min(current(), deadline)):
                training, members, remarks = _augmented(shooting, window, best.found, effort.seed)
                shooting, window, fit = training
        except DeadlineError:
            remarks = ["the time was over before the unknown terms were trained: they are left out"]
    with within(NEVER):  # the result is evaluated even after the deadline
        precise = shooting.of(simulator.precise())
        # The solver may not be able to keep smaller tolerances.
        rough = not _runs(precise.restored(window, fit), whole=True)
        shooting = shooting if rough else precise
        shooting.restored(window, fit)
        if shooting.names and not (best.cut or deadline.over):
            fit = _tied(shooting, fit)
        estimate = _build_estimate(shooting, fit.unknowns, window if window < longest else 0)
        if shooting.trained.any():
            terms = held(shooting, shooting.compare(fit.unknowns).path)
            said = (*estimate.remarks, *_replaceable(shooting, fit.unknowns))
            estimate = replace(estimate, terms=terms, members=members, remarks=said)
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
    remarks += estimate.remarks
    if not shooting.trained.any():
        remarks += _alternatives(shooting, outcomes, window, estimate, fit)
    if shooting.names:
        remarks += [remark for remark, holds in further.items() if holds]
    remarks += simulator.remarks
    agreed = (len(agreeing), len(ranked)) if shooting.names else (0, 0)
    doubt = _doubt(shooting, fit, window, deadline)
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
        except Exception as error:
            if is_ours(error):
                raise
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


def _window(outcomes: Sequence[StartOutcome]) -> int:
    """Return the longest windows to which the best start goes on."""
    for n in sorted({n for outcome in outcomes for n in outcome.found}):
        best = min((o for o in outcomes if n in o.found), key=lambda o: o.found[n].error)
        if max(best.found) == n:
            return n
    raise AssertionError


def _augmented(
    alone: Shooting, window: int, found: Mapping[int, Fit], seed: int
) -> tuple[Training, tuple[Trained, ...], list[str]]:
    """Train unknown terms from the fits without them; return the best training.

    Also return the states of terms of others as good, and remarks. Weight decays, trainings from
    other weights, and to have no term at all, are compared by a simulation of the last samples of
    the records, which are held out; then the training goes on with all samples.
    """
    shortest = min(found)
    fit = found[shortest]
    fractions, path = fit.unknowns[: len(alone.names)], alone.restored(shortest, fit).path
    first = beginnings(alone.experiments)
    known = [x[: len(each.y)] for x, each in zip(path, first, strict=True)]

    def trained(
        shooting: Shooting, common: Array, path: Sequence[Array], most: float = np.inf
    ) -> list[Training]:
        """Return the trainings in windows that grow, from parameters, weights and states."""
        lengths = [shortest, *(n for n in _lengths(shooting) if shortest < n <= most)]
        return [Training(shooting, *each) for each in grown(shooting, common, lengths, path)]

    def tried(decay: float | None, seed: int) -> tuple[float, Training | None]:
        """Return the error on held-out samples of a training on the others; None is for no term."""
        shooting, common = alone.of(alone.simulator, first), fractions
        shooting.noise, shooting.sizes = fit.noise, fit.sizes
        if decay is not None:
            shooting.simulator, shooting.trained = begun(shooting, fractions, known, seed)
            common = np.concatenate([fractions, shooting.simulator.weights[shooting.trained]])
            shooting.prior, shooting.decay = prior(shooting, common, known, decay), decay
        found = trained(shooting, common, known)
        errors = [shooting.ahead(each.length, each.fit, alone.experiments) for each in found]
        return min(
            zip(errors, found, strict=True), key=lambda pair: pair[0], default=(np.inf, None)
        )

    def whole(training: Training) -> Training:
        """Return a training that goes on with all samples."""
        shooting = training.shooting.of(training.shooting.simulator, alone.experiments)
        shooting.noise = training.fit.noise
        common = training.fit.unknowns[: shooting.common]
        most = training.length * alone.longest / training.shooting.longest + 1
        if not (found := trained(shooting, common, path, most)):
            return training
        _, length, fit = found[-1]
        shooting.restored(length, fit)
        return Training(shooting, length, descended(shooting, fit.unknowns, LAST_ROUNDS))

    without, _ = tried(None, seed)
    decays = {decay: tried(decay, seed) for decay in DECAYS}
    decay = min(decays, key=lambda each: decays[each][0])
    if not decays[decay][0] < without:
        remark = (
            "the unknown terms were left out: with them, held-out samples are forecast with an "
            f"error of {decays[decay][0]:.3g} deviations, without them of {without:.3g}, as where "
            "the equation lacks a state; a hybrid learns what is missing outside of it"
        )
        return Training(alone, window, found[window]), (), [remark]
    every = [decays[decay], *(tried(decay, seed + i) for i in range(1, MEMBERS))]
    least = min(error for error, _ in every)
    ranked = sorted(every, key=lambda each: each[0])
    best, *others = [whole(t) for error, t in ranked if t and error <= AS_GOOD * least]
    members: list[Trained] = []
    for shooting, length, fit in others:
        members += held(shooting, shooting.restored(length, fit).path)
    return best, tuple(members), []


def _tied(shooting: Shooting, fit: Fit) -> Fit:
    """Minimise the residuals with steps of the state that are as small as the records allow."""
    fit = descended(shooting, fit.unknowns, LAST_ROUNDS)
    shooting.anchored = True
    begins = shooting.compare(fit.unknowns).begins
    shooting.anchored = bool(begins) and float(np.max(np.abs(begins))) < _NEAR
    while shooting.slack > LEAST_SLACK:
        steps = shooting.compare(fit.unknowns).steps
        size = float(np.sqrt(np.mean(np.square(steps)))) if steps else 1.0
        if size > 0.5:
            break
        shooting.slack *= max(size, 0.1)
        fit = descended(shooting, fit.unknowns, LAST_ROUNDS)
    return fit


def _build_estimate(shooting: Shooting, unknowns: Array, window: int) -> Estimate:
    """Return the estimate at the best unknowns, with standard errors."""
    fractions = unknowns[: len(shooting.names)]
    compared = shooting.compare(unknowns, slopes=True)
    errors, parameters = np.concatenate(compared.errors), shooting.simulator.known
    information = shooting.information(shooting.undecayed(compared.normal))
    deviations, correlations, remarks = uncertainty(
        shooting.names, parameters, fractions, errors / shooting.noise, information
    )
    named = [*zip(shooting.names, fractions, deviations, strict=True)]
    values = {labelled(name): parameters.value_at(name[0], float(at)) for name, at, _ in named}
    of = {labelled(name): float(error) for name, _, error in named}
    rmse = np.sqrt(np.nanmean(errors**2, axis=0)) * shooting.scale
    return Estimate(values, of, correlations, tuple(map(float, rmse)), tuple(remarks), window)


def _replaceable(shooting: Shooting, unknowns: Array) -> list[str]:
    """Return a remark on parameters that are far less certain as terms can take their place."""
    normal, n = shooting.compare(unknowns, slopes=True).normal, len(shooting.names)
    normal = shooting.undecayed(normal)
    keep = [*range(n), *range(shooting.common, len(normal))]
    both = [shooting.information(each) for each in (normal, normal[np.ix_(keep, keep)])]
    with np.errstate(all="ignore"):
        free, alone = (np.diag(np.linalg.pinv(each, hermitian=True)) for each in both)
    pairs = zip(shooting.names, free > TAKEN**2 * alone, strict=True)
    names = [labelled(name) for name, is_so in pairs if is_so]
    if not names:
        return []
    its = "its value is the part that they leave it"
    return [f"unknown terms could take the place of {', '.join(names)}: {its}"]


def _doubt(shooting: Shooting, fit: Fit, window: int, deadline: Deadline) -> str:
    """Return a sentence if the other course of inputs between samples fits decisively better.

    The other course is fitted from the best values, if there is time.
    """
    simulator = shooting.simulator.otherwise()
    if simulator is None:
        return ""
    other = shooting.of(simulator)
    other.slack = shooting.slack
    try:
        with within(min(current(), deadline)):
            compared = other.restored(window, fit)
            there = fit
            if len(fit.unknowns) and _runs(compared):
                there = descended(other, fit.unknowns, _ROUNDS)
    except DeadlineError:
        return ""
    with within(NEVER):
        pairs = (shooting, fit), (other, there)
        both = [np.concatenate(each.compare(at.unknowns).errors) for each, at in pairs]
    if not favours(*both):
        return ""
    before, after = (f"{np.sqrt(np.nanmean(errors**2)):.2g}" for errors in both)
    better = "held" if simulator.hold == "zoh" else "interpolated"
    return (
        f"the record favours inputs that are {better} between samples, hold={simulator.hold!r} "
        f"(--simulator-hold {simulator.hold}): RMSE {after} instead of {before} standard "
        "deviations of the output"
    )


def _alternatives(
    shooting: Shooting,
    outcomes: Sequence[StartOutcome],
    window: int,
    estimate: Estimate,
    fit: Fit,
) -> list[str]:
    """Return remarks on equally good minima with other values of identifiable parameters."""
    identified = np.isfinite([*estimate.errors.values()])
    fits, count = [o.found[window] for o in outcomes if window in o.found], len(identified)
    most, parameters = min(fit.error for fit in fits) * (1 + SAME_ERROR), shooting.simulator.known
    minima = [fit.unknowns[:count]]
    for other in (each.unknowns[:count] for each in fits if each.error <= most and any(identified)):
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
    count = effort.starts if problem.names else 1
    points = starting_points(count, max(len(problem.names), 1))[:, : len(problem.names)]
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
            if part is alone and alone and now() - began < WORTH_PROCESSES:
                workers = 1
        errors = [
            o.found[problem.longest].error for o in done.values() if problem.longest in o.found
        ]
        if sum(error <= min(errors) * (1 + SAME_ERROR) for error in errors) >= ENOUGH:
            break
    return [done[i] for i in sorted(done)]


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


def _try(problem: Shooting, points: Array, deadline: Deadline, number: int) -> StartOutcome:
    """Fit from one starting point."""
    shooting = Shooting(problem.simulator, problem.experiments, problem.scale)
    found, cut = dict[int, Fit](), False
    try:
        with within(min(current(), deadline)):
            for length, fit in grown(shooting, points[number], _lengths(shooting)):
                found[length] = fit
    except DeadlineError:
        cut = True
    return StartOutcome(number, found, shooting.failure, cut)


def grown(
    shooting: Shooting,
    common: Array,
    lengths: list[int],
    path: Sequence[Array] | None = None,
) -> Iterator[tuple[int, Fit]]:
    """Yield fits in windows that grow as far as the state allows it, with their lengths.

    Parameters
    ----------
    shooting : The comparison, whose noise is that of the last fit.
    common : Parameters and weights at the beginning.
    lengths : Lengths of windows, the shortest first.
    path : States by record at the beginning; None for those that follow from the parameters.
    """
    found = False
    while lengths:
        length, *lengths = lengths
        shooting.divide(length)
        at = shooting.begun(common) if path is None else shooting.resumed(common, path)
        if not _runs(shooting.compare(at)):
            continue
        fit = descended(shooting, at, _ROUNDS)
        compared = shooting.compare(fit.unknowns, slopes=True)
        here, later = shooting.growth(compared.transitions)
        if here > MOST_GROWTH and (found or -(-length // GROWTH) >= SHORTEST):
            lengths = [] if found else [-(-length // GROWTH), length, *lengths]
            continue
        found, common = True, fit.unknowns[: shooting.common]
        yield length, fit
        if later > MOST_GROWTH:
            break
        whole = all(np.isfinite(x).all() for x in compared.path)
        path = compared.path if whole else path


def _lengths(shooting: Shooting) -> list[int]:
    """Return the window lengths of all stages, the shortest first."""
    longest = shooting.longest
    lengths, least = [longest], max(SHORTEST, longest / _WINDOWS)
    # Without states every window begins with the record: a shorter one omits the rest.
    while shooting.simulator.states and (shorter := -(-lengths[0] // GROWTH)) >= least:
        lengths.insert(0, shorter)
    return lengths


def descended(shooting: Shooting, unknowns: Array, rounds: int) -> Fit:
    """Minimise the residuals within the ranges, and take the noise that is left."""
    ranged = np.arange(len(unknowns)) < len(shooting.names)  # states have no range

    def evaluate(at: Array, slopes: bool) -> tuple[float, Array, Array]:
        compared, moved = shooting.compare(at, slopes), _PULL * (at - begin)
        cost = compared.cost + 0.5 * float(moved @ moved)
        pulled = compared.normal + _PULL**2 * np.eye(len(at))
        return cost, compared.gradient + _PULL * moved, pulled

    begin = np.where(ranged, np.clip(unknowns, 0.0, 1.0), unknowns)
    low, high = np.where(ranged, 0.0, -np.inf), np.where(ranged, 1.0, np.inf)
    alike = slice(len(shooting.names), shooting.common if shooting.trained.any() else 0)
    at, _ = minimise(evaluate, begin, low, high, rounds, alike)
    shooting.learn(at)
    errors = np.concatenate(shooting.compare(at).errors)
    squares = np.nanmean(errors**2, axis=0)
    noise = np.sqrt(squares)
    shooting.noise = np.maximum(noise, max(_LEAST_WEIGHT * noise.max(), MIN_NOISE))
    return Fit(at, float(np.sqrt(np.mean(squares))), shooting.sizes, shooting.noise)


def _runs(compared: Compared, whole: bool = False) -> bool:
    """Return whether most of the records are simulated without failure, or all of them."""
    errors = np.nan_to_num(np.concatenate(compared.errors))
    return bool((np.abs(errors) < BAD).all() if whole else np.mean(errors**2) < (0.5 * BAD) ** 2)
