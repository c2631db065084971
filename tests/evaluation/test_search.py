"""Finding out how to train by held-out samples of the training part."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy
import torch

import splitband as sb
from splitband import Record, Settings
from splitband.evaluation import candidates, trials
from splitband.evaluation.costs import reference_seconds, training_cost
from splitband.evaluation.jobs import failed_seeds
from splitband.evaluation.protocols import without_failed
from splitband.evaluation.search import (
    Search,
    SearchResult,
    search,
)
from splitband.evaluation.setup import Options, Setup
from splitband.evaluation.trials import held_out_score
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import Backtest, Origin
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.initialisation import Earlier
from splitband.forecasters.network import Network
from tests.records import SETUP, TRAIN, record

QUICK = Settings(40, 12, 1, 16, most_batches=2)
BUDGET = Search(240.0)
SEARCHED = replace(SETUP, settings=QUICK, search=BUDGET)
STEPS = 20


@pytest.fixture(autouse=True)
def short_trainings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidates, "LADDER", (3, 6))
    monkeypatch.setattr(candidates, "FREE_RUN_FROM_LINEAR", 10)
    monkeypatch.setattr(candidates, "FREE_RUNS_FROM_RANDOM", (10, 15))
    monkeypatch.setattr(candidates, "FIRST_STEPS", 4)


def driven() -> Record:
    """A filter with a saturated input."""
    u = np.random.default_rng(0).standard_normal(TRAIN + STEPS)
    return Record(scipy.signal.lfilter([0, 0.3], [1, -0.8], np.tanh(u)), 0.1, u=u)[:TRAIN]


def methods(setup: Setup, *names: str) -> list[Forecaster]:
    return [setup.forecaster(name) for name in names]


def searched_by(
    training: Record,
    names: Sequence[str],
    budget: Search | None = None,
    work: Work | None = None,
) -> SearchResult:
    chosen = methods(SEARCHED, *names)
    return search(training, chosen, STEPS, budget or BUDGET, work or Work())


@cache
def of_gru() -> SearchResult:
    """What the whole budget finds for a GRU, once for several tests."""
    return searched_by(record()[:TRAIN], ["gru", "mean"])


@cache
def of_driven() -> SearchResult:
    """What is found for a network with inputs."""
    return searched_by(driven(), ["state-space"])


def settings_of(forecaster: Forecaster) -> Settings:
    assert isinstance(forecaster, Network)
    assert forecaster.settings is not None
    return forecaster.settings


def test_the_trainings_with_the_lowest_held_out_errors_are_chosen() -> None:
    """Of whatever settings, the best one first; as many from three on as have the best median."""
    training, searched = record()[:TRAIN], of_gru()
    chosen, mean = searched.forecasters
    assert isinstance(chosen, Network)
    assert mean.name == "mean"
    done = [*searched.done["gru"].values()]
    scores = [held_out_score(training, [each]) for each in done]
    assert scores == sorted(scores)
    assert 3 <= len(scores) <= 8
    assert held_out_score(training, done) <= held_out_score(training, done[:3])
    ways = {chosen.for_seed(seed).training_in_words() for seed in searched.done["gru"]}
    assert {way.partition(",")[0] for way in ways} <= {
        a.training.partition(",")[0] for a in searched.attempts
    }


def test_windows_sizes_penalties_and_steps_are_tried() -> None:
    of_first = [a.training for a in of_gru().attempts]
    assert len(of_first) == len(set(of_first))
    for part in ("windows of 22", "windows of 27", "windows of 40", "penalty", "3 hidden units"):
        assert any(part in training for training in of_first), part
    assert any("L-BFGS 6" in training for training in of_first)


def test_every_method_is_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidates, "LADDER", (1,))
    monkeypatch.setattr(candidates, "FREE_RUNS_FROM_RANDOM", (10,))
    searched = searched_by(record()[:TRAIN], ["gru", "split-gru"], Search(20.0))
    assert {attempt.method for attempt in searched.attempts} == {"gru", "split-gru"}


def test_a_network_with_inputs_begins_as_the_linear_model_and_from_random_weights() -> None:
    first, *others = [a.training for a in of_driven().attempts]
    assert first == "4 states, 10 hidden units, windows of 22, L-BFGS 3"
    assert any("from random weights" in training for training in others)


def test_what_has_helped_alone_is_tried_together() -> None:
    network = Options().decided(driven(), TRAIN).forecaster("state-space").network
    assert network is not None
    usual, *others = candidates.candidates(network, driven())
    (larger,) = [c for c in others if "6 states" in c.label]
    (random,) = [c for c in others if "random" in c.label]
    both = candidates.combined(usual, larger, random)
    assert both is not None
    assert both.network.get_params()["cell"] == larger.network.get_params()["cell"]
    assert both.settings == random.settings
    assert candidates.combined(usual, larger, larger) is None


def test_windows_that_are_one_on_the_shorter_record_of_a_trial_are_tried_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A window of 160 samples of 400 becomes one of 150 samples of the first 300.
    monkeypatch.setattr(candidates, "FREE_RUNS_FROM_RANDOM", (50, 100))
    wave = sb.Record(np.sin(np.arange(400.0)), 1.0)
    network = sb.Single(sb.GRU(4), Settings.of(400)).network
    found = candidates.candidates(network, wave)
    assert {c.settings.window for c in found if c.iterations} == {100, 150}


def test_a_training_goes_on_from_where_it_stopped() -> None:
    """From round to round, and from the held-out trial to all samples, each seed from its own."""
    searched = of_driven()
    (chosen,) = searched.forecasters
    assert isinstance(chosen, Network)
    for seed in searched.done["state-space"]:
        network = chosen.for_seed(seed)
        assert isinstance(network, Network)
        once = replace(settings_of(network), quasi_newton=1)
        fresh = network.trained_as(once).continued(Earlier())
        on, anew = (
            each.fit(driven(), seed=seed).require_fitted().report.losses["network"]
            for each in (network, fresh)
        )
        assert on[-1] < 0.9 * anew[-1]


def test_if_errors_still_fall_all_trainings_of_the_last_round_go_on_equally_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a long record. Those of the round before settle on all samples alone."""
    monkeypatch.setattr(trials, "SHORT", TRAIN - 1)

    def every_training(searched: trials.Trials, method: str) -> list[trials.TrialRun]:
        return sorted(searched.runs, key=lambda run: -run.candidate.iterations)

    monkeypatch.setattr(trials.Trials, "best", every_training)
    searched = searched_by(driven(), ["state-space"])
    (chosen,) = searched.forecasters
    every = [chosen.for_seed(seed).network for seed in searched.done["state-space"]]
    iterations = {(n.earlier.iterations, settings_of(n).quasi_newton) for n in every if n}
    assert iterations == {(3, 4), (6, trials.MOST_TIMES_LONGER * 6)}


