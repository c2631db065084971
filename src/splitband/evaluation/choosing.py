"""What `compare` and `forecast` have in common: what is tried, how it is trained, with which seeds.

No measured sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.data import Record
from splitband.evaluation.bases import on_baseline
from splitband.evaluation.budget import BASE, BASELINES, SEARCH, TimeBudget
from splitband.evaluation.budget import TRIAL as TRIAL_OVER
from splitband.evaluation.costs import job_cost
from splitband.evaluation.plan import Plan
from splitband.evaluation.protocols import Run, Runs, models_of
from splitband.evaluation.runs import Work, run_all
from splitband.evaluation.search import Search, SearchResult, search
from splitband.evaluation.selection import MOST_TRIAL_SEEDS, Trial, try_out
from splitband.evaluation.sound import failed_seeds
from splitband.forecasters.backtest import Origin, Question, held_out_from
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import Ensemble
from splitband.metrics import rmse, spread

TRIAL, FINAL = "held-out fit", "final fit"
"""The stages of the work: on how much of the training part the methods are fitted."""
REFIT = "refit"
"""The stage in which the recommended method is fitted to the whole record."""
BEFORE_REFIT = 0.6
"""Share of the time that is left for final fits which these may take, where a refit follows."""
AFTER_BASELINES, AFTER_SEARCH, AFTER_TRIAL, AFTER_FINAL = 0.1, 0.6, 0.7, 0.95
"""Shares of a command that are done after these stages, for progress bars."""
SEEDS = 3
"""Trainings of each network, where nothing else decides how many."""


def timed(work: Work, search: Search | None) -> Work:
    """The work with a time budget: the caller's, or from now on what the search allows."""
    time = work.time
    if not time.limited and search is not None:
        time = TimeBudget.of(search.seconds, work.cores, time.began)
    if search is not None:
        time.asked = search.seconds, search.core_seconds
    return replace(work, time=time, deadline=time.deadline)


def last_stages(plan: Plan, work: Work, asked: int) -> tuple[Work, Work]:
    """The work on the whole training part: of what needs no training, and of networks.

    Parameters
    ----------
    plan : A trial of it has forecast three parts of what is held out and what lies ahead.
    work : Of the whole command.
    asked : Samples that each method forecasts in the end.
    """
    held_out = plan.train - held_out_from(plan.train)
    asking = work.time.pace.asking * asked / (2 * held_out + 3 * plan.horizon)
    time, first = work.time, (AFTER_TRIAL, AFTER_TRIAL)
    until = time.share(BEFORE_REFIT) if plan.refit else time.deadline
    quick = work if time.allows_processes(time.deadline) else work.alone()
    return (
        quick.for_stage(FINAL, time.deadline, first),
        work.for_stage(FINAL, until.earlier(asking), (AFTER_TRIAL, AFTER_FINAL)),
    )


def choose(plan: Plan, work: Work) -> tuple[Trial, SearchResult]:
    """How networks are to be trained, and what all methods do on held-out samples.

    No measured sample after the training part is looked at.
    """
    record, others, ahead, setup = plan.training, plan.others, plan.horizon, plan.setup
    quick = [f for f in plan.methods if not f.random]
    slow = [f for f in plan.methods if f.random]
    time, tried = work.time, range(SEEDS if plan.seeds is None else plan.seeds)[:MOST_TRIAL_SEEDS]
    trial = None
    if quick:
        until = time.share(BASELINES)
        stage = work.for_stage(TRIAL, until, (0.0, AFTER_BASELINES))
        stage = stage if time.allows_processes(until) else stage.alone()
        with time.phase("baselines", until):
            trial = try_out(record, quick, ahead, tried, stage, others, need_one=not slow)
    searched = SearchResult([*plan.methods])
    searching, trying, basing = time.share(SEARCH), time.share(TRIAL_OVER), time.share(BASE)
    if setup.search is not None:
        stage = replace(work, deadline=searching, span=(AFTER_BASELINES, AFTER_SEARCH))
        with time.phase("search", searching):
            searched = search(record, plan.methods, ahead, setup.search, stage, others)
    if not slow:
        assert trial is not None
        return trial, searched
    stage = work.for_stage(TRIAL, trying, (AFTER_SEARCH, AFTER_TRIAL))
    with time.phase("trial", trying):
        needed = trial is None or not trial.errors
        networks = _in_time(plan, searched, len(tried), stage, needed)
        done = searched.done
        found = try_out(record, networks, ahead, tried, stage, others, done, need_one=needed)
    trial = found if trial is None else trial.joined(found)
    late = {name: reason for name, reason in time.left_out.items() if name not in trial.errors}
    trial = replace(trial, failed={**trial.failed, **late})
    if time.deadline.over:
        return trial, searched
    if plan.tests or others:  # what goes on in the time of one record is no base for several
        anchored = frozenset(f.name for f in searched.forecasters if f.anchored)
        trial = replace(trial, left_out=anchored)
    stage = replace(work, deadline=basing, span=(AFTER_TRIAL, AFTER_TRIAL))
    with time.phase("on a baseline", basing):
        trial, searched = on_baseline(plan, trial, searched, tried, stage)
    return replace(trial, left_out=frozenset()), searched


