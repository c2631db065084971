"""Search the ranges of parameters from several starting points.

`scipy.optimize.least_squares` starts from the middle of the ranges and from points of a Sobol
sequence. Every other start begins with short windows, see `shooting`, which then grow: a short
simulation determines parameters even where a long one loses its phase.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import Deadline, DeadlineError, current, within
from splitband.runtime.files import write_json
from splitband.runtime.workers import Workers, ended_from_outside, run_jobs
from splitband.simulators.shooting import BAD, Shooting, fit_key

STARTS = 32
"""Default limit of starting points. By eye."""
ENOUGH = 4
"""The search stops after so many starts with the same error. By eye."""
PATIENCE, _HARDLY_BETTER = 8, 0.02
"""The search stops if the last `PATIENCE` starts lowered the error by less than this share.
By eye."""
_BATCH = 4
"""Starting points that are tried in parallel. By eye; independent of the number of processes, so
that the result is too."""
SAME_ERROR = 1e-3
"""Relative difference within which errors count as the same. By eye."""
SHORTEST = 16
"""Samples of the shortest windows. By eye."""
_GROWTH = 4
"""Factor by which windows grow from stage to stage. By eye."""
_WINDOWS = 32
"""Windows are not made shorter once the longest record has so many. By eye."""
_ROUNDS, LAST_ROUNDS = 30, 100
"""Most evaluations in a search, and in the last one from the best places. By eye."""


@dataclass(frozen=True)
class StartOutcome:
    """Hold the result of one starting point.

    Attributes
    ----------
    number : Number of the start.
    found : Places and error, in deviations, by length of the windows.
    failure : Message of the last failed run.
    cut : Whether the deadline passed before the search was done.
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
    folder : Folder of finished starts, from which an interrupted fit resumes; created if missing.
    progress : Called with the number of finished starts and of all starts.
    """

    starts: int = STARTS
    seconds: float | None = None
    workers: int | Executor = 1
    folder: Path | None = None
    progress: Callable[[int, int], None] | None = None


def starting_points(count: int, dimensions: int) -> Array:
    """Return places, `(count, dimensions)`: the middle of the ranges and a Sobol sequence."""
    sobol = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(0))
    drawn = sobol.random_base2(max(int(np.ceil(np.log2(max(count, 2)))), 1))
    return np.concatenate([np.full((1, dimensions), 0.5), drawn])[:count]


def tried(problem: Shooting, effort: Effort, deadline: Deadline) -> list[StartOutcome]:
    """Try starting points in order until enough of them agree, and return their outcomes."""
    points = starting_points(effort.starts, len(problem.names))
    kept = _StartStore.of(problem, len(points), effort.folder)
    done = kept.outcomes
    work = partial(_try, problem, points, deadline)
    for first in range(0, len(points), _BATCH):
        batch = [i for i in range(first, min(first + _BATCH, len(points))) if i not in done]
        if done and deadline.over:
            break
        for outcome in _side_by_side(work, batch, effort.workers):
            kept.keep(outcome)
            if effort.progress is not None:
                effort.progress(len(done), len(points))
        if _settled([done[i] for i in sorted(done) if i < first + _BATCH], problem.longest):
            break
    return [done[i] for i in sorted(done) if i < first + _BATCH]


def _side_by_side(
    work: Any, batch: Sequence[int], workers: int | Executor
) -> Iterator[StartOutcome]:
    """Yield the outcomes of several starts; a start whose process has ended has failed."""
    own = Workers(workers) if isinstance(workers, int) and workers > 1 else None
    executor = workers if isinstance(workers, Executor) else own
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


def _try(
    problem: Shooting,
    points: Array,
    deadline: Deadline,
    number: int,
) -> StartOutcome:
    """Fit from one starting point."""
    shooting = Shooting(problem.simulator, problem.experiments, problem.scale)
    found: dict[int, tuple[list[float], float]] = {}
    places, cut = points[number], False
    try:
        with within(min(current(), deadline)):
            for length in _lengths(shooting.longest, growing=number % 2 == 1):
                shooting.divide(length, places)
                error = _error(shooting.residuals(places))
                if error < 0.5 * BAD:
                    places, error = descend(shooting, places, _ROUNDS)
                    found[length] = places.tolist(), error
    except DeadlineError:
        cut = True
    return StartOutcome(number, found, shooting.failure, cut)


def _lengths(longest: int, growing: bool) -> list[int]:
    """Return the window lengths of all stages, the shortest first."""
    lengths = [longest]
    while growing and lengths[0] > max(_GROWTH * SHORTEST, longest // _WINDOWS):
        lengths.insert(0, -(-lengths[0] // _GROWTH))
    return lengths


def descend(shooting: Shooting, places: Array, rounds: int) -> tuple[Array, float]:
    """Minimise the error from `places` within the ranges; return the best places and their error.

    After the deadline the best places so far are returned.
    """
    least, best = np.inf, None

    def residuals(at: Array) -> Array:
        nonlocal least, best
        found = shooting.residuals(at)
        error = _error(found)
        if error < least:
            least, best = error, at.copy()
        return found

    begin = np.clip(places, 1e-6, 1 - 1e-6)
    try:
        scipy.optimize.least_squares(
            residuals, begin, shooting.jacobian, bounds=(0.0, 1.0), max_nfev=rounds,
            x_scale=0.1, ftol=1e-8, xtol=1e-8, gtol=1e-10,
        )  # fmt: skip
    except DeadlineError:
        if best is None:
            raise
    assert best is not None
    return best, least


def _error(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2)))


@dataclass(frozen=True)
class _StartStore:
    """Hold the outcomes of starts, and store them in a file for a repetition of the same fit."""

    path: Path | None
    key: str
    outcomes: dict[int, StartOutcome]

    @classmethod
    def of(cls, problem: Shooting, starts: int, folder: Path | None) -> _StartStore:
        if folder is None:
            return cls(None, "", {})
        key = fit_key(problem.simulator, problem.experiments, starts)
        path = folder / f"parameters-{key[:16]}.json"
        try:
            facts = json.loads(path.read_text(encoding="utf-8"))
            outcomes = [_outcome(each) for each in facts["starts"]] if facts["key"] == key else []
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            outcomes = []
        return cls(path, key, {each.number: each for each in outcomes})

    def keep(self, outcome: StartOutcome) -> None:
        self.outcomes[outcome.number] = outcome
        if self.path is None or outcome.cut:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        starts = [asdict(each) for each in self.outcomes.values() if not each.cut]
        write_json(self.path, {"key": self.key, "starts": starts})


def _outcome(facts: dict[str, Any]) -> StartOutcome:
    found = {int(n): ([*map(float, at)], float(e)) for n, (at, e) in facts["found"].items()}
    return StartOutcome(int(facts["number"]), found, str(facts["failure"]))