def test_seeds_of_the_default_recipe_of_a_hybrid_are_distinct_forecasters() -> None:
    """One of them in its own `by_seed` would be adapted to a shorter record without end."""
    hybrid, training = "residual-gru-calibrated-conditioned", record()[:TRAIN]
    (first,) = methods(SEARCHED, hybrid)
    assert isinstance(first, Network)
    recipe = candidates.candidates(first, training)[0]  # the one that the budget pays for
    both_seeds = 1.5 * training_cost(recipe.network, training, ())
    setup = replace(SEARCHED, search=Search(1.01 * both_seeds / trials.SEARCH_SHARE_OF_WORK))
    result = sb.compare(record(), TRAIN, [hybrid, "simulator"], setup=setup)
    assert [a.training for a in result.attempts] == [recipe.network.training_in_words()]
    assert hybrid in result.runs


def test_a_seed_whose_simulation_may_grow_is_left_out_where_another_cannot() -> None:
    """Tanh units are bounded: with a stable linear part so is every simulation."""
    cell = sb.StateSpace(2, 4)
    assert cell.stable()
    with torch.no_grad():
        cell.transition.weight[:, :2] = torch.tensor([[0.0, 1.01], [-1.01, 0.0]])
    assert not cell.stable()
    reports = {s: FitReport(s, stable=s > 0, losses={"network": [0.1 + s]}) for s in range(2)}
    assert failed_seeds(reports) == {0: "it is unstable, and may grow without bound"}
    assert failed_seeds({0: reports[0]}) == {}


