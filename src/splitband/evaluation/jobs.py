"""Fit forecasters and compute their forecasts: one job per forecaster and seed, in any process."""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median_low
from typing import Any

from splitband.evaluation.costs import job_cost
from splitband.evaluation.work import HALF, RunProgress, Work
from splitband.forecasters.backtest import Backtest, Question, backtest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.caching import Cached
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.grey_box import ESTIMATES
from splitband.forecasters.simulation import CALIBRATIONS
from splitband.runtime.deadlines import Deadline, DeadlineError, now, within
from splitband.runtime.processes import map_jobs
from splitband.training import Checkpoint, Progress

CACHES: tuple[Cached[Any], ...] = (CALIBRATIONS, ESTIMATES)
"""Caches whose results are sent to the jobs."""
LATE = "left out, as the time was over"
FAILED = 2.0
"""A seed whose error is above this multiple of the usual one of the seeds has failed."""
PATIENCE = 2.0
"""A job is abandoned so many seconds, plus the time of its forecasts, after its deadline."""

Key = tuple[str, int]
"""A job: the name of a forecaster, and a seed."""
Seeds = Sequence[int] | Mapping[str, Sequence[int]]
"""The seeds of all forecasters, or by name where they differ."""


@dataclass(frozen=True)
class Failure:
    """Report why a forecaster could not be fitted with one seed; `late`: for lack of time."""

    method: str
    seed: int
    reason: str
    late: bool = False


def reasons(failures: Sequence[Failure], done: Container[str]) -> dict[str, str]:
    """Return the reason of the first failure of each method that is not in `done`."""
    return {f.method: f.reason for f in failures[::-1] if f.method not in done}


@dataclass(frozen=True)
class FitOutcome:
    """Hold the outcome of a job: its forecasts, or why it failed.

    `seconds`: its run time; `fresh`: it trained from start to end, so its time may update the pace.
    """

    backtest: Backtest | None = None
    failure: Failure | None = None
    seconds: float = 0.0
    fresh: bool = False

    @property
    def cut(self) -> bool:
        """Return whether the deadline has changed the outcome."""
        late = self.failure is not None and self.failure.late
        return late or (self.backtest is not None and self.backtest.report.cut)


@dataclass(frozen=True, eq=False)
class FitJobs:
    """Hold what the jobs of a stage share; a call runs one of them, in any process.

    Attributes
    ----------
    forecasters, questions : By name.
    known : Results of each cache in `CACHES`.
    deadline : When trainings stop and keep the weights that they have then.
    checkpoints : Folder of checkpoints; a worker that cannot see it trains without.
    stage : Stage named in progress reports; None: no reports.
    needed : Job that starts even after the deadline, so that there is a result; None: no such job.
    """

    forecasters: Mapping[str, Forecaster]
    questions: Mapping[str, Question]
    known: Sequence[Mapping[Any, Any]]
    deadline: Deadline
    checkpoints: Path | None
    stage: str | None
    needed: Key | None

    def __call__(self, job: Key, report: Callable[[RunProgress], None]) -> tuple[Key, FitOutcome]:
        """Run a job."""
        began, (name, seed) = now(), job
        forecaster, question, stage = self.forecasters[name], self.questions[name], self.stage
        # Methods that are not trained start even after the deadline, so that there is a result.
        if self.deadline.over and forecaster.random and job != self.needed:
            return job, FitOutcome(failure=Failure(name, seed, LATE, late=True))
        for each, results in zip(CACHES, self.known, strict=True):
            each.learn(results)

        def watch(at: Progress) -> None:
            report(RunProgress(name, seed, at.share, at.loss, stage or ""))

        checkpoint = None
        if self.checkpoints is not None and forecaster.random and self.checkpoints.is_dir():
            checkpoint = Checkpoint(checkpoint_path(self.checkpoints, name, seed))
        fresh = forecaster.random and (checkpoint is None or not checkpoint.path.exists())
        with within(self.deadline):
            outcome = _asked(forecaster, question, seed, watch if stage else None, checkpoint)
        fresh = fresh and outcome.failure is None and not outcome.cut
        return job, replace(outcome, seconds=now() - began, fresh=fresh)


