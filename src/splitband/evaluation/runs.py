"""Forecasters on a record, each with each seed: a job each, wherever jobs are carried out."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.costs import job_cost
from splitband.forecasters.backtest import Backtest, Question, backtest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.grey_box import ESTIMATES
from splitband.forecasters.remembering import Remembered
from splitband.forecasters.simulation import CALIBRATIONS
from splitband.runtime.deadlines import Deadline, OverError, now, within
from splitband.runtime.job_folders import Files, JobFolder
from splitband.runtime.processes import Processes, over
from splitband.training import Checkpoint, Progress


@dataclass(frozen=True)
class RunProgress:
    """An epoch of one run is over; `share` of the run's training is done.

    `stage` is "search" and a number where ways to train are tried, "held-out fit" where methods
    are, "on a baseline" where a network is put on one of them, and "final fit" where a method is
    fitted to the whole training part.
    """

    method: str
    seed: int
    share: float
    loss: float
    stage: str = "final fit"
    overall: float = 0.0


@dataclass(frozen=True)
class Work:
    """How a comparison is computed; none of it changes a number by more than rounding.

    Attributes
    ----------
    jobs : Processes at once, each on one thread. With several, a script has to keep what it does
        under `if __name__ == "__main__":`, as each process begins by importing it.
    progress : Called in this process after each epoch of each run; with an executor that cannot
        send while a job runs, at the end of each run.
    checkpoints : Folder, created if need be, from which trainings that were cut off go on. Workers
        that do not see it send their trainings there when these are over.
    stage : What the progress is reported as.
    executor : What carries out the jobs in place of processes of this machine: any executor of
        `concurrent.futures`, Dask's (`Cluster`) or mpi4py's, for instance. It stays open.
    time : The time of the whole command, and what is known of the machine's pace.
    deadline : When the trainings of this stage end with what they have, and what has not begun yet
        is left out.
    span : Shares of the whole command that are done before this stage and after it, for `progress`.
    """

    jobs: int = 1
    progress: Callable[[RunProgress], None] | None = None
    checkpoints: str | Path | None = None
    stage: str = "final fit"
    executor: Executor | None = None
    time: TimeBudget = field(default_factory=TimeBudget)
    deadline: Deadline = field(default_factory=Deadline)
    span: tuple[float, float] = (0.0, 1.0)

    @property
    def cores(self) -> int:
        """Trainings side by side."""
        return max(self.jobs, getattr(self.executor, "cores", 1))

    def for_stage(
        self,
        stage: str,
        deadline: Deadline | None = None,
        span: tuple[float, float] | None = None,
    ) -> Work:
        """For one of several parts of the work, with a folder of its own for checkpoints."""
        below = None if self.checkpoints is None else Path(self.checkpoints) / stage
        return replace(
            self,
            checkpoints=below,
            stage=stage,
            deadline=deadline or self.deadline,
            span=span or self.span,
        )

    def alone(self) -> Work:
        """In this process, where starting others would take longer than the work."""
        return replace(self, jobs=1, executor=None)

    @contextmanager
    def staffed(self) -> Iterator[Work]:
        """With processes that carry out one stage after the other, as starting them takes time."""
        if self.executor is not None or self.jobs == 1:
            yield self
            return
        if not self.time.allows_processes(self.time.share(HALF)):
            self.time.cores = 1
            yield self.alone()
            return
        with Processes(self.jobs) as processes:
            yield replace(self, executor=processes)


@dataclass(frozen=True)
class Failure:
    """One forecaster that could not be fitted with one seed, and why."""

    method: str
    seed: int
    reason: str
    late: bool = False
    """Whether it is for want of time."""


REMEMBERED: tuple[Remembered[Any], ...] = (CALIBRATIONS, ESTIMATES)
"""What jobs are told of that has been computed before."""
LATE = "left out, as the time was over"
HALF = 0.5
PATIENCE = 2.0
"""Seconds after its deadline, and what the forecasts take, until a job is given up."""


def run_all(
    forecasters: Sequence[Forecaster],
    questions: Mapping[str, Question],
    seeds: Sequence[int] | Mapping[str, Sequence[int]],
    work: Work,
    need_one: bool = True,
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """What each forecaster says with each seed, by name; and what could not be fitted.

    `questions` are by name, too, and so are `seeds` where methods differ in them. A forecaster that
    is not random is fitted once. With `need_one`, ValueError is raised when nothing could be fitted
    at all.
    """
    seeds_of = {f.name: _seeds_of(f, seeds) for f in forecasters}
    stage = None if work.progress is None else work.stage
    ready: dict[str, Forecaster] = {}
    done: dict[tuple[str, int], Backtest | Failure] = {}
    for f in forecasters:
        try:
            ready[f.name] = _prepared(f, questions[f.name], work)
        except ValueError as error:
            done |= {(f.name, s): Failure(f.name, s, str(error)) for s in seeds_of[f.name]}
    costs = {name: job_cost(f, questions[name]) for name, f in ready.items()}
    with _place(work) as place:
        # Of each method one seed first. Networks take longest: no process is left with one of them
        # at the end.
        ordered = sorted(
            [(f, i, seed) for f in ready.values() for i, seed in enumerate(seeds_of[f.name])],
            key=lambda each: (not each[0].random, each[1]),
        )
        todo = [
            _FitJob(
                f.name,
                seed,
                place.files(_file(f.name, seed)) if place and f.random else {},
                work.deadline,
                need_one and at == 0,
            )
            for at, (f, _, seed) in enumerate(ordered)
        ]
        job = partial(
            _work, ready, questions, stage, place, [dict(each.results) for each in REMEMBERED]
        )
        workers = work.executor or work.jobs
        watch = _Watch(work, {(each.name, each.seed): costs[each.name] for each in todo})
        # What needs no training looks at the deadline by itself, and is what there is in any case.
        trains = any(f.random for f in ready.values())
        late = Deadline(work.deadline.at + PATIENCE + work.time.pace.asking)
        patience = late if trains else Deadline()
        for done_job in over(job, todo, workers, watch.report, patience):
            key = done_job.name, done_job.seed
            done[key] = done_job.outcome
            if done_job.fresh and isinstance(done_job.outcome, Backtest):
                asking = done_job.seconds - done_job.outcome.report.seconds
                work.time.pace.measured(costs[done_job.name], done_job.seconds, asking)
            watch.finished(key, done_job.outcome)
            if place is not None:
                place.keep(done_job.files)
    for each in todo:
        done.setdefault((each.name, each.seed), Failure(each.name, each.seed, LATE, late=True))
    _note(work, done)
    results, failures = _sorted_out(seeds_of, done)
    if need_one and not any(results.values()):
        reasons = dict.fromkeys(f"{f.method}: {f.reason}" for f in failures)
        raise ValueError(f"no method could be fitted; {'; '.join(reasons)}")
    return results, failures


def _place(work: Work) -> AbstractContextManager[JobFolder | None]:
    """Where checkpoints are, while jobs are carried out."""
    if work.checkpoints is None:
        return nullcontext()
    elsewhere = work.executor is not None and not isinstance(work.executor, Processes)
    return JobFolder.opened(Path(work.checkpoints), anywhere=elsewhere)


def _sorted_out(
    seeds_of: Mapping[str, Sequence[int]], done: Mapping[tuple[str, int], Backtest | Failure]
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """Results and failures, in the order of forecasters and seeds."""
    results: dict[str, dict[int, Backtest]] = {name: {} for name in seeds_of}
    failures = []
    for name, seeds in seeds_of.items():
        for seed in seeds:
            outcome = done[name, seed]
            if isinstance(outcome, Failure):
                failures.append(outcome)
            else:
                results[name][seed] = outcome
    return results, failures


def _seeds_of(
    forecaster: Forecaster, seeds: Sequence[int] | Mapping[str, Sequence[int]]
) -> Sequence[int]:
    """The seeds of one forecaster: a single one where it is not random."""
    if isinstance(seeds, Mapping):
        seeds = seeds.get(forecaster.name, (0,))
    return seeds if forecaster.random else seeds[:1]


def _prepared(forecaster: Forecaster, asked: Question, work: Work) -> Forecaster:
    """With what all of its jobs share computed here, once for all processes.

    Raises ValueError where a simulator of its own fails.
    """
    fits = sorted({origin.fitted for origin in asked.origins})
    record, ahead = asked.record[: fits[-1]], asked.end - fits[-1]
    try:
        forecaster = forecaster.simulated(record, ahead, *asked.others, *asked.tests)
    except ValueError:
        if not asked.tests:
            raise
        # It may only fail for test records, and is not asked about them then.
        forecaster = forecaster.simulated(record, ahead, *asked.others)
    # These errors are not lost: the job that needs the result computes it again and reports them.
    workers, folder = work.executor or work.jobs, work.checkpoints
    first_half = Deadline.after(HALF * work.deadline.left)  # the rest is for what is built on it
    with suppress(ValueError, OverError), within(first_half):
        for samples in fits:
            training = [asked.record[:samples], *asked.others]
            forecaster.prepare(training, workers, None if folder is None else Path(folder))
    return forecaster


def _note(work: Work, done: Mapping[tuple[str, int], Backtest | Failure]) -> None:
    """Write down what the deadline has changed."""
    for (name, seed), outcome in done.items():
        late = isinstance(outcome, Failure) and outcome.late
        if late or (isinstance(outcome, Backtest) and outcome.report.cut):
            work.time.narrowed(f"{name}, {f'seed {seed}, ' if seed else ''}{work.stage}")


class _Watch:
    """What is done of a stage, as a share of the whole command."""

    def __init__(self, work: Work, costs: Mapping[tuple[str, int], float]) -> None:
        self._work, self._costs = work, costs
        self._shares: dict[tuple[str, int], float] = {}

    def report(self, at: RunProgress) -> None:
        """Tell of an epoch."""
        self._shares[at.method, at.seed] = at.share
        self._tell(at)

    def finished(self, key: tuple[str, int], outcome: Backtest | Failure) -> None:
        """Tell of a job that has no epochs, too."""
        told = self._shares.get(key, 0.0)
        self._shares[key] = 1.0
        if told < 1.0:
            loss = float("nan")
            self._tell(RunProgress(*key, 1.0, loss, self._work.stage))

    def _tell(self, at: RunProgress) -> None:
        if self._work.progress is None:
            return
        done = sum(share * self._costs.get(key, 0.0) for key, share in [*self._shares.items()])
        first, last = self._work.span
        share = done / max(sum(self._costs.values()), 1e-9)
        self._work.progress(replace(at, overall=first + min(share, 1.0) * (last - first)))


@dataclass(frozen=True)
class _FitJob:
    """A forecaster with a seed, and what there is of its training already."""

    name: str
    seed: int
    files: Files
    deadline: Deadline
    needed: bool
    """Whether it is begun however late it is."""


@dataclass(frozen=True)
class _FitOutcome:
    """What became of a job.

    Attributes
    ----------
    name, seed : Which it was.
    outcome : What it has come to.
    files : What has changed of its checkpoint, elsewhere.
    seconds : It took.
    fresh : Whether it trained from the beginning to the end, so that its time tells the pace.
    """

    name: str
    seed: int
    outcome: Backtest | Failure
    files: Files
    seconds: float
    fresh: bool = False


def _file(name: str, seed: int) -> str:
    """What the files of a job's checkpoint begin with."""
    return f"{file_name(name)}-{seed}"