def test_seeds_that_failed_in_training_do_not_count() -> None:
    """In a trial by their loss, after it by their simulation of the whole training record."""
    losses = {0: 0.011, 1: 0.4, 2: 0.01}
    reports = {s: FitReport(s, losses={"network": [loss]}) for s, loss in losses.items()}
    assert failed_seeds(reports) == {1: "training error 36.4 times the usual one"}
    # One that has learned the noise does not make the others fail.
    one_low = {
        s: FitReport(s, losses={"network": [loss]}) for s, loss in enumerate([0.1, 0.3, 0.3])
    }
    assert failed_seeds(one_low) == {}
    training = record()[:TRAIN]
    model = sb.Mean().fit(training)
    sound = model.predict(TRAIN - 10, training[:10])
    wild = replace(sound, y=1e9 + sound.y)
    done = {
        seed: Backtest({Origin(TRAIN, 10): said}, (), FitReport(seed), np.zeros((2, 1)), "")
        for seed, said in enumerate([sound, wild, sound])
    }

    def that_count(done: dict[int, Backtest]) -> tuple[list[int], list[str]]:
        kept, notes = without_failed(training, {"gru": done})
        return [*kept["gru"]], notes.get("gru", [])

    seeds, (note,) = that_count(done)
    assert seeds == [0, 2]
    assert note.startswith("seed 1 left out: training error ")
    assert that_count({0: done[0]}) == ([0], [])
    unstable = replace(done[0], report=FitReport(0, stable=False))
    assert that_count({0: unstable}) == ([0], ["unstable: a simulation may grow without bound"])


