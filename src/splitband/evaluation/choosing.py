"""What `compare` and `forecast` have in common: what is tried, how it is trained, with which seeds.

No measured sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.data import Record
from splitband.evaluation.bases import on_baseline
from splitband.evaluation.costs import job_cost
from splitband.evaluation.plan import BASE, BASELINES, SEARCH, Plan
from splitband.evaluation.plan import TRIAL as TRIAL_OVER
from splitband.evaluation.runs import Work
from splitband.evaluation.search import SearchResult, search
from splitband.evaluation.selection import MOST_TRIAL_SEEDS, Trial, try_out
from splitband.evaluation.setup import Setup, trying_bases, usual_names
from splitband.forecasters.backtest import Origin, Question, held_out_from
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import Ensemble
from splitband.runtime.arguments import whole

TRIAL, FINAL = "held-out fit", "final fit"
"""The stages of the work: on how much of the training part the methods are fitted."""
AFTER_BASELINES, AFTER_SEARCH, AFTER_TRIAL, AFTER_FINAL = 0.1, 0.6, 0.7, 0.95
"""Shares of a command that are done after these stages, for progress bars."""
SEEDS = 3
"""Trainings of each network, where nothing else decides how many."""


def candidates(
    record: Record, setup: Setup, methods: Sequence[Forecaster | str] | None
) -> tuple[list[Forecaster], Setup]:
    """The methods with what they leave open taken from the setup, and the setup they are for.

    A method may be given by its name. Without methods they are what is worth trying on such a
    record, and the setup allows for more.
    """
    if methods is None:
        methods, setup = usual_names(record, setup), trying_bases(setup)
    made = [setup.forecaster(each) if isinstance(each, str) else each for each in methods]
    return [method.with_defaults(setup.settings, setup.bands) for method in made], setup


def timed(work: Work, setup: Setup) -> Work:
    """The work with a plan of its time: the caller's, or from now on what the setup allows."""
    plan = work.plan
    if not plan.limited and setup.search is not None:
        plan = Plan.of(setup.search.seconds, work.cores, plan.began)
    if setup.search is not None:
        plan.asked = setup.search.seconds, setup.search.core_seconds
    return replace(work, plan=plan, deadline=plan.deadline)


def last_stages(work: Work, asked: int, samples: int, ahead: int) -> tuple[Work, Work]:
    """The work on the whole training part: of what needs no training, and of networks.

    Parameters
    ----------
    work : Of the whole command.
    asked : Samples that each method forecasts in the end.
    samples, ahead : Of the training part, and after it; a trial has forecast three parts of them.
    """
    held_out = samples - held_out_from(samples)
    asking = work.plan.asking * asked / (2 * held_out + 3 * ahead)
    plan, first = work.plan, (AFTER_TRIAL, AFTER_TRIAL)
    quick = work if plan.allows_processes(plan.deadline) else work.alone()
    return (
        quick.for_stage(FINAL, plan.deadline, first),
        work.for_stage(FINAL, work.plan.deadline.earlier(asking), (AFTER_TRIAL, AFTER_FINAL)),
    )


