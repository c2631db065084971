"""Forecasters on a record, each with each seed: a job each, wherever jobs are carried out."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from splitband.forecasters.backtest import Backtest, Question, backtest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.simulation import CALIBRATIONS
from splitband.runtime.places import Files, Place
from splitband.runtime.processes import over
from splitband.simulators.calibration import Calibration
from splitband.training import Checkpoint, Progress


@dataclass(frozen=True)
class RunProgress:
    """An epoch of one run is over; `share` of the run's training is done.

    `stage` is "search" and a number where ways to train are tried, "three quarters" where methods
    are, "on a baseline" where a network is put on one of them, "trials" in `tune`, and "whole"
    where a method is fitted to the whole training part after all.
    """

    method: str
    seed: int
    share: float
    loss: float
    stage: str = "whole"


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
    """

    jobs: int = 1
    progress: Callable[[RunProgress], None] | None = None
    checkpoints: str | Path | None = None
    stage: str = "whole"
    executor: Executor | None = None

    def for_stage(self, stage: str) -> Work:
        """For one of several parts of the work, with a folder of its own for checkpoints."""
        below = None if self.checkpoints is None else Path(self.checkpoints) / stage
        return replace(self, checkpoints=below, stage=stage)


@dataclass(frozen=True)
class Failure:
    """One forecaster that could not be fitted with one seed, and why."""

    method: str
    seed: int
    reason: str


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
            ready[f.name] = _prepared(f, questions[f.name])
        except ValueError as error:
            done |= {(f.name, s): Failure(f.name, s, str(error)) for s in seeds_of[f.name]}
    with _place(work) as place:
        # The longest first, so that no process is left with one of them at the end.
        todo = [
            _Job(f.name, seed, place.files(_file(f.name, seed)) if place and f.random else {})
            for f in sorted(forecasters, key=lambda f: not f.random)
            for seed in seeds_of[f.name]
            if f.name in ready
        ]
        job = partial(_work, ready, questions, stage, place, dict(CALIBRATIONS.results))
        workers = work.executor or work.jobs
        for name, seed, outcome, files in over(job, todo, workers, work.progress):
            done[name, seed] = outcome
            if place is not None:
                place.keep(files)
    results, failures = _sorted_out(seeds_of, done)
    if need_one and not any(results.values()):
        reasons = dict.fromkeys(f"{f.method}: {f.reason}" for f in failures)
        raise ValueError(f"no method could be fitted; {'; '.join(reasons)}")
    return results, failures


def _place(work: Work) -> AbstractContextManager[Place | None]:
    """Where checkpoints are, while jobs are carried out."""
    if work.checkpoints is None:
        return nullcontext()
    return Place.opened(Path(work.checkpoints), anywhere=work.executor is not None)


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


def _prepared(forecaster: Forecaster, asked: Question) -> Forecaster:
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
    with suppress(ValueError):
        for samples in fits:
            forecaster.prepare(asked.record[:samples])
    return forecaster


@dataclass(frozen=True)
class _Job:
    """A forecaster with a seed, and what there is of its training already."""

    name: str
    seed: int
    files: Files


def _file(name: str, seed: int) -> str:
    """What the files of a job's checkpoint begin with."""
    return f"{file_name(name)}-{seed}"


def _work(
    forecasters: Mapping[str, Forecaster],
    questions: Mapping[str, Question],
    stage: str | None,
    place: Place | None,
    calibrations: Mapping[str, Calibration],
    job: _Job,
    report: Callable[[RunProgress], None],
) -> tuple[str, int, Backtest | Failure, Files]:
    name, seed = job.name, job.seed
    CALIBRATIONS.learn(calibrations)
    watch = None if stage is None else _reporter(name, seed, stage, report)
    forecaster, question = forecasters[name], questions[name]
    if place is None or not forecaster.random:
        return name, seed, _outcome(forecaster, question, seed, watch, None), {}
    with place.at_work(job.files) as (folder, changed):
        checkpoint = Checkpoint(folder / f"{_file(name, seed)}.safetensors")
        outcome = _outcome(forecaster, question, seed, watch, checkpoint)
    return name, seed, outcome, changed


def _outcome(
    forecaster: Forecaster,
    question: Question,
    seed: int,
    watch: Callable[[Progress], None] | None,
    checkpoint: Checkpoint | None,
) -> Backtest | Failure:
    try:
        return backtest(forecaster, question, seed, watch, checkpoint)
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