def test_it_depends_neither_on_workers_nor_on_what_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for rounding, which trainings amplify: what is tried first is the same in any case."""
    monkeypatch.setattr(candidates, "LADDER", (1,))
    monkeypatch.setattr(candidates, "FREE_RUNS_FROM_RANDOM", (10,))
    training = record()[:TRAIN]
    alone = searched_by(training, ["gru"])
    with ThreadPoolExecutor(2) as pool:
        work = Work(executor=pool, checkpoints=tmp_path)
        first = searched_by(training, ["gru"], work=work)
    resumed = searched_by(training, ["gru"], work=Work(1, None, tmp_path))
    for other in (first, resumed):
        of_both = list(zip(alone.attempts, other.attempts, strict=True))
        assert len(of_both) == 6
        for expected, attempt in of_both:
            assert (attempt.training, attempt.seeds) == (expected.training, expected.seeds)
            assert attempt.score == pytest.approx(expected.score, rel=0.1)
    assert [a.training for a in resumed.attempts] == [a.training for a in first.attempts]


def test_a_small_budget_tries_less_and_a_tiny_one_nothing() -> None:
    training, whole = record()[:TRAIN], of_gru()
    spent = BUDGET.core_seconds - whole.left
    less = searched_by(training, ["gru"], Search(0.8 * spent))
    assert 0 < len(less.attempts) < len(whole.attempts)
    assert Search(0.8 * spent).core_seconds - less.left <= trials.SEARCH_SHARE_OF_WORK * 0.8 * spent
    nothing = searched_by(training, ["gru"], Search(1e-6))
    assert nothing.attempts == ()
    assert settings_of(nothing.forecasters[0]) == QUICK


def test_what_the_budget_does_not_pay_for_is_left_out_and_says_so() -> None:
    setup = replace(SEARCHED, search=Search(1e-3))
    result = sb.compare(record(), TRAIN, ["mean", "gru", "split-gru"], setup=setup)
    assert [*result.runs] == ["mean"]
    for name in ("gru", "split-gru"):
        assert (
            result.require_trial()
            .failed[name]
            .startswith("left out: its trial and training take about ")
        )
    only = sb.compare(record(), TRAIN, ["gru", "split-gru"], setup=setup)
    assert [*only.runs] == ["gru"]  # there has to be a result


def test_settings_of_ones_own_are_not_searched() -> None:
    own = sb.Single(sb.GRU(4), settings=QUICK)
    chosen = [own.with_defaults(SETUP.settings, SETUP.bands)]
    searched = search(record()[:TRAIN], chosen, STEPS, BUDGET, Work())
    assert searched.attempts == ()
    assert searched.forecasters == chosen


def test_cells_of_ones_own_keep_their_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(candidates, "LADDER", (1,))
    chosen = [sb.Single(sb.GRU(4)).with_defaults(QUICK, SETUP.bands)]
    searched = search(record()[:TRAIN], chosen, STEPS, BUDGET, Work())
    assert {a.training.split(",")[0] for a in searched.attempts} == {"4 hidden units"}


def test_what_cannot_be_trained_is_an_attempt_without_a_score(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def diverge(*_: object, **__: object) -> None:
        raise FloatingPointError("diverged")

    monkeypatch.setattr("splitband.forecasters.network.fit", diverge)
    searched = searched_by(record()[:TRAIN], ["gru"])
    assert searched.attempts
    assert all(attempt.score is None for attempt in searched.attempts)
    assert settings_of(searched.forecasters[0]) == QUICK


def test_good_methods_get_more_seeds_as_long_as_the_budget_lasts() -> None:
    """All members that the search has begun, or three of what it has not trained."""
    costs = {"good": 10.0, "near": 10.0, "far": 10.0}
    scores = {"good": 1.0, "near": 1.4, "far": 2.0}
    members = {"good": 5, "far": 2}
    assert SearchResult([], costs=costs, members=members, left=1000).seeds(scores) == {
        "good": range(5), "near": range(3), "far": range(1)
    }  # fmt: skip
    assert SearchResult([], costs=costs, members=members, left=45).seeds(scores) == {
        "good": range(2), "near": range(1), "far": range(1)
    }  # fmt: skip
    more = SearchResult([], costs=costs, members=members, more={"good": 100.0}, left=300)
    assert more.seeds(scores)["good"] == range(7)
    assert SearchResult([], costs=costs, left=-1).seeds(scores) == dict.fromkeys(costs, range(1))


def test_a_larger_budget_tries_more_seeds_on_short_records(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert max(attempt.seeds for attempt in of_gru().attempts) == 2
    monkeypatch.setattr(candidates, "LADDER", (1,))
    monkeypatch.setattr(candidates, "FREE_RUNS_FROM_RANDOM", (10,))
    searched = searched_by(record()[:TRAIN], ["gru"], Search(2 * BUDGET.core_seconds))
    assert max(attempt.seeds for attempt in searched.attempts) == 4


def test_compare_searches_by_default_and_says_what_it_has_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    setup = replace(
        Options().decided(record(), TRAIN), settings=QUICK, bands=SETUP.bands, search=Search(1.0)
    )
    monkeypatch.setattr(Options, "decided", lambda *_: setup)
    comparison = sb.compare(record(), TRAIN, [sb.Single(sb.GRU(4)), sb.Mean()])
    assert {attempt.method for attempt in comparison.attempts} == {"gru"}
    assert len(comparison.runs["gru"]) > 1
    fixed = sb.compare(record(), TRAIN, [sb.Single(sb.GRU(4)), sb.Mean()], seeds=1)
    assert len(fixed.runs["gru"]) == 1


def test_the_time_of_this_machine_is_compared_with_the_reference() -> None:
    """A machine is neither a thousand times faster nor slower, and two cores do twice as much."""
    one = reference_seconds(60.0, 1)
    assert 0.06 < one < 60_000
    factors = np.log2(np.array([reference_seconds(60.0, 2) / one]))
    assert abs(factors[0] * 2 - round(factors[0] * 2)) < 1e-6


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.inf, np.nan])
def test_a_budget_is_positive(seconds: float) -> None:
    with pytest.raises(ValueError, match="core_seconds must be positive"):
        Search(seconds)


def test_what_a_network_below_costs_is_counted() -> None:
    """It is trained again in each trial of the network above it."""
    below, part = sb.Single(sb.GRU(9), replace(QUICK, epochs=50)), record()[:TRAIN]
    alone = sb.Residual(sb.Periodic(), sb.GRU(4), settings=QUICK)
    both = sb.Residual(below, sb.GRU(4), settings=QUICK)
    expected = training_cost(alone, part, ()) + training_cost(below, part, ())
    assert training_cost(both, part, ()) == pytest.approx(expected)
