"""The time of a comparison is kept whatever is fitted, and networks do not wait for baselines."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from threading import Event
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband import Forecaster
from splitband.comparison.clock import MOST_OF_BASELINE, Clock
from splitband.comparison.jobs import late
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.comparison.run import compare, run
from splitband.comparison.running import RunningComparison
from splitband.forecasters.prediction import ForecastContext
from splitband.runtime.deadlines import current, now
from tests.signals import SETUP, TRAIN, record
from tests.support import slowed

RECORD = record(nu=1)
SMALL: dict[str, Any] = {"settings": {"warmup": 10}, "sizes": SETUP.sizes}
RELEASED = Event()


pytestmark = pytest.mark.usefixtures("short_rounds")


class Baseline(Forecaster):
    """A baseline of a user, which forecasts zeros."""

    def extrapolate(self, known: ForecastContext) -> np.ndarray:
        return np.zeros((known.steps, known.y.shape[1]))


class Endless(Baseline):
    """Its fit looks at no clock, and ends when the test does."""

    name = "endless"

    def learn(self, records: object, **_: object) -> None:
        RELEASED.wait()


class Asleep(Baseline):
    """Its fit looks at no clock, and takes far longer than any test."""

    name = "asleep"

    def learn(self, records: object, **_: object) -> None:
        time.sleep(600)


class Patient(Baseline):
    """Its fit goes on until its deadline, but for a number of steps at most."""

    name = "patient"
    most = 10_000

    def learn(self, records: object, **_: object) -> None:
        self.steps = 0
        while self.steps < self.most and not current().over:
            self.steps += 1


class Identified(Baseline):
    """Its fit is that of a simulator, and takes all of the time that it may."""

    name, fits_simulator = "identified", True

    def learn(self, records: object, **_: object) -> None:
        while not current().over:
            pass


class Trained(Baseline):
    """Its simulator has an unknown term, whose training took 400 s."""

    name, fits_simulator = "trained", True

    def learn(self, records: object, **_: object) -> None:
        self.fitted = self.require_fitted().reporting(seconds=400.0)


@pytest.mark.parametrize(("limit", "whole"), [(500.0, False), (1000.0, True)])
def test_a_simulator_keeps_what_it_had_time_for(limit: float, whole: bool) -> None:
    planned = plan(PlanRequest(RECORD, TRAIN, [Trained(), "mean"], budget=1e6))
    result = run(planned, clock=Clock(limit, now()))
    assert (len(result.fits["trained"][0].fitted.require_fitted().record) == TRAIN) == whole
    assert bool(result.clock.notes) != whole


def test_what_is_quick_is_fitted_before_a_simulator(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = slowed(monkeypatch, 1.0)
    planned = plan(PlanRequest(RECORD, TRAIN, [Identified(), Patient(), "mean"], budget=1e6))
    result = run(planned, clock=Clock(1000.0, clock.at))
    assert vars(result.fits["patient"][0].fitted)["steps"] > 0


@pytest.mark.parametrize("limit", [2000.0, 3000.0])
def test_time_that_is_left_after_a_round_that_was_cut_is_used(
    limit: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    planned = plan(PlanRequest(RECORD, TRAIN, ["gru"], budget=1e6, settings={"warmup": 10}))
    result = run(planned, clock=Clock(limit, clock.at))
    assert 0.9 < result.clock.used / limit < 1.0
    assert not result.clock.settled


def test_linear_is_fitted_though_the_start_took_the_time() -> None:
    """A worker process would begin as slowly as this one did."""
    planned = plan(PlanRequest(RECORD, TRAIN, ["linear", "mean", "gru"], budget=5.0, **SMALL))
    result = run(planned, cores=2, clock=Clock(5.0, now() - 6.0))
    assert {*result.fits} == {"linear", "mean"}
    (_, said) = result.clock.notes
    assert said.startswith("no network was trained in the time: ")
    assert result.clock.in_words().startswith("time: ")
    assert "of 5 s, 0 s of training on 2 cores; start 6 s" in result.clock.in_words()


def test_networks_have_their_rounds_while_a_baseline_never_ends() -> None:
    seen = dict[str, set[str]]()

    def watch(state: RunningComparison) -> None:
        if state.new_table:
            seen.setdefault(state.doing, {*state.trials})

    with ThreadPoolExecutor(2) as executor:
        try:
            how: dict[str, Any] = {"cores": 2, "executor": executor, "watch": watch, **SMALL}
            result = compare(RECORD, TRAIN, [Endless(), "mean", "gru"], budget=6.0, **how)
        finally:
            RELEASED.set()
    assert seen["baselines"] == {"mean"}
    assert seen["round 1"] == {"mean", "gru"}
    assert {*result.fits} == {"mean", "gru"}
    assert result.trial is not None
    assert result.trial.failed == {"endless": late("endless").failure}
    assert "time" in result.table["note"]["endless"]
    assert result.clock.used < 30


def test_a_process_is_ended_with_the_baseline_that_it_fits() -> None:
    result = compare(RECORD, TRAIN, [Asleep(), "mean"], cores=2, budget=4.0)
    assert {*result.fits} == {"mean"}
    assert result.trial is not None
    assert result.trial.failed == {"asleep": late("asleep").failure}
    assert result.clock.used < 40


def test_a_baseline_has_a_part_of_the_time_where_there_is_one_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each look at the clock takes a second."""
    clock = slowed(monkeypatch, 1.0)
    planned = plan(PlanRequest(RECORD, TRAIN, [Patient(), "mean", "gru"], budget=1e6, **SMALL))
    result = run(planned, clock=Clock(1000.0, clock.at))
    assert {*result.fits} == {"patient", "mean", "gru"}
    assert vars(result.fits["patient"][0].fitted)["steps"] <= MOST_OF_BASELINE
    assert result.attempts
    assert not any("patient" in note for note in result.clock.notes)


