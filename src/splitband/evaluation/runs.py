"""Forecasters on a record, each with each seed: one job after the other, in processes."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from splitband.forecasters.backtest import Backtest, Question, backtest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.simulation import CALIBRATIONS
from splitband.runtime.processes import over
from splitband.simulators.calibration import Calibration
from splitband.training import Checkpoint, Progress


@dataclass(frozen=True)
class RunProgress:
    """An epoch of one run is over; `share` of the run's training is done.

    `stage` is "three quarters" where a method is tried out, "whole" where it is fitted after all.
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
    progress : Called in this process after each epoch of each run.
    checkpoints : Folder, created if need be, from which trainings that were cut off go on.
    stage : What the progress is reported as.
    """

    jobs: int = 1
    progress: Callable[[RunProgress], None] | None = None
    checkpoints: Path | None = None
    stage: str = "whole"

    def for_stage(self, stage: str) -> Work:
        """For one of several parts of the work, with a folder of its own for checkpoints."""
        below = None if self.checkpoints is None else self.checkpoints / stage
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
    is not random is fitted once, and to the first record alone. With `need_one`, ValueError is
    raised when nothing could be fitted at all.
    """
    if work.checkpoints is not None:
        work.checkpoints.mkdir(parents=True, exist_ok=True)
    ready = {f.name: _prepared(f, questions[f.name]) for f in forecasters}
    seeds_of = {f.name: _seeds_of(f, seeds) for f in forecasters}
    todo = [(f.name, seed) for f in forecasters for seed in seeds_of[f.name]]
    # The longest first, so that no process is left with one of them at the end.
    todo.sort(key=lambda job: not ready[job[0]].random)
    stage = None if work.progress is None else work.stage
    job = partial(_work, ready, questions, stage, work.checkpoints, dict(CALIBRATIONS.results))
    done = {
        (name, seed): outcome for name, seed, outcome in over(job, todo, work.jobs, work.progress)
    }
    results: dict[str, dict[int, Backtest]] = {f.name: {} for f in forecasters}
    failures = []
    for f in forecasters:
        for seed in seeds_of[f.name]:
            outcome = done[f.name, seed]
            if isinstance(outcome, Failure):
                failures.append(outcome)
            else:
                results[f.name][seed] = outcome
    if need_one and not any(results.values()):
        reasons = dict.fromkeys(f"{f.method}: {f.reason}" for f in failures)
        raise ValueError(f"no method could be fitted; {'; '.join(reasons)}")
    return results, failures


def _seeds_of(
    forecaster: Forecaster, seeds: Sequence[int] | Mapping[str, Sequence[int]]
) -> Sequence[int]:
    """The seeds of one forecaster: a single one where it is not random."""
    if isinstance(seeds, Mapping):
        seeds = seeds.get(forecaster.name, (0,))
    return seeds if forecaster.random else seeds[:1]


def _prepared(forecaster: Forecaster, asked: Question) -> Forecaster:
    """With what all of its jobs share computed here, once for all processes."""
    fits = sorted({origin.fitted for origin in asked.origins})
    # Errors are not lost: the job that needs the result computes it again and reports the failure.
    with suppress(ValueError):
        forecaster = forecaster.settled(asked.record[: fits[-1]], asked.end - fits[-1])
        for samples in fits:
            forecaster.prepare(asked.record[:samples], asked.end - samples)
    return forecaster


def _work(
    forecasters: Mapping[str, Forecaster],
    questions: Mapping[str, Question],
    stage: str | None,
    checkpoints: Path | None,
    calibrations: Mapping[str, Calibration],
    job: tuple[str, int],
    report: Callable[[RunProgress], None],
) -> tuple[str, int, Backtest | Failure]:
    name, seed = job
    CALIBRATIONS.learn(calibrations)
    watch = None if stage is None else _reporter(name, seed, stage, report)
    checkpoint = None
    if checkpoints is not None and forecasters[name].random:
        checkpoint = Checkpoint(checkpoints / f"{file_name(name)}-{seed}.safetensors")
    question = questions[name]
    if not forecasters[name].random:
        question = replace(question, others=())
    try:
        outcome = backtest(forecasters[name], question, seed, watch, checkpoint)
    except OSError:
        raise  # a full disk, or a process ended from outside, concerns every method
    except Exception as error:
        said = " ".join(str(error).split())
        expected = isinstance(error, FloatingPointError | ValueError)
        reason = said if expected else f"{type(error).__name__}: {said}"
        return name, seed, Failure(name, seed, reason)
    return name, seed, outcome


def file_name(name: str) -> str:
    """A forecaster's name as a part of a file's."""
    return re.sub(r"[^\w.-]", "_", name)


def _reporter(
    name: str, seed: int, stage: str, report: Callable[[RunProgress], None]
) -> Callable[[Progress], None]:
    return lambda at: report(RunProgress(name, seed, at.share, at.loss, stage))
