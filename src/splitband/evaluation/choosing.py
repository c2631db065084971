"""Decide, by the training part alone, how networks are trained and with how many seeds.

What needs no training is tried first, then networks, as the search trains them. A network on top of
a baseline is tried where that baseline does better than every network: what a periodic regression
or a linear model knows of a record, a network need not learn; what these leave, it may. It is kept
where it is better than the baseline alone on held-out samples. That is not in the paper.

No measured sample after the training part is looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.evaluation.budget import BASE, BASELINES, SEARCH
from splitband.evaluation.budget import TRIAL as TRIAL_OVER
from splitband.evaluation.costs import job_cost, training_cost
from splitband.evaluation.plan import Plan
from splitband.evaluation.search import SEEDS, SearchAttempt, SearchResult, search
from splitband.evaluation.selection import MOST_TRIAL_SEEDS, WORTH_TRAINING, Trial, try_out
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import HELD_OUT, Origin, Question, held_out_from
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASES, with_base

ON_BASELINE = "on a baseline"
"""The stage in which a network on top of a baseline is tried."""
TRIAL = "held-out fit"
"""The stage in which methods are fitted to three quarters of the training part."""
AFTER_BASELINES, AFTER_SEARCH, AFTER_TRIAL = 0.1, 0.6, 0.7
"""Shares of a command that are done after these stages, for progress bars."""


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
        until = time.share(BASELINES if slow else TRIAL_OVER)
        stage = work.for_stage(TRIAL, until, (0.0, AFTER_BASELINES))
        stage = stage if time.allows_processes(until) else stage.alone()
        with time.phase("baselines", until):
            trial = try_out(record, quick, ahead, tried, stage, others, need_one=not slow)
    searched = SearchResult([*plan.methods])
    if not slow:
        assert trial is not None
        return trial, searched
    searching, trying, basing = time.share(SEARCH), time.share(TRIAL_OVER), time.share(BASE)
    if setup.search is not None:
        stage = replace(work, deadline=searching, span=(AFTER_BASELINES, AFTER_SEARCH))
        with time.phase("search", searching):
            searched = search(record, plan.methods, ahead, setup.search, stage, others)
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


def on_baseline(
    plan: Plan, trial: Trial, searched: SearchResult, seeds: Sequence[int], work: Work
) -> tuple[Trial, SearchResult]:
    """The trial and the methods, with a network on the best baseline where that pays.

    Parameters
    ----------
    plan : The search of its setup says whether this is wanted.
    trial, searched : What has been found of all other methods; `trial.left_out` are no bases.
    seeds : Of the network, whose mean is scored.
    work : Processes, progress and checkpoints.
    """
    record, others, setup = plan.training, plan.others, plan.setup
    networks = {f.name: f.network for f in searched.forecasters if f.network is not None}
    best = trial.best_network
    able = [
        f.name
        for f in searched.forecasters
        if f.name in BASES and f.name in trial.scores and f.name not in trial.left_out
    ]
    if setup.search is None or not setup.search.bases or best not in networks or not able:
        return trial, searched
    base = min(able, key=lambda name: trial.scores[name])
    if best is None or trial.scores[base] >= trial.scores[best]:
        return trial, searched
    (method,) = with_base(["residual-gru-conditioned"], base)
    network = setup.forecaster(method).network
    assert network is not None
    settings = networks[best].settings
    assert settings is not None
    if not settings.epochs:  # of a network that begins as a linear model: this one does not
        settings = setup.settings
    network = network.trained_as(settings).to(networks[best].device)
    cost = training_cost(network, record, others)
    spent = len(seeds) * (1 - HELD_OUT) * cost
    if network.name in trial.scores or spent + cost > searched.left:
        return trial, searched
    if spent > work.time.reckoned(work.deadline):
        work.time.narrowed(f"{network.name} (not tried)")
        return trial, searched
    stage = work.for_stage(ON_BASELINE)
    found = try_out(record, [network], plan.horizon, seeds, stage, others, need_one=False)
    score = found.scores.get(network.name)
    attempt = SearchAttempt(network.name, network.training_in_words(), len(seeds), score)
    searched = replace(searched, attempts=(*searched.attempts, attempt), left=searched.left - spent)
    if score is None or score * (1 + WORTH_TRAINING) >= trial.scores[base]:
        return trial, searched
    return trial.joined(found), replace(
        searched,
        forecasters=[*searched.forecasters, network],
        costs={**searched.costs, network.name: cost},
    )


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