def checkpoint_path(folder: Path, name: str, seed: int) -> Path:
    """Return the file from which an interrupted training resumes."""
    name = re.sub(r"[^\w.-]", "_", name)
    return folder / f"{name}-{seed}.safetensors"


def _asked(
    forecaster: Forecaster,
    question: Question,
    seed: int,
    watch: Callable[[Progress], None] | None,
    checkpoint: Checkpoint | None,
) -> FitOutcome:
    late = False
    try:
        return FitOutcome(backtest(forecaster, question, seed, watch, checkpoint))
    except OSError:
        raise  # a full disk, or a process ended from outside, concerns every method
    except DeadlineError as error:
        reason, late = str(error), True
    except (FloatingPointError, ValueError) as error:
        reason = " ".join(str(error).split())
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return FitOutcome(failure=Failure(forecaster.name, seed, reason, late))


def run_all(
    forecasters: Sequence[Forecaster],
    questions: Mapping[str, Question],
    seeds: Seeds,
    work: Work,
    need_one: bool = True,
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """Return the forecasts by method and seed, and the failures.

    `questions` are by name. A forecaster that is not random is fitted once. With `need_one`,
    ValueError is raised if no forecaster could be fitted.
    """
    jobs = {f.name: [(f.name, seed) for seed in _seeds_of(f, seeds)] for f in forecasters}
    ready: dict[str, Forecaster] = {}
    done: dict[Key, FitOutcome] = {}
    for f in forecasters:
        try:
            ready[f.name] = _prepared(f, questions[f.name], work)
        except ValueError as error:
            for job in jobs[f.name]:
                done[job] = FitOutcome(failure=Failure(*job, str(error)))
    # Networks first, as they take longest, so no long job starts last. Among them, the first seed
    # of every method precedes all second ones.
    todo = [job for name in ready for job in jobs[name]]
    todo.sort(key=lambda job: (not ready[job[0]].random, jobs[job[0]].index(job)))
    done |= _carried_out(ready, questions, todo, work, need_one)
    for (name, seed), outcome in done.items():
        if outcome.cut:
            work.time.narrowed(f"{work.stage} of {name}{f' (seed {seed})' if seed else ''}")
    results: dict[str, dict[int, Backtest]] = {name: {} for name in jobs}
    failures = []
    for name, seed in (job for of_method in jobs.values() for job in of_method):
        outcome = done[name, seed]
        if outcome.backtest is not None:
            results[name][seed] = outcome.backtest
        if outcome.failure is not None:
            failures.append(outcome.failure)
    if need_one and not any(results.values()):
        reasons = dict.fromkeys(f"{f.method}: {f.reason}" for f in failures)
        raise ValueError(f"no method could be fitted; {'; '.join(reasons)}")
    return results, failures


def _carried_out(
    forecasters: Mapping[str, Forecaster],
    questions: Mapping[str, Question],
    jobs: Sequence[Key],
    work: Work,
    need_one: bool,
) -> dict[Key, FitOutcome]:
    """Return the outcome of each job; jobs that run far past the deadline are given up."""
    time, checkpoints = work.time, None
    if work.checkpoints is not None:
        checkpoints = Path(work.checkpoints).absolute()
        checkpoints.mkdir(parents=True, exist_ok=True)
    fit = FitJobs(
        forecasters,
        questions,
        [dict(each.results) for each in CACHES],
        work.deadline,
        checkpoints,
        None if work.progress is None else work.stage,
        jobs[0] if jobs and need_one else None,
    )
    costs = {name: job_cost(f, questions[name]) for name, f in forecasters.items()}
    watch = _Watch(work, {job: costs[job[0]] for job in jobs})
    # Jobs without training check the deadline themselves, and their results are always needed.
    patience = Deadline()
    if any(f.random for f in forecasters.values()):
        patience = Deadline(work.deadline.at + PATIENCE + time.pace.forecasting)
    done: dict[Key, FitOutcome] = {}
    for job, outcome in map_jobs(fit, jobs, work.executor or work.jobs, watch.report, patience):
        done[job] = outcome
        if outcome.fresh and outcome.backtest is not None:
            forecasting = outcome.seconds - outcome.backtest.report.seconds
            time.pace.measured(costs[job[0]], outcome.seconds, forecasting)
        watch.finished(job)
    for job in jobs:
        done.setdefault(job, FitOutcome(failure=Failure(*job, LATE, late=True)))
    return done


def _seeds_of(forecaster: Forecaster, seeds: Seeds) -> Sequence[int]:
    """Return the seeds of one forecaster: a single one where it is not random."""
    if isinstance(seeds, Mapping):
        seeds = seeds.get(forecaster.name, (0,))
    return seeds if forecaster.random else seeds[:1]


def _prepared(forecaster: Forecaster, asked: Question, work: Work) -> Forecaster:
    """Return the forecaster after computing, once, what all of its jobs share.

    Raises ValueError if the forecaster's own simulator fails.
    """
    fits = sorted({origin.fitted for origin in asked.origins})
    record, ahead = asked.record[: fits[-1]], asked.end - fits[-1]
    try:
        forecaster = forecaster.simulated(record, ahead, *asked.others, *asked.tests)
    except ValueError:
        if not asked.tests:
            raise
        # It may fail for the test records only, which are then left out.
        forecaster = forecaster.simulated(record, ahead, *asked.others)
    # These errors are not lost: the job that needs the result computes it again and reports them.
    workers, folder = work.executor or work.jobs, work.checkpoints
    first_half = Deadline.after(HALF * work.deadline.left)  # the rest is for the jobs
    with suppress(ValueError, DeadlineError), within(first_half):
        for samples in fits:
            training = [asked.record[:samples], *asked.others]
            forecaster.prepare(training, workers, None if folder is None else Path(folder))
    return forecaster


class _Watch:
    """Report the progress of a stage, as a share of the whole command."""

    def __init__(self, work: Work, costs: Mapping[Key, float]) -> None:
        self._work, self._costs = work, costs
        self._shares: dict[Key, float] = {}

    def report(self, at: RunProgress) -> None:
        """Report an epoch."""
        self._shares[at.method, at.seed] = at.share
        if self._work.progress is None:
            return
        done = sum(share * self._costs.get(key, 0.0) for key, share in [*self._shares.items()])
        first, last = self._work.span
        share = done / max(sum(self._costs.values()), 1e-9)
        self._work.progress(replace(at, overall=first + min(share, 1.0) * (last - first)))

    def finished(self, job: Key) -> None:
        """Report the end of a job, which may have had no epochs."""
        if self._shares.get(job, 0.0) < 1.0:
            self.report(RunProgress(*job, 1.0, float("nan"), self._work.stage))


def failed_seeds(
    reports: Mapping[int, FitReport], errors: Mapping[int, float] | None = None
) -> dict[int, str]:
    """Return the seeds of a method that failed in training, and why; if all failed, none of them.

    Their errors are compared with the median, of two seeds with the lower one. The lowest of many
    may be that of a training that has learned the noise.

    Parameters
    ----------
    reports : Fit reports by seed.
    errors : Errors of the simulations of the training record, by seed. By default the last training
        losses of all networks together, which are comparable if all seeds are trained alike.
    """
    stable = [seed for seed, report in reports.items() if report.stable]
    failed = dict.fromkeys(reports.keys() - stable, "it is unstable, and may grow without bound")
    if not stable:
        failed, stable = {}, [*reports]
    if errors is None:
        errors = {
            seed: sum(losses[-1] ** 2 for losses in report.losses.values() if len(losses)) ** 0.5
            for seed, report in reports.items()
        }
    usual = median_low(errors[seed] for seed in stable) if stable else 0.0
    for seed in stable:
        if usual and errors[seed] > FAILED * usual:
            failed[seed] = f"training error {errors[seed] / usual:.3g} times the usual one"
    return failed if len(failed) < len(reports) else {}
