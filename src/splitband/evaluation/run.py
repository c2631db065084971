"""Run a plan: a comparison, or the fit of a single method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitband.data import Record
from splitband.evaluation.budget import SEARCH_SHARE
from splitband.evaluation.choosing import AFTER_TRIAL, choose
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.jobs import Failure, checkpoint_path, run_all
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.protocols import (
    models_of,
    question_of,
    runs_of,
    without_failed,
)
from splitband.evaluation.recommendation import Trial
from splitband.evaluation.search import SEEDS, SearchResult, search
from splitband.evaluation.work import RunProgress, Work
from splitband.forecasters.backtest import Backtest, Origin, Question, first_held_out
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import fitted_ensemble
from splitband.runtime import deadlines
from splitband.training import Checkpoint, Progress

FINAL, REFIT = "final fit", "refit"
"""Names of the stages that fit methods to the training part, and one method to the whole record."""
BEFORE_REFIT = 0.6
"""Share of the remaining time that the final fits may take if a refit follows."""
AFTER_FINAL = 0.95
"""Share of a command that is done after the final fits, for progress bars."""


def compare(
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    work: Work | None = None,
    **options: Any,
) -> Comparison:
    """Compare forecasters on a record, as `splitband compare` does: `run(plan(record, ...))`.

    Each one is fitted to the first `train` samples and, for the recommendation, to three quarters
    of them.

    Parameters
    ----------
    record, train, methods : See `plan`.
    work : Processes, progress and checkpoints.
    options : Further arguments of `plan`: others, tests, seeds, setup, horizon.

    Raises
    ------
    ValueError
        As `plan`, before anything is computed; and if no method can be fitted.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> result = sb.compare(record, 300, [sb.Mean(), sb.Persistence(), sb.Harmonic()])
    >>> result.recommended
    'harmonic'
    >>> list(result.table["forecast fit %"].round(1))
    [100.0, -0.3, -77.9]
    """
    return run(plan(record, train, methods, **options), work)


def run(plan: Plan, work: Work | None = None) -> Comparison:
    """Run a planned comparison.

    Parameters
    ----------
    plan : From `splitband.plan`.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        If no method can be fitted; and for a plan that predicts beyond its record, where nothing
        was measured to compare with.
    """
    if plan.horizon and plan.train == len(plan.record):
        raise ValueError(
            f"horizon must be left out where train is the whole record of {plan.train} samples, as "
            f"nothing was measured after it to compare with, got {plan.horizon}: "
            "splitband.forecast predicts beyond a record"
        )
    with with_limits(plan, work).staffed() as staff:
        trial, searched = choose(plan, staff)
        methods = [method for method in searched.forecasters if method.name in trial.errors]
        questions = {method.name: question_of(plan, method) for method in methods}
        done, failures = final_fits(plan, questions, searched, trial, staff)
        done, notes = (done, {}) if plan.seeds else without_failed(plan.training, done)
        runs = runs_of(plan, questions, done, failures, notes)
        forecasters = {m.name: m for m in methods if m.name in runs}
        found = Comparison(plan, runs, None, searched.attempts, forecasters, staff.time)
        trial = replace(trial, left_out=frozenset(found.left_out))
        trial = trial.settled(runs.ahead, staff.time.left_out | runs.failed)
        found = replace(found, trial=trial)
        if plan.refit:
            found = replace(found, refit=_refitted(plan, found.trained(), trial, staff))
    return found


def fit(plan: Plan, seed: int = 0, work: Work | None = None) -> Forecaster:
    """Fit the only method of a plan to its training part, and return it.

    Parameters
    ----------
    plan : With one method.
    seed : Fixes initial weights and the order of windows.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        For several methods, and as `Forecaster.fit`.
    """
    if len(plan.methods) != 1:
        raise ValueError(f"methods must be one to be fitted, got {', '.join(plan.names)}")
    (forecaster,) = plan.methods
    work = with_limits(plan, work)
    if plan.setup.search is not None:
        with work.staffed() as staff:
            stage = replace(staff, deadline=work.time.share(SEARCH_SHARE), span=(0.0, SEARCH_SHARE))
            found = search(plan.training, [forecaster], 0, plan.setup.search, stage, plan.others)
        forecaster = found.forecasters[0]

    def update(at: Progress) -> None:
        if work.progress is not None:
            label = f"{forecaster.name}, {at.task}"
            overall = SEARCH_SHARE + at.share * (1 - SEARCH_SHARE)
            work.progress(RunProgress(label, seed, at.share, at.loss, overall=overall))

    checkpoint = None
    if work.checkpoints is not None:
        folder = Path(work.checkpoints)
        folder.mkdir(parents=True, exist_ok=True)
        checkpoint = Checkpoint(checkpoint_path(folder, forecaster.name, seed))
    with deadlines.within(work.time.deadline):
        return forecaster.fit(
            plan.training, *plan.others, seed=seed, progress=update, checkpoint=checkpoint
        )


def with_limits(plan: Plan, work: Work | None) -> Work:
    """Return the work with a time budget: the caller's, if limited, else that of the search."""
    work, limits = work or Work(), plan.setup.search
    return work if limits is None else work.limited(limits.seconds, limits.core_seconds)