def _work(
    forecasters: Mapping[str, Forecaster],
    questions: Mapping[str, Question],
    stage: str | None,
    place: JobFolder | None,
    remembered: Sequence[Mapping[str, Any]],
    job: _FitJob,
    report: Callable[[RunProgress], None],
) -> _FitOutcome:
    began, name, seed = now(), job.name, job.seed
    # What needs no training is begun however late it is, so that there is a result.
    if job.deadline.over and forecasters[name].random and not job.needed:
        return _FitOutcome(name, seed, Failure(name, seed, LATE, late=True), {}, 0.0)
    for each, results in zip(REMEMBERED, remembered, strict=True):
        each.learn(results)
    watch = None if stage is None else _reporter(name, seed, stage, report)
    forecaster, question = forecasters[name], questions[name]
    with within(job.deadline):
        if place is None or not forecaster.random:
            outcome = _outcome(forecaster, question, seed, watch, None)
            trained, changed = forecaster.random, dict[str, bytes]()
        else:
            with place.at_work(job.files) as (folder, changed):
                checkpoint = Checkpoint(folder / f"{_file(name, seed)}.safetensors")
                trained = not checkpoint.path.exists()
                outcome = _outcome(forecaster, question, seed, watch, checkpoint)
    whole = isinstance(outcome, Backtest) and not outcome.report.cut
    return _FitOutcome(name, seed, outcome, changed, now() - began, trained and whole)


def _outcome(
    forecaster: Forecaster,
    question: Question,
    seed: int,
    watch: Callable[[Progress], None] | None,
    checkpoint: Checkpoint | None,
) -> Backtest | Failure:
    try:
        return backtest(forecaster, question, seed, watch, checkpoint)
    except OverError as error:
        return Failure(forecaster.name, seed, str(error), late=True)
    except OSError:
        raise  # a full disk, or a process ended from outside, concerns every method
    except Exception as error:
        said = " ".join(str(error).split())
        expected = isinstance(error, FloatingPointError | ValueError)
        reason = said if expected else f"{type(error).__name__}: {said}"
        return Failure(forecaster.name, seed, reason)


def file_name(name: str) -> str:
    """A forecaster's name as a part of a file's."""
    return re.sub(r"[^\w.-]", "_", name)


def _reporter(
    name: str, seed: int, stage: str, report: Callable[[RunProgress], None]
) -> Callable[[Progress], None]:
    return lambda at: report(RunProgress(name, seed, at.share, at.loss, stage))
