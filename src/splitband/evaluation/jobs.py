"""Forecasters on a record, each with each seed: a job each, wherever jobs are carried out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from splitband.evaluation.costs import job_cost
from splitband.evaluation.job import (
    LATE,
    Failure,
    FitJob,
    FitOutcome,
    carry_out,
    checkpoint_name,
    failed,
    remembered,
)
from splitband.evaluation.work import HALF, RunProgress, Work
from splitband.forecasters.backtest import Backtest, Question
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.runtime.deadlines import Deadline, OverError, within
from splitband.runtime.job_folders import JobFolder
from splitband.runtime.processes import Processes, over

FAILED = 2.0
"""A seed whose error is above this multiple of the lowest seed's has failed."""
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
    done: dict[tuple[str, int], FitOutcome] = {}
    for f in forecasters:
        try:
            ready[f.name] = _prepared(f, questions[f.name], work)
        except ValueError as error:
            done |= {(f.name, s): failed(f.name, s, str(error)) for s in seeds_of[f.name]}
    costs = {name: job_cost(f, questions[name]) for name, f in ready.items()}
    with _place(work) as place:
        # Of each method one seed first. Networks take longest: no process is left with one of them
        # at the end.
        ordered = sorted(
            [(f, i, seed) for f in ready.values() for i, seed in enumerate(seeds_of[f.name])],
            key=lambda each: (not each[0].random, each[1]),
        )
        todo = [
            FitJob(
                f.name,
                seed,
                place.files(checkpoint_name(f.name, seed)) if place and f.random else {},
                work.deadline,
                need_one and at == 0,
                stage,
            )
            for at, (f, _, seed) in enumerate(ordered)
        ]
        job = partial(carry_out, ready, questions, place, remembered())
        workers = work.executor or work.jobs
        watch = _Watch(work, {(each.name, each.seed): costs[each.name] for each in todo})
        # What needs no training looks at the deadline by itself, and is what there is in any case.
        trains = any(f.random for f in ready.values())
        late = Deadline(work.deadline.at + PATIENCE + work.time.pace.asking)
        patience = late if trains else Deadline()
        for each in over(job, todo, workers, watch.report, patience):
            done[each.name, each.seed] = each
            if each.fresh and each.backtest is not None:
                asking = each.seconds - each.backtest.report.seconds
                work.time.pace.measured(costs[each.name], each.seconds, asking)
            watch.finished((each.name, each.seed))
            if place is not None:
                place.keep(each.files)
    for left in todo:
        late_one = failed(left.name, left.seed, LATE, late=True)
        done.setdefault((left.name, left.seed), late_one)
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
    seeds_of: Mapping[str, Sequence[int]], done: Mapping[tuple[str, int], FitOutcome]
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """Results and failures, in the order of forecasters and seeds."""
    results: dict[str, dict[int, Backtest]] = {name: {} for name in seeds_of}
    failures = []
    for name, seeds in seeds_of.items():
        for seed in seeds:
            outcome = done[name, seed]
            if outcome.backtest is not None:
                results[name][seed] = outcome.backtest
            if outcome.failure is not None:
                failures.append(outcome.failure)
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


def _note(work: Work, done: Mapping[tuple[str, int], FitOutcome]) -> None:
    """Write down what the deadline has changed."""
    for (name, seed), outcome in done.items():
        if outcome.cut:
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

    def finished(self, key: tuple[str, int]) -> None:
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


def failed_seeds(
    reports: Mapping[int, FitReport], errors: Mapping[int, float] | None = None
) -> dict[int, str]:
    """Return the seeds of a method that failed in training, and why; never all of them.

    Parameters
    ----------
    reports : Of their fits, by seed.
    errors : Of their simulations of the training record; by default their last training losses,
        which can be compared where all are trained alike.
    """
    stable = [seed for seed, report in reports.items() if report.stable]
    failed = dict.fromkeys(reports.keys() - stable, "it is unstable, and may grow without bound")
    if not stable:
        failed, stable = {}, [*reports]
    if errors is None:
        errors = {seed: training_loss(report) for seed, report in reports.items()}
    least = min((errors[seed] for seed in stable), default=0.0)
    for seed in stable:
        if least and errors[seed] > FAILED * least:
            failed[seed] = f"training error {errors[seed] / least:.3g} times the lowest"
    return failed if len(failed) < len(reports) else {}


def training_loss(report: FitReport) -> float:
    """Return the last training loss of all networks of a forecaster together; 0 without any."""
    return sum(losses[-1] ** 2 for losses in report.losses.values() if len(losses)) ** 0.5