def choose(
    record: Record,
    forecasters: Sequence[Forecaster],
    ahead: int,
    setup: Setup,
    seeds: int | None,
    work: Work,
    others: Sequence[Record],
    tested: bool = False,
) -> tuple[Trial, SearchResult]:
    """How networks are to be trained, and what all methods do on held-out samples.

    Parameters
    ----------
    record : The training part, and nothing else.
    forecasters : The `candidates`.
    ahead : Samples to be forecast after all.
    setup : Its `search` says how much may go into finding out how to train.
    seeds : Trainings of each network, if that has been decided.
    work, others : See `compare`.
    tested : Whether methods are asked about other records, too.
    """
    if seeds is not None:
        whole("seeds", seeds)
    quick = [f for f in forecasters if not f.random]
    slow = [f for f in forecasters if f.random]
    plan, tried = work.plan, range(SEEDS if seeds is None else seeds)[:MOST_TRIAL_SEEDS]
    trial = None
    if quick:
        until = plan.share(BASELINES)
        stage = work.for_stage(TRIAL, until, (0.0, AFTER_BASELINES))
        stage = stage if plan.allows_processes(until) else stage.alone()
        with plan.phase("baselines"):
            trial = try_out(record, quick, ahead, tried, stage, others, need_one=not slow)
    searched = SearchResult([*forecasters])
    searching, trying, basing = plan.share(SEARCH), plan.share(TRIAL_OVER), plan.share(BASE)
    if setup.search is not None:
        stage = replace(work, deadline=searching, span=(AFTER_BASELINES, AFTER_SEARCH))
        with plan.phase("search"):
            searched = search(record, forecasters, ahead, setup.search, stage, others)
    if not slow:
        assert trial is not None
        return trial, searched
    stage = work.for_stage(TRIAL, trying, (AFTER_SEARCH, AFTER_TRIAL))
    with plan.phase("trial"):
        needed = trial is None or not trial.errors
        networks = _in_time(record, searched, tried, stage, others, needed)
        found = try_out(
            record,
            networks,
            ahead,
            tried,
            stage,
            others,
            searched.done,
            need_one=needed,
        )
    trial = found if trial is None else trial.joined(found)
    late = {name: reason for name, reason in plan.left_out.items() if name not in trial.errors}
    trial = replace(trial, failed={**trial.failed, **late})
    if plan.deadline.over:
        return trial, searched
    if tested or others:  # what goes on in the time of one record is no base for several
        anchored = frozenset(f.name for f in searched.forecasters if f.anchored)
        trial = replace(trial, left_out=anchored)
    stage = replace(work, deadline=basing, span=(AFTER_TRIAL, AFTER_TRIAL))
    with plan.phase("on a baseline"):
        trial, searched = on_baseline(record, trial, searched, setup, ahead, tried, stage, others)
    return replace(trial, left_out=frozenset()), searched


def _in_time(
    record: Record,
    searched: SearchResult,
    seeds: Sequence[int],
    work: Work,
    others: Sequence[Record],
    needed: bool,
) -> list[Forecaster]:
    """The networks that there is time to try; the others are left out by name.

    Where nothing else has come to a result, the first one is `needed` however late it is: it ends
    with what it has.
    """
    plan, kept = work.plan, list[Forecaster]()
    left = plan.reckoned(work.deadline)
    for f in searched.forecasters:
        if not f.random or searched.done.get(f.name):
            kept += [f] if f.random else []
            continue
        cost = 0.0
        if plan.limited:
            question = Question(
                record, [Origin(held_out_from(len(record)), len(record))], 0, others
            )
            cost = len(seeds) * job_cost(f, question)
        if cost > left and (kept or not needed):
            takes = cost * plan.pace / plan.cores
            plan.left_out[f.name] = (
                f"left out: its trial takes about {takes:.0f} s here, and "
                f"{max(work.deadline.left, 0):.0f} s were left for it"
            )
            continue
        left -= cost
        kept.append(f)
    return kept


def last_trainings(
    networks: Sequence[Forecaster],
    searched: SearchResult,
    trial: Trial,
    seeds: int | None,
    work: Work,
) -> dict[str, range]:
    """The seeds of the networks that are trained on the whole training part, the best one first.

    Where there is no time for all of them, the worst ones are left out by name.
    """
    plan, scores = work.plan, {f.name: trial.scores[f.name] for f in networks}
    left = plan.reckoned(work.deadline)
    wanted = dict.fromkeys(scores, range(SEEDS if seeds is None else seeds))
    if seeds is None:
        wanted |= searched.seeds(scores, left if plan.limited else None)
    ranked = sorted(scores, key=lambda name: scores[name])
    if seeds is None and wanted != dict.fromkeys(scores, range(SEEDS)) | searched.seeds(scores):
        plan.narrowed("the number of seeds")
    kept: dict[str, range] = {}
    needed = not set(trial.scores) - set(scores)
    for name in ranked:
        cost = searched.costs.get(name, 0.0)
        alone = cost > plan.reckoned_alone(work.deadline)
        late = work.deadline.left <= 0
        if (kept and (alone or cost > left)) or (late and (kept or not needed)):
            plan.left_out[name] = (
                f"left out: its last training takes about {cost * plan.pace:.0f} s here, and "
                f"{max(work.deadline.left, 0):.0f} s were left for it"
            )
            continue
        kept[name] = wanted[name]
        left -= cost
    return kept


def as_trained(forecaster: Forecaster, seeds: Sequence[int]) -> Forecaster:
    """The forecaster of these seeds, not fitted: what is random is the mean over them."""
    if not forecaster.random or [*seeds] == [0]:
        return forecaster.clone()
    usual = [*seeds] == [*range(len(seeds))]
    return Ensemble(forecaster.clone(), len(seeds), seeds=None if usual else seeds)
