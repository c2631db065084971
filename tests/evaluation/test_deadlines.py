"""A comparison within a budget of time: there is a result whatever the deadline is."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from splitband.evaluation import candidates
from splitband.evaluation import search as searching
from splitband.evaluation.budget import Pace, TimeBudget
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import forecast
from splitband.evaluation.run import compare
from splitband.evaluation.search import Search
from splitband.evaluation.work import RunProgress, Work
from splitband.runtime.deadlines import Deadline, now
from tests.records import QUICK, SETUP, TRAIN, record
from tests.support import slowed

METHODS = ["gru", "mean", "persistence", "seasonal-naive"]
SEARCHED = replace(SETUP, settings=replace(QUICK, most_batches=2), search=Search(2.0, 1e6))


def shorten(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(candidates, "LADDER", (3,))
    patch.setattr(candidates, "FREE_RUN_FROM_LINEAR", 10)
    patch.setattr(candidates, "FIRST_STEPS", 4)
    patch.setattr("splitband.evaluation.budget.speed", lambda: 1.0)


@pytest.fixture(autouse=True)
def short_trainings(monkeypatch: pytest.MonkeyPatch) -> None:
    shorten(monkeypatch)


@pytest.fixture(scope="module")
def unhurried() -> tuple[Comparison, list[RunProgress]]:
    """A comparison with time for everything, and what it reported on the way."""
    seen: list[RunProgress] = []
    with pytest.MonkeyPatch.context() as patch:
        shorten(patch)
        work = Work(progress=seen.append)
        return compare(record(), TRAIN, METHODS, setup=SEARCHED, work=work), seen


def compared(plan: TimeBudget) -> Comparison:
    return compare(record(), TRAIN, METHODS, setup=SEARCHED, work=Work(time=plan))


@pytest.mark.parametrize("looks", [-10, 100])
def test_there_is_a_result_whatever_the_deadline(
    looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    began = clock.at
    result = compared(TimeBudget(Deadline(began + looks), began=began))
    assert {"mean", "persistence"} <= set(result.runs)
    assert result.recommended in result.runs
    assert set(result.table.index) == set(METHODS)
    missing = set(METHODS) - set(result.runs)
    notes = result.table["note"]
    assert all("time" in notes[name] or "left" in notes[name] for name in missing)
    # What follows the deadline are the forecasts of what runs then, and baselines.
    assert clock.at - began <= max(looks, 0) + 200
    if missing:
        assert not result.time.reproducible


def test_a_forecast_has_a_result_whatever_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = slowed(monkeypatch, 1.0)
    setup = replace(SEARCHED, train=TRAIN)
    for looks in (-1, 300):
        work = Work(time=TimeBudget(Deadline(clock.at + looks)))
        found = forecast(record()[:TRAIN], 10, ["gru", "mean"], setup=setup, work=work)
        assert found.method in ("gru", "mean")
        assert found.prediction.y.shape == (10, 1)


def test_networks_alone_have_a_result_however_late_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = slowed(monkeypatch, 1.0)
    plan = TimeBudget(Deadline(clock.at - 5))
    result = compare(record(), TRAIN, ["gru", "split-gru"], setup=SEARCHED, work=Work(time=plan))
    assert result.recommended == "gru"
    assert [*result.time.left_out] == ["split-gru"]


def test_where_the_clock_changes_nothing_the_work_alone_decides(
    unhurried: tuple[Comparison, list[RunProgress]],
) -> None:
    by_time, _ = unhurried
    by_work = compare(record(), TRAIN, METHODS, setup=replace(SEARCHED, search=Search(2.0)))
    assert by_time.time.reproducible
    assert not by_work.time.limited
    assert by_time.attempts == by_work.attempts
    columns = [name for name in by_work.table.columns if name != "fit (s)"]
    assert by_time.table[columns].equals(by_work.table[columns])


def test_a_slower_machine_tries_less_and_the_plan_says_so(
    unhurried: tuple[Comparison, list[RunProgress]],
) -> None:
    slow = compared(TimeBudget(Deadline.after(100.0), pace=Pace(5000.0)))
    assert not slow.time.reproducible
    assert len(slow.attempts) < len(unhurried[0].attempts)


def test_each_phase_is_timed(
    unhurried: tuple[Comparison, list[RunProgress]],
) -> None:
    time = unhurried[0].time
    assert [*time.phases] == [
        "start", "baselines", "search", "trial", "on a baseline", "final trainings"
    ]  # fmt: skip
    assert time.as_json()["left_out"] == {}


def test_the_share_that_is_done_never_falls_and_ends_near_one(
    unhurried: tuple[Comparison, list[RunProgress]],
) -> None:
    shares = [at.overall for at in unhurried[1]]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(0.95)


def test_a_budget_is_planned_on_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(searching, "reference_seconds", lambda wall, cores: wall * cores / 10)
    limit = Search.within(600.0, 2)
    assert (limit.core_seconds, limit.seconds) == (120.0, 600.0)
    with pytest.raises(ValueError, match="seconds must be positive or None, got 0"):
        Search.within(0.0)


def test_the_pace_is_learned_from_what_trainings_took() -> None:
    plan = TimeBudget(Deadline.after(100.0), cores=2)
    assert plan.work_until(plan.deadline) == pytest.approx(160.0, rel=0.01)
    plan.pace.measured(
        0.1, 5.0, forecasting=4.0
    )  # a process had to start: other trainings need not be so slow
    assert plan.pace.seconds < 2.0
    for _ in range(200):
        plan.pace.measured(2.0, 8.0, forecasting=0.1)
    assert plan.pace.seconds == pytest.approx(4.0, rel=0.02)
    assert plan.work_until(plan.deadline) == pytest.approx(40.0, rel=0.03)
    assert plan.pace.forecasting == 0.1
    assert math.isinf(TimeBudget().work_until(Deadline()))


def test_baselines_alone_have_the_time_of_the_networks() -> None:
    alone, beside = TimeBudget.of(1e4, 1), TimeBudget.of(1e4, 1)
    compare(record(), TRAIN, ["mean"], setup=SEARCHED, work=Work(time=alone))
    compare(record(), TRAIN, ["mean", "gru"], setup=SETUP, seeds=1, work=Work(time=beside))
    planned = [time.as_json()["planned_phases"]["baselines"] for time in (alone, beside)]
    assert planned[0] > 2 * planned[1]
    assert "search" not in alone.phases


def test_the_same_work_may_be_used_again() -> None:
    """Its time begins with each comparison, and not when it was made."""
    work = Work(time=TimeBudget(began=now() - 3600.0))
    assert work.limited(60.0, 1.0).deadline.left > 30
