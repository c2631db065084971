"""A network on top of a baseline, where that baseline does better than every network.

Not in the paper. What a periodic regression or a linear model knows of a record, a network need
not learn; what these leave, it may. That is tried with the training that suits the best network,
and kept where it is better than the baseline alone on held-out samples. Where a network is the best
method anyway, there is nothing to try.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.evaluation.costs import training_cost
from splitband.evaluation.plan import Plan
from splitband.evaluation.runs import Work
from splitband.evaluation.search import SearchAttempt, SearchResult
from splitband.evaluation.selection import WORTH_TRAINING, Trial, try_out
from splitband.forecasters.backtest import HELD_OUT
from splitband.forecasters.names import BASES, with_base
from splitband.forecasters.network import Network

STAGE = "on a baseline"
"""Name of the stage of the work."""


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
    networks = {f.name: f for f in searched.forecasters if isinstance(f, Network)}
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
    network = setup.forecaster(method)
    assert isinstance(network, Network)
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
    stage = work.for_stage(STAGE)
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