def _in_time(
    plan: Plan, searched: SearchResult, seeds: int, work: Work, needed: bool
) -> list[Forecaster]:
    """The networks that there is time to try; the others are left out by name.

    Where nothing else has come to a result, the first one is `needed` however late it is: it ends
    with what it has.
    """
    time, kept = work.time, list[Forecaster]()
    left = time.reckoned(work.deadline)
    for f in searched.forecasters:
        if not f.random or searched.done.get(f.name):
            kept += [f] if f.random else []
            continue
        cost = 0.0
        if time.limited:
            origin = Origin(held_out_from(plan.train), plan.train)
            cost = seeds * job_cost(f, Question(plan.training, [origin], 0, plan.others))
        if cost > left and (kept or not needed):
            takes = cost * time.pace.seconds / time.cores
            time.left_out[f.name] = (
                f"left out: its trial takes about {takes:.0f} s here, and "
                f"{max(work.deadline.left, 0):.0f} s were left for it"
            )
            continue
        left -= cost
        kept.append(f)
    return kept


def last_trainings(
    plan: Plan,
    networks: Sequence[Forecaster],
    searched: SearchResult,
    trial: Trial,
    work: Work,
) -> dict[str, range]:
    """The seeds of the networks that are trained on the whole training part, the best one first.

    Where there is no time for all of them, the worst ones are left out by name.
    """
    time, scores, seeds = work.time, {f.name: trial.scores[f.name] for f in networks}, plan.seeds
    left = time.reckoned(work.deadline)
    wanted = dict.fromkeys(scores, range(SEEDS if seeds is None else seeds))
    if seeds is None:
        wanted |= searched.seeds(scores, left if time.limited else None)
    ranked = sorted(scores, key=lambda name: scores[name])
    if seeds is None and wanted != dict.fromkeys(scores, range(SEEDS)) | searched.seeds(scores):
        time.narrowed("the number of seeds")
    kept: dict[str, range] = {}
    needed = not set(trial.scores) - set(scores)
    for name in ranked:
        cost = searched.cost(name)
        alone = cost > time.reckoned_alone(work.deadline)
        late = work.deadline.left <= 0
        if (kept and (alone or cost > left)) or (late and (kept or not needed)):
            takes = cost * time.pace.seconds
            time.left_out[name] = (
                f"left out: its last training takes about {takes:.0f} s here, and "
                f"{max(work.deadline.left, 0):.0f} s were left for it"
            )
            continue
        kept[name] = wanted[name]
        left -= cost
    return kept


def without_failed(runs: Runs, training: Record) -> Runs:
    """Return the runs and the models of the seeds that count."""
    kept = {name: sound_runs(each, training) for name, each in runs.items()}
    models = {}
    for name, of_method in runs.models.items():
        seeds = {run.seed for run in kept[name]}
        models[name] = [m for m in of_method if m.require_fitted().report.seed in seeds]
    return Runs(kept, runs.failures, models)


def sound_runs(runs: Sequence[Run], training: Record) -> list[Run]:
    """Return the runs of a method without the seeds that failed on the training record.

    What counts is the last training loss, of windows, and the error of a free run from the first
    samples to the end of the training record. The description of the first run says which seeds
    have been left out.
    """
    failed = failed_seeds(
        {run.seed: run.fit for run in runs}, {run.seed: _from_start(run, training) for run in runs}
    )
    kept = [run for run in runs if run.seed not in failed]
    said = [f"seed {seed} left out: {why}" for seed, why in failed.items()]
    if not any(run.fit.stable for run in kept):
        said.append("unstable: a simulation may grow without bound")
    if not said:
        return kept
    first = replace(kept[0], description="; ".join(filter(None, [kept[0].description, *said])))
    return [first, *kept[1:]]


def handed_out(models: Sequence[Forecaster], trial: Trial) -> Forecaster:
    """The mean of fitted models, of one alone the model, with intervals from the trial."""
    usual = [model.require_fitted().report.seed for model in models] == [0]
    model = models[0] if usual or not models[0].random else Ensemble.of(models)
    model.held_out = trial.held_out.get(model.name)
    return model


def refitted(plan: Plan, model: Forecaster, trial: Trial, work: Work) -> Forecaster:
    """A method that was handed out, fitted to the whole record as it was fitted to its part."""
    method, seeds = model.clone(), [0]
    if isinstance(model, Ensemble):
        method, seeds = model.one_by_one(), [*model.seeds]
    samples = len(plan.record)
    origin = Origin(samples, samples - 1)
    question = Question(plan.record, [origin], samples, plan.others, keep=True)
    stage = work.for_stage(REFIT, work.time.deadline, (AFTER_FINAL, 1.0))
    with work.time.phase("refit"):
        found, _ = run_all([method], {method.name: question}, seeds, stage)
    return handed_out(models_of(plan, found)[method.name], trial)


def as_trained(forecaster: Forecaster, seeds: Sequence[int]) -> Forecaster:
    """The forecaster of these seeds, not fitted: what is random is the mean over them."""
    if not forecaster.random or [*seeds] == [0]:
        return forecaster.clone()
    return Ensemble.unfitted([forecaster.for_seed(seed).clone() for seed in seeds], seeds)


def _from_start(run: Run, training: Record) -> float:
    """Return the RMSE of the simulation of the training record, channels scaled; 0 if empty."""
    begin = len(training) - len(run.from_start.y)
    begin = max(begin, 0) if run.forecast is None else max(begin + len(run.forecast.y), 0)
    y = run.from_start.y[: len(training) - begin]
    scale = spread(training.seen)
    return rmse(training.seen[begin : begin + len(y)] / scale, y / scale) if len(y) else 0.0
