"""Fit one forecaster with one seed and ask it, wherever jobs are carried out."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from splitband.evaluation.work import RunProgress
from splitband.forecasters.backtest import Backtest, Question, backtest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.grey_box import ESTIMATES
from splitband.forecasters.remembering import Remembered
from splitband.forecasters.simulation import CALIBRATIONS
from splitband.runtime.deadlines import Deadline, OverError, now, within
from splitband.runtime.job_folders import Files, JobFolder
from splitband.training import Checkpoint, Progress

REMEMBERED: tuple[Remembered[Any], ...] = (CALIBRATIONS, ESTIMATES)
"""What jobs are told of that has been computed before."""
LATE = "left out, as the time was over"


@dataclass(frozen=True)
class Failure:
    """One forecaster that could not be fitted with one seed, and why."""

    method: str
    seed: int
    reason: str
    late: bool = False
    """Whether it is for want of time."""


@dataclass(frozen=True)
class FitJob:
    """A forecaster with a seed, and what there is of its training already."""

    name: str
    seed: int
    files: Files
    deadline: Deadline
    needed: bool
    """Whether it is begun however late it is."""
    stage: str | None = None
    """What its progress is reported as; None where nobody is told of it."""


@dataclass(frozen=True)
class FitOutcome:
    """What became of a job.

    Attributes
    ----------
    name, seed : Which it was.
    backtest : What was forecast, or
    failure : Why it could not be fitted.
    files : What has changed of its checkpoint, elsewhere.
    seconds : It took.
    fresh : Whether it trained from the beginning to the end, so that its time tells the pace.
    """

    name: str
    seed: int
    backtest: Backtest | None = None
    failure: Failure | None = None
    files: Files = field(default_factory=dict)
    seconds: float = 0.0
    fresh: bool = False

    @property
    def cut(self) -> bool:
        """Whether the deadline has changed it."""
        late = self.failure is not None and self.failure.late
        return late or (self.backtest is not None and self.backtest.report.cut)


def checkpoint_name(name: str, seed: int) -> str:
    """What the files of a job's checkpoint begin with."""
    return f"{file_name(name)}-{seed}"


def remembered() -> list[dict[Any, Any]]:
    """Return what has been computed before, of each kind, for `carry_out` in another process."""
    return [dict(each.results) for each in REMEMBERED]


def carry_out(
    forecasters: Mapping[str, Forecaster],
    questions: Mapping[str, Question],
    place: JobFolder | None,
    known: Sequence[Mapping[str, Any]],
    job: FitJob,
    report: Callable[[RunProgress], None],
) -> FitOutcome:
    """Carry out a job, in whatever process it is."""
    began, name, seed = now(), job.name, job.seed
    # What needs no training is begun however late it is, so that there is a result.
    if job.deadline.over and forecasters[name].random and not job.needed:
        return failed(name, seed, LATE, late=True)
    for each, results in zip(REMEMBERED, known, strict=True):
        each.learn(results)
    watch = None if job.stage is None else _reporter(name, seed, job.stage, report)
    forecaster, question = forecasters[name], questions[name]
    with within(job.deadline):
        if place is None or not forecaster.random:
            outcome = _forecasts(forecaster, question, seed, watch, None)
            trained, changed = forecaster.random, dict[str, bytes]()
        else:
            with place.at_work(job.files) as (folder, changed):
                checkpoint = Checkpoint(folder / f"{checkpoint_name(name, seed)}.safetensors")
                trained = not checkpoint.path.exists()
                outcome = _forecasts(forecaster, question, seed, watch, checkpoint)
    fresh = trained and outcome.failure is None and not outcome.cut
    return replace(outcome, files=changed, seconds=now() - began, fresh=fresh)


def _forecasts(
    forecaster: Forecaster,
    question: Question,
    seed: int,
    watch: Callable[[Progress], None] | None,
    checkpoint: Checkpoint | None,
) -> FitOutcome:
    name = forecaster.name
    try:
        return FitOutcome(name, seed, backtest(forecaster, question, seed, watch, checkpoint))
    except OverError as error:
        return failed(name, seed, str(error), late=True)
    except OSError:
        raise  # a full disk, or a process ended from outside, concerns every method
    except (FloatingPointError, ValueError) as error:
        return failed(name, seed, " ".join(str(error).split()))
    except Exception as error:
        said = " ".join(str(error).split())
        return failed(name, seed, f"{type(error).__name__}: {said}")


def failed(name: str, seed: int, reason: str, late: bool = False) -> FitOutcome:
    """Return the outcome of a job that could not be carried out."""
    return FitOutcome(name, seed, failure=Failure(name, seed, reason, late))


def file_name(name: str) -> str:
    """A forecaster's name as a part of a file's."""
    return re.sub(r"[^\w.-]", "_", name)


def _reporter(
    name: str, seed: int, stage: str, report: Callable[[RunProgress], None]
) -> Callable[[Progress], None]:
    return lambda at: report(RunProgress(name, seed, at.share, at.loss, stage))
