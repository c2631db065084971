"""Compute what has been planned: a comparison, a forecast, the fit of a single method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitband.data import Record
from splitband.evaluation.budget import SEARCH
from splitband.evaluation.choosing import (
    AFTER_FINAL,
    REFIT,
    choose,
    last_stages,
    last_trainings,
)
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.job import Failure, file_name
from splitband.evaluation.jobs import run_all
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.protocols import (
    inputs_beyond,
    models_of,
    question_of,
    runs_of,
    without_failed,
)
from splitband.evaluation.search import SearchResult, search
from splitband.evaluation.selection import LEVEL, Trial
from splitband.evaluation.work import RunProgress, Work
from splitband.forecasters.backtest import Backtest, Origin, Question
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import handed_out
from splitband.forecasters.prediction import mean_of
from splitband.metrics import leaves_range
from splitband.runtime import deadlines
from splitband.runtime.arguments import whole
from splitband.training import Checkpoint, Progress


def compare(
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    work: Work | None = None,
    **options: Any,
) -> Comparison:
    """Compare forecasters on a record, as `splitband compare` does: `run(plan(record, ...))`.

    Each is fitted to the first `train` samples, and for the recommendation to three quarters of
    them.

    Parameters
    ----------
    record, train, methods : See `plan`.
    work : Processes, progress and checkpoints.
    options : Further arguments of `plan`: others, tests, seeds, setup, horizon.

    Raises
    ------
    ValueError
        For what `plan` finds, before anything is computed; where no method can be fitted.

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
    """Compute what has been planned.

    Parameters
    ----------
    plan : Of `splitband.plan`.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        Where no method can be fitted.
    """
    with _begun(plan, work).staffed() as staff:
        trial, searched = choose(plan, staff)
        methods = [method for method in searched.forecasters if method.name in trial.errors]
        questions = {method.name: question_of(plan, method) for method in methods}
        done, failures = _last_fits(plan, questions, searched, trial, staff)
        runs = runs_of(plan, questions, done, failures)
        if plan.seeds is None:
            runs = without_failed(runs, plan.training)
        comparison = Comparison(
            plan,
            runs,
            attempts=searched.attempts,
            forecasters={m.name: m for m in methods if m.name in runs},
            time=staff.time,
        )
        trial = replace(trial, left_out=frozenset(comparison.left_out))
        trial = trial.settled(runs.ahead, staff.time.left_out | runs.failed)
        comparison = replace(comparison, trial=trial)
        if plan.refit:
            model = _refitted(plan, comparison.trained(), trial, staff)
            comparison = replace(comparison, refit=model)
    return comparison


def forecast(
    record: Record,
    steps: int,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    work: Work | None = None,
    **options: Any,
) -> Forecast:
    """What comes after the end of a record, by the method that its own last quarter recommends.

    Parameters
    ----------
    record : All of it is trained on. Its known inputs, and its simulator's output, must reach
        `steps` samples beyond it (`u_beyond`, `beyond`).
    steps : How many samples.
    methods, work : See `compare`.
    options : Further arguments of `plan`: others, seeds, setup.

    Raises
    ------
    ValueError
        As `compare`, and where inputs or simulator do not reach so far.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> found = sb.forecast(record, 50, [sb.Mean(), sb.Harmonic()])
    >>> found.method, found.prediction.y.shape, found.prediction.lower.shape
    ('harmonic', (50, 1), (50, 1))
    """
    whole("steps", steps)
    return run_forecast(plan(record, len(record), methods, horizon=steps, **options), work)