def test_a_fit_that_would_take_too_long_again_is_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitband.comparison.clock.MOST_OF_BASELINE", 1e6)
    monkeypatch.setattr("splitband.comparison.clock.MOST_OF_TIME_LEFT", 0.9)
    clock = slowed(monkeypatch, 1.0)
    planned = plan(PlanRequest(RECORD, TRAIN, [Patient(), "mean"], budget=1e6, **SMALL))
    result = run(planned, clock=Clock(300.0, clock.at))
    assert len(result.fits["patient"][0].fitted.require_fitted().record) < TRAIN
    (note,) = result.clock.notes
    assert note.startswith("patient: could not be fitted to the whole training part in time")


def test_a_fit_that_fits_into_the_time_left_is_made_beside_networks_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("splitband.comparison.clock.MOST_OF_BASELINE", 110.0)
    clock = slowed(monkeypatch, 1.0)
    planned = plan(PlanRequest(RECORD, TRAIN, [Patient(), "mean", "gru"], budget=1e6, **SMALL))
    result = run(planned, clock=Clock(300.0, clock.at))
    assert len(result.fits["patient"][0].fitted.require_fitted().record) == TRAIN
    assert not any("patient" in note for note in result.clock.notes)


def test_counted_rounds_limit_no_baseline_and_wait_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Forecaster | str] = [Patient(), "harmonic", "mean", "gru"]
    one = compare(RECORD, TRAIN, asked, rounds=2, **SMALL)
    with ThreadPoolExecutor(2) as executor:
        other = compare(RECORD, TRAIN, asked, rounds=2, cores=2, executor=executor, **SMALL)
    for result in (one, other):
        assert vars(result.fits["patient"][0].fitted)["steps"] == Patient.most
    assert [*one.fits] == [*other.fits]
    assert one.attempts == other.attempts
    assert one.trial is not None
    assert other.trial is not None
    assert [*one.trial.scores.items()] == [*other.trial.scores.items()]


def test_a_method_that_other_processes_cannot_import_is_fitted_here() -> None:
    class Own(Baseline):
        name = "own"

    result = compare(RECORD, TRAIN, [Own(), sb.Mean()], cores=2)
    assert {*result.fits} == {"own", "mean"}
