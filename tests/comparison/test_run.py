"""Comparisons from plan to result: rounds, deadlines, interruptions, failures."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

import splitband as sb
from splitband import Record
from splitband.comparison.clock import Clock
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.comparison.result import Comparison
from splitband.comparison.run import compare, fit, run
from splitband.comparison.running import RunningComparison
from tests.signals import SETUP, TRAIN, record
from tests.support import slowed

METHODS = ["mean", "persistence", "gru", "state-space"]
RECORD = record(nu=1)
SMALL = {"settings": {"warmup": 10}, "sizes": SETUP.sizes}


pytestmark = pytest.mark.usefixtures("short_rounds")


def compared(**options: object) -> Comparison:
    given = {**SMALL, "rounds": 2} | options
    return compare(RECORD, TRAIN, METHODS, **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def whole(short_rounds: None) -> Comparison:
    return compared()


def same(one: Comparison, other: Comparison) -> None:
    assert [*one.fits] == [*other.fits]
    assert one.attempts == other.attempts
    for name, fits in one.fits.items():
        assert len(fits) == len(other.fits[name])
        for a, b in zip(fits, other.fits[name], strict=True):
            np.testing.assert_array_equal(a.ahead, b.ahead)
    assert one.recommended == other.recommended


def test_all_methods_have_a_result_and_the_best_one_a_model(whole: Comparison) -> None:
    assert {*whole.fits} == {*METHODS}
    assert whole.model.name == whole.recommended
    assert whole.model.predict(5, u=np.zeros((5, 1))).y.shape == (5, 1)
    assert {attempt.round for attempt in whole.attempts} == {1, 2}
    assert not whole.interrupted


def test_rounds_give_the_same_numbers_on_any_executor(whole: Comparison) -> None:
    # In one process and in threads, whose jobs end in another order.
    with ThreadPoolExecutor(1) as executor:
        same(whole, compared(executor=executor))


def test_rounds_are_the_same_on_any_number_of_cores() -> None:
    """On which the number of candidates that go on depends otherwise."""
    one = compare(RECORD, TRAIN, ["state-space", "mean"], rounds=4, **SMALL)  # type: ignore[arg-type]
    with ThreadPoolExecutor(1) as executor:
        several = {"cores": 4, "executor": executor, "rounds": 4, **SMALL}
        same(one, compare(RECORD, TRAIN, ["state-space", "mean"], **several))  # type: ignore[arg-type]


@pytest.mark.parametrize("looks", [-10, 40, 400])
@pytest.mark.parametrize(
    ("methods", "refit"), [(METHODS, False), (["gru"], False), (["gru", "mean"], True)]
)
def test_there_is_a_result_whatever_the_deadline(
    looks: int, methods: list[str], refit: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    planned = plan(PlanRequest(RECORD, TRAIN, methods, budget=1e6, refit=refit, **SMALL))  # type: ignore[arg-type]
    result = run(planned, clock=Clock(float(looks), clock.at))
    assert {"mean", "persistence"} & {*methods} <= {*result.fits}
    assert {*result.table.index} == {*methods}
    notes = result.table["note"]
    assert all("time" in notes[name] for name in {*methods} - {*result.fits})
    assert result.recommended in result.fits
    untrained = not {"gru", "state-space"} & {*result.fits}
    assert untrained == any("raise budget (--budget)" in note for note in result.clock.notes)
    if refit:
        refitted = len(result.model.require_fitted().record) == len(RECORD)
        assert refitted != any("could not be refitted" in note for note in result.clock.notes)


def test_what_has_settled_ends_before_its_time_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("splitband.comparison.search.SEEDS", 1)
    constant = Record(np.ones(80) + 1e-3 * np.sin(np.arange(80.0)), 0.1)
    result = compare(constant, 60, ["mean", "gru"], budget=1e5, **SMALL)  # type: ignore[arg-type]
    assert "settled" in result.clock.in_words()


def interrupted_at(doing: str) -> Callable[[RunningComparison], None]:
    def watch(run: RunningComparison) -> None:
        if run.doing.startswith(doing):
            raise KeyboardInterrupt

    return watch


@pytest.mark.parametrize("doing", ["round 1, 1", "round 2, 1", "final trainings, 1"])
def test_ctrl_c_ends_with_what_there_is(doing: str) -> None:
    result = compared(watch=interrupted_at(doing))
    assert result.interrupted
    assert {"mean", "persistence"} <= {*result.fits}
    if doing == "round 1, 1":  # what is done of its round is kept
        (attempt,) = result.attempts
        assert attempt.method in result.fits
    else:
        assert {*result.fits} == {*METHODS}
        assert any("three quarters" in note for note in result.clock.notes)
    assert result.model.predict(5, u=np.zeros((5, 1))).y.shape == (5, 1)
    assert "interrupted" in repr(result)


def test_ctrl_c_before_there_is_anything_is_an_interruption() -> None:
    with pytest.raises(KeyboardInterrupt):
        compare(RECORD, TRAIN, ["gru"], rounds=1, watch=interrupted_at("round"), **SMALL)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"budget": 0.0}, "budget must be a positive number of seconds, got 0"),
        ({"budget": 10.0, "rounds": 2}, "budget and rounds exclude each other"),
        ({"rounds": 0}, "rounds must be at least 1, got 0"),
        ({"seeds": 0}, "seeds must be at least 1, got 0"),
        ({"seed": -1}, "seed must be between 0 and .*, got -1"),
        ({"settings": {"epoch": 3}}, "settings must be out of window, .*, got epoch"),
    ],
)
def test_limits_are_checked_before_anything_runs(options: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        plan(PlanRequest(RECORD, TRAIN, METHODS, **options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("budget", "2m", "a positive number of seconds, got str '2m'"),
        ("methods", sb.Mean(), "a list of forecasters and names, got Mean"),
        ("tests", None, "a list of records, got NoneType"),
        ("others", RECORD, "a list of records, got Record"),
        ("bands", 0.1, r"sb.Bands\(cutoff=...\), got float 0.1"),
        ("also", [1], "a dictionary of lists of simulations, got list"),
    ],
)
def test_arguments_of_another_type_are_refused_by_name(name: str, value: object, said: str) -> None:
    with pytest.raises(TypeError, match=f"^{name} must be {said}"):
        compare(RECORD, TRAIN, **{"methods": METHODS, name: value})  # type: ignore[arg-type]


def test_methods_and_cores_are_checked() -> None:
    with pytest.raises(ValueError, match=r"forecasters or names .*, got 3"):
        compare(RECORD, TRAIN, [sb.Mean(), 3])  # type: ignore[list-item]
    with pytest.raises(ValueError, match="cores must be at least 1, got -1"):
        compare(RECORD, TRAIN, [sb.Mean()], cores=-1)


def test_the_next_trainings_have_begun_when_a_table_is_shown() -> None:
    submitted: list[object] = []
    counts: dict[str, int] = {}

    class Counting(ThreadPoolExecutor):
        def submit(self, *job: Any, **options: Any) -> Future[Any]:
            submitted.append(job)
            return super().submit(*job, **options)

    def watch(at: RunningComparison) -> None:
        counts.setdefault(at.doing, len(submitted))

    with Counting(2) as executor:
        running: dict[str, Any] = {"executor": executor, "cores": 2, "watch": watch}
        compare(RECORD, TRAIN, ["gru"], rounds=2, **running, **SMALL)  # type: ignore[arg-type]
    assert counts["round 1"] > counts["round 1, 1 of 1 trainings"]


def test_a_plan_is_asked_for_whatever_compare_takes() -> None:
    taken, asked = (inspect.signature(each).parameters for each in (compare, PlanRequest))
    running = {"cores", "executor", "watch"}
    assert {name: of for name, of in taken.items() if name not in running} == {**asked}


def test_a_fit_searches_and_ends_with_one_training() -> None:
    planned = plan(PlanRequest(RECORD, len(RECORD), ["gru"], horizon=0, rounds=2, **SMALL))  # type: ignore[arg-type]
    model = fit(planned)
    assert model.name == "gru"
    # Its interval is that of the search, and a copy is trained as long as all rounds together.
    assert model.held_out is not None
    assert model.settings == vars(model)["_trained_by"]
    assert len(model.require_fitted().record) == len(RECORD)


@pytest.mark.soak
def test_two_worker_processes_give_the_numbers_of_one() -> None:
    one = compare(RECORD, TRAIN, METHODS, rounds=1, **SMALL)  # type: ignore[arg-type]
    two = compare(RECORD, TRAIN, METHODS, rounds=1, cores=2, **SMALL)  # type: ignore[arg-type]
    same(one, two)


def test_a_network_on_the_best_baseline_is_tried_where_no_network_is_better() -> None:
    sine = Record(np.sin(0.3 * np.arange(160)) + 0.3 * np.sin(0.93 * np.arange(160)), 0.1)
    result = compare(sine, 120, rounds=2, **SMALL)  # type: ignore[arg-type]
    added = [name for name in result.fits if name.startswith("residual-")]
    assert added
    assert {each.round for each in result.attempts if each.method == added[0]} == {2}
    assert added[0] in result.methods
    named = compare(sine, 120, ["harmonic", "gru"], rounds=2, **SMALL)  # type: ignore[arg-type]
    assert {*named.fits} == {"harmonic", "gru"}