def run_forecast(plan: Plan, work: Work | None = None) -> Forecast:
    """Forecast what lies beyond the record of a plan, all of which is trained on."""
    record, steps = plan.record, plan.horizon
    origin = Origin(plan.train, plan.train)
    question = Question(record, [origin], plan.train + steps, plan.others, keep=True)
    with _begun(plan, work).staffed() as staff:
        trial, searched = choose(plan, staff)
        # Training is slow: of the networks, only the best one is trained on all of the record.
        fitted = [m for m in searched.forecasters if m.name in trial.errors]
        fitted = [m for m in fitted if not m.random or m.name == trial.best_network]
        questions = {method.name: question for method in fitted}
        backtests, failures = _last_fits(plan, questions, searched, trial, staff)
    forecasts = {
        name: [backtest.predictions[origin] for backtest in of_method.values()]
        for name, of_method in backtests.items()
        if of_method
    }
    failed = {f.method: f.reason for f in failures[::-1] if f.method not in forecasts}
    final = {name: [each.y for each in of_seeds] for name, of_seeds in forecasts.items()}
    trial = trial.settled(final, staff.time.left_out | failed)
    best = trial.recommended
    mean, done = mean_of(forecasts[best]), [*backtests[best].values()]
    half = trial.intervals[best].half_widths(steps)
    left = [leaves_range(each.y_range, each.predictions[origin].y) for each in done]
    u = record.u_beyond
    return Forecast(
        plan,
        handed_out(models_of(plan, backtests)[best], trial.held_out.get(best)),
        replace(mean, lower=mean.y - half, upper=mean.y + half, level=LEVEL),
        trial,
        done[0].description,
        min((samples for samples in left if samples is not None), default=None),
        inputs_beyond([record, *plan.others], None if u is None else u[:steps]),
        staff.time,
    )


def fit(plan: Plan, seed: int = 0, work: Work | None = None) -> Forecaster:
    """Fit the only method of a plan to its training part, and return it.

    Parameters
    ----------
    plan : With one method.
    seed : Of initial weights and order of windows.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        For several methods, and what `Forecaster.fit` raises.
    """
    if len(plan.methods) != 1:
        raise ValueError(f"methods must be one to be fitted, got {', '.join(plan.names)}")
    (forecaster,) = plan.methods
    work = _begun(plan, work)
    if plan.setup.search is not None:
        with work.staffed() as staff:
            stage = replace(staff, deadline=work.time.share(SEARCH), span=(0.0, SEARCH))
            found = search(plan.training, [forecaster], 0, plan.setup.search, stage, plan.others)
        forecaster = found.forecasters[0]

    def update(at: Progress) -> None:
        if work.progress is not None:
            label, overall = f"{forecaster.name}, {at.task}", SEARCH + at.share * (1 - SEARCH)
            work.progress(RunProgress(label, seed, at.share, at.loss, overall=overall))

    checkpoint = None
    if work.checkpoints is not None:
        folder = Path(work.checkpoints)
        folder.mkdir(parents=True, exist_ok=True)
        checkpoint = Checkpoint(folder / f"{file_name(forecaster.name)}-{seed}.safetensors")
    with deadlines.within(work.time.deadline):
        return forecaster.fit(
            plan.training, *plan.others, seed=seed, progress=update, checkpoint=checkpoint
        )


def _begun(plan: Plan, work: Work | None) -> Work:
    """Return the work with a time budget: the caller's, or from now on what the search allows."""
    work, asked = work or Work(), plan.setup.search
    return work if asked is None else work.limited(asked.seconds, asked.core_seconds)


def _last_fits(
    plan: Plan,
    questions: Mapping[str, Question],
    searched: SearchResult,
    trial: Trial,
    work: Work,
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """Fit the methods that are asked to the whole training part: networks last, the best first."""
    methods = {f.name: f for f in searched.forecasters if f.name in questions}
    quick = [f for f in methods.values() if not f.random]
    networks = [f for f in methods.values() if f.random]
    of_quick, of_slow = last_stages(plan, work, [*questions.values()])
    with work.time.phase("final trainings"):
        done, failures = run_all(quick, questions, (0,), of_quick, need_one=not networks)
        wanted = last_trainings(plan, networks, searched, trial, of_slow)
        if wanted:
            trained = [methods[name] for name in wanted]
            need_one = not any(done.values())
            slow, more = run_all(trained, questions, wanted, of_slow, need_one)
            done, failures = done | slow, failures + more
    return {name: done[name] for name in methods if name in done}, failures


def _refitted(plan: Plan, model: Forecaster, trial: Trial, work: Work) -> Forecaster:
    """Return a method that was handed out, fitted to the whole record as it was to its part."""
    samples = len(plan.record)
    method, origin = model.of_one_seed.clone(), Origin(samples, samples - 1)
    question = Question(plan.record, [origin], samples, plan.others, keep=True)
    stage = work.for_stage(REFIT, work.time.deadline, (AFTER_FINAL, 1.0))
    with work.time.phase("refit"):
        found, _ = run_all([method], {method.name: question}, model.seeds, stage)
    return handed_out(models_of(plan, found)[method.name], trial.held_out.get(model.name))