def final_fits(
    plan: Plan,
    questions: Mapping[str, Question],
    searched: SearchResult,
    trial: Trial,
    work: Work,
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """Fit the methods to the whole training part: baselines first, then networks, best first."""
    methods = {f.name: f for f in searched.forecasters if f.name in questions}
    quick = [f for f in methods.values() if not f.random]
    networks = [f.name for f in methods.values() if f.random]
    time = work.time
    until = time.share(BEFORE_REFIT) if plan.refit else time.deadline
    until = until.earlier(_forecast_seconds(plan, work, [*questions.values()]))
    of_quick = work if time.allows_processes(time.deadline) else work.alone()
    of_quick = of_quick.for_stage(FINAL, time.deadline, (AFTER_TRIAL, AFTER_TRIAL))
    of_networks = work.for_stage(FINAL, until, (AFTER_TRIAL, AFTER_FINAL))
    with time.phase("final trainings"):
        done, failures = run_all(quick, questions, (0,), of_quick, need_one=not networks)
        scores = {name: trial.scores[name] for name in networks}
        needed = not set(trial.scores) - set(scores)
        wanted = _final_trainings(plan, scores, searched, of_networks, needed)
        if wanted:
            trained, need_one = [methods[name] for name in wanted], not any(done.values())
            slow, more = run_all(trained, questions, wanted, of_networks, need_one)
            done, failures = done | slow, failures + more
    return {name: done[name] for name in methods if name in done}, failures


def _forecast_seconds(plan: Plan, work: Work, questions: Sequence[Question]) -> float:
    """Estimate how many seconds the final forecasts take.

    The time is scaled from a trial, whose three forecasts together have twice the length of the
    held-out part (1 + 2/3 + 1/3), plus three horizons.
    """
    held_out = plan.train - first_held_out(plan.train)
    samples = max(
        sum(q.end - origin.at for origin in q.origins) + sum(map(len, q.tests)) for q in questions
    )
    return work.time.pace.forecasting * samples / (2 * held_out + 3 * plan.horizon)


def _final_trainings(
    plan: Plan, scores: Mapping[str, float], searched: SearchResult, work: Work, needed: bool
) -> dict[str, range]:
    """Return the seeds of the networks to train on the whole training part, best network first.

    If time is short, the worst networks are left out and reported, but not the best one if it is
    `needed`, as there is no other method.
    """
    time, left = work.time, work.time.work_until(work.deadline)
    wanted = dict.fromkeys(scores, range(SEEDS if plan.seeds is None else plan.seeds))
    if plan.seeds is None:
        unlimited = wanted | searched.seeds(scores)
        wanted |= searched.seeds(scores, left if time.limited else None)
        if wanted != unlimited:
            time.narrowed("the number of seeds")
    kept: dict[str, range] = {}
    for name in sorted(scores, key=lambda name: scores[name]):
        cost = searched.costs.get(name, 0.0)
        late = kept and cost > min(left, time.work_of_one(work.deadline))
        if late or (work.deadline.over and (kept or not needed)):
            time.leave_out(name, "final training", cost * time.pace.seconds, work.deadline)
            continue
        kept[name] = wanted[name]
        left -= cost
    return kept


def _refitted(plan: Plan, model: Forecaster, trial: Trial, work: Work) -> Forecaster:
    """Return a trained method, refitted to the whole record with the same settings and seeds."""
    samples = len(plan.record)
    # One sample, the last one, is forecast, as `backtest` needs an origin.
    method, origin = model.of_one_seed.clone(), Origin(samples, samples - 1)
    question = Question(plan.record, [origin], samples, plan.others, keep=True)
    stage = work.for_stage(REFIT, work.time.deadline, (AFTER_FINAL, 1.0))
    with work.time.phase("refit"):
        found, _ = run_all([method], {method.name: question}, model.seeds, stage)
    return fitted_ensemble(models_of(plan, found)[method.name], trial.held_out.get(model.name))
