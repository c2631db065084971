"""A network on top of a baseline that does better than every network."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy
from splitband.evaluation.choosing import on_baseline
from splitband.evaluation.setup import Setup
from splitband.evaluation.work import Work

from splitband import Record, Settings
from splitband.evaluation.plan import Plan
from splitband.evaluation.recommendation import Trial, try_out
from splitband.evaluation.search import Search, SearchResult
from splitband.forecasters.names import Sizes

SAMPLES, STEPS = 300, 60
BASED = "residual-linear-gru-conditioned"
SHORT = Settings(30, 5, 2, 16, most_batches=4, quasi_newton=12)
SETUP = Setup(SAMPLES, SHORT, sizes=Sizes(hidden_high=4, hidden_low=2))
WANTED = Search(bases=True)


def record(nonlinear: float) -> Record:
    """A slow response to the input, as a linear model has it, and a share of the input's square."""
    rng = np.random.default_rng(0)
    u = scipy.signal.lfilter([0.5], [1, -0.5], rng.normal(size=SAMPLES + STEPS))
    y = scipy.signal.lfilter([0.02], [1, -1.96, 0.97], u) + nonlinear * u**2
    return Record(y + 0.01 * rng.normal(size=len(u)), 0.1, u=u)[:SAMPLES]


@cache
def without(nonlinear: float) -> Trial:
    """Of baselines and a network that has hardly been trained."""
    hardly = replace(SHORT, epochs=1, most_batches=1, quasi_newton=None)
    forecasters = [SETUP.forecaster(name) for name in ("linear", "mean")]
    trained = replace(SETUP, settings=hardly).forecaster("gru")
    return try_out(record(nonlinear), [trained, *forecasters], STEPS)


def tried(
    nonlinear: float, search: Search, left: float = 1e3, of_network: float | None = None
) -> tuple[Trial, SearchResult]:
    """With a network on top; the other one has the score `of_network`, if that is given."""
    setup, trial = replace(SETUP, search=search), without(nonlinear)
    if of_network is not None:
        trial = replace(trial, scores={**trial.scores, "gru": of_network})
    found = SearchResult([setup.forecaster(n) for n in ("gru", "linear", "mean")], left=left)
    plan = Plan(record(nonlinear), (), setup, STEPS)
    return on_baseline(plan, trial, found, (0,), Work())


def test_what_a_linear_model_leaves_is_learned_on_top_of_it() -> None:
    trial, searched = tried(0.5, WANTED)
    assert searched.forecasters[-1].name == BASED
    assert trial.scores[BASED] < 0.9 * trial.scores["linear"]
    assert BASED in trial.intervals
    assert BASED in trial.trained
    assert searched.costs[BASED] > 0
    assert searched.attempts[-1].score == trial.scores[BASED]
    assert searched.left < 1e3


def test_where_nothing_is_left_it_is_tried_and_dropped() -> None:
    trial, searched = tried(0.0, WANTED)
    assert [attempt.method for attempt in searched.attempts] == [BASED]
    assert [forecaster.name for forecaster in searched.forecasters] == ["gru", "linear", "mean"]
    assert set(trial.scores) == {"gru", "linear", "mean"}


@pytest.mark.parametrize(
    ("search", "left", "of_network"),
    [(Search(), 1e3, None), (WANTED, 1e-3, None), (WANTED, 1e3, 0.01)],
    ids=["methods were named", "nothing is left of the budget", "a network is the best method"],
)
def test_it_is_not_tried_where(search: Search, left: float, of_network: float | None) -> None:
    trial, searched = tried(0.5, search, left, of_network)
    assert not searched.attempts
    assert BASED not in trial.scores
