"""What several benchmarks ask of the library by the names of methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband import Comparison, Forecaster, Record
from splitband.evaluation.jobs import Seeds, run_all
from splitband.evaluation.plan import Plan, check
from splitband.evaluation.protocols import Runs, question_of, runs_of
from splitband.evaluation.recommendation import try_out
from splitband.evaluation.setup import Setup
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import first_held_out, for_trial
from splitband.forecasters.network import Network


def forecasters(names: Sequence[Forecaster | str], setup: Setup) -> list[Forecaster]:
    """Return the methods, those that are given by name with what the setup says."""
    return [setup.forecaster(each) if isinstance(each, str) else each for each in names]


def compared(
    record: Record, names: Sequence[str], setup: Setup, seeds: Sequence[int], jobs: int
) -> Comparison:
    """Like `splitband.compare`, without its search, and with all seeds tried out instead of two."""
    methods, work = forecasters(names, setup), Work(jobs)
    trial = try_out(record[: setup.train], methods, len(record) - setup.train, seeds, work)
    plan = Plan.of(record, methods, setup)
    check(plan)
    runs = run_methods(plan, methods, seeds, work)
    return Comparison(plan, runs, trial.settled(runs.ahead, runs.failed))


def run_methods(
    plan: Plan, methods: Sequence[Forecaster], seeds: Seeds = (0,), work: Work | None = None
) -> Runs:
    """Fit methods of a plan with every seed, and predict under every protocol."""
    questions = {method.name: question_of(plan, method) for method in methods}
    return runs_of(plan, questions, *run_all(methods, questions, seeds, work or Work()))


def held_out(record: Record, setup: Setup) -> tuple[Record, Setup]:
    """The training part as a record of its own, the last quarter of it to be predicted.

    Long training windows shrink with what is left to train on.
    """
    network = for_trial(setup.forecaster("gru"), setup.train)
    assert isinstance(network, Network)
    assert network.settings is not None
    part = replace(record[: setup.train], y_true=None)
    return part, replace(setup, train=first_held_out(setup.train), settings=network.settings)
