"""Run the held-out trial: baselines, search, networks, a network on a baseline.

Baselines are tried first, then networks with the settings that the search has found. If a baseline
beats every network, a network on top of it is tried as well, which learns only what the baseline
leaves (a periodic regression or a linear model, for instance). It is kept only if the held-out
error of the baseline alone is more than a tenth above its own (`WORTH_TRAINING`). That is not in
the paper.

Settings are chosen and methods are scored on the training part alone: no measured sample after it
is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.evaluation.budget import BASE_SHARE, BASELINES_SHARE, SEARCH_SHARE, TRIAL_SHARE
from splitband.evaluation.costs import job_cost, training_cost
from splitband.evaluation.plan import Plan
from splitband.evaluation.recommendation import MOST_TRIAL_SEEDS, WORTH_TRAINING, Trial, try_out
from splitband.evaluation.search import SEEDS, SearchResult, search
from splitband.evaluation.trials import SearchAttempt
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import HELD_OUT_SHARE, Origin, Question, first_held_out
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASES, with_base
from splitband.forecasters.network import Network

TRIAL_STAGE = "held-out fit"
"""Name of the stage that fits methods to three quarters of the training part."""
AFTER_BASELINES, AFTER_SEARCH, AFTER_TRIAL = 0.1, 0.6, 0.7
"""Shares of a command that are done after these stages, for progress bars. By eye."""


def choose(plan: Plan, work: Work) -> tuple[Trial, SearchResult]:
    """Return the results of all methods on held-out samples, and the chosen training settings."""
    record, others, ahead, setup = plan.training, plan.others, plan.horizon, plan.setup
    quick = [f for f in plan.methods if not f.random]
    slow = [f for f in plan.methods if f.random]
    time, seeds = work.time, range(SEEDS if plan.seeds is None else plan.seeds)[:MOST_TRIAL_SEEDS]
    trial, searched = Trial(), SearchResult([*plan.methods])
    if quick:
        until = time.share(BASELINES_SHARE if slow else TRIAL_SHARE)
        stage = work.for_stage(TRIAL_STAGE, until, (0.0, AFTER_BASELINES))
        stage = stage if time.allows_processes(until) else stage.alone()
        with time.phase("baselines", until):
            trial = try_out(record, quick, ahead, seeds, stage, others, need_one=not slow)
    if not slow:
        return trial, searched
    searching, trying = time.share(SEARCH_SHARE), time.share(TRIAL_SHARE)
    basing = time.share(BASE_SHARE)
    if setup.search is not None:
        stage = replace(work, deadline=searching, span=(AFTER_BASELINES, AFTER_SEARCH))
        with time.phase("search", searching):
            searched = search(record, plan.methods, ahead, setup.search, stage, others)
    stage = work.for_stage(TRIAL_STAGE, trying, (AFTER_SEARCH, AFTER_TRIAL))
    with time.phase("trial", trying):
        needed = not trial.errors
        networks, unpaid = _affordable(plan, searched, len(seeds), stage, needed)
        done = searched.done
        found = try_out(record, networks, ahead, seeds, stage, others, done, need_one=needed)
    trial = trial.joined(found)
    late = {name: reason for name, reason in time.left_out.items() if name not in trial.errors}
    trial = replace(trial, failed={**trial.failed, **unpaid, **late})
    if time.deadline.over:
        return trial, searched
    stage = replace(work, deadline=basing, span=(AFTER_TRIAL, AFTER_TRIAL))
    with time.phase("on a baseline", basing):
        return on_baseline(plan, trial, searched, seeds, stage)


def on_baseline(
    plan: Plan, trial: Trial, searched: SearchResult, seeds: Sequence[int], work: Work
) -> tuple[Trial, SearchResult]:
    """Return the trial and the methods, with a network on the best baseline if that is better.

    Parameters
    ----------
    plan : Its setup's search says whether this is wanted (`Search.bases`).
    trial, searched : Results of all other methods.
    seeds : Seeds of the network; their median forecast is scored.
    work : Processes, progress and checkpoints.
    """
    record, others, setup = plan.training, plan.others, plan.setup
    networks = {f.name: f.network for f in searched.forecasters if f.network is not None}
    best, scores = trial.best_network, trial.scores
    # A method that depends on the time since its training record began cannot be a base when there
    # are several records.
    several = bool(plan.tests or others)
    able = [
        f.name
        for f in searched.forecasters
        if f.name in BASES and f.name in scores and not (several and f.anchored)
    ]
    if setup.search is None or not setup.search.bases or best not in networks or not able:
        return trial, searched
    base = min(able, key=lambda name: scores[name])
    if best is None or scores[base] >= scores[best]:
        return trial, searched
    network = _on(base, networks[best], plan)
    cost = training_cost(network, record, others)
    spent = len(seeds) * (1 - HELD_OUT_SHARE) * cost
    if network.name in scores or spent + cost > searched.left:
        return trial, searched
    if spent > work.time.work_until(work.deadline):
        work.time.narrowed(f"{network.name} (not tried)")
        return trial, searched
    stage = work.for_stage("on a baseline")
    found = try_out(record, [network], plan.horizon, seeds, stage, others, need_one=False)
    score = found.scores.get(network.name)
    attempt = SearchAttempt(network.name, network.training_in_words(), len(seeds), score)
    searched = replace(searched, attempts=(*searched.attempts, attempt), left=searched.left - spent)
    if score is None or score * (1 + WORTH_TRAINING) >= scores[base]:
        return trial, searched
    return trial.joined(found), replace(
        searched,
        forecasters=[*searched.forecasters, network],
        costs={**searched.costs, network.name: cost},
    )


def _on(base: str, best: Network, plan: Plan) -> Network:
    """Return the network to try on a baseline, with the settings of the best network."""
    (method,) = with_base(["residual-gru-conditioned"], base)
    network, settings = plan.setup.forecaster(method).network, best.settings
    assert network is not None
    assert settings is not None
    # Settings without epochs are for networks that begin as a linear model, unlike this one.
    return network.trained_as(settings if settings.epochs else plan.setup.settings).to(best.device)


def _affordable(
    plan: Plan, searched: SearchResult, seeds: int, work: Work, needed: bool
) -> tuple[list[Forecaster], dict[str, str]]:
    """Return the networks to try, and why the budget is too small for others.

    The budget must suffice for both trial and training. Networks without time for a trial are left
    out and reported. If one network is `needed`, as there is no other result, the first one is kept
    even if it is too expensive; the deadline then cuts its training short.
    """
    time, kept, unpaid = work.time, list[Forecaster](), dict[str, str]()
    left = searched.left - sum(searched.costs[name] for name in searched.done)
    in_time = time.work_until(work.deadline)
    held_out = Question(
        plan.training, [Origin(first_held_out(plan.train), plan.train)], 0, plan.others
    )
    for f in searched.forecasters:
        if not f.random:
            continue
        optional = kept or not needed
        if f.name in searched.costs and f.name not in searched.done:
            cost = (1 + seeds * (1 - HELD_OUT_SHARE)) * searched.costs[f.name]
            if cost > left and optional:
                unpaid[f.name] = (
                    f"left out: its trial and training take about {cost:.0f} s of a reference "
                    f"core, and {max(left, 0):.0f} s of the budget were left for them"
                )
                continue
            left -= cost
        costs_no_trial_time = not time.limited or searched.done.get(f.name)
        cost = 0.0 if costs_no_trial_time else seeds * job_cost(f, held_out)
        if cost > max(in_time, 0.0) and optional:
            takes = cost * time.pace.seconds / time.cores
            time.leave_out(f.name, "trial", takes, work.deadline)
            continue
        in_time -= cost
        kept.append(f)
    return kept, unpaid
