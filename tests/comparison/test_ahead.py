"""Models that are made for some samples ahead of any origin: training, scores, intervals."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy

import splitband as sb
from splitband import Record
from splitband.comparison.methods import Sizes
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.comparison.result import Comparison
from splitband.forecasters.held_out import after, forecasts, many_origins
from tests.signals import SETUP, holed, with_gaps
from tests.signals import record as short_record
from tests.support import compare

Array = npt.NDArray[np.float64]
TRAIN, SAMPLES, AHEAD = 1500, 2000, 20


def origins_in(first: int, end: int) -> list[int]:
    return [origin.at for origin in many_origins(0, first, end, AHEAD)]


def test_origins_lie_in_parts_of_their_own_and_meet_a_period_everywhere() -> None:
    """At even distances of 10 samples, they met one phase of a period of 10, 5 or 2."""
    first, end = 3000, 3999 + AHEAD
    at = np.array(origins_in(first, end))
    np.testing.assert_array_equal((at - first) * 100 // (end - AHEAD + 1 - first), np.arange(100))
    for period in (2, 5, 10, 13):
        met = np.bincount(at % period, minlength=period)
        assert met.min() > 0.6 * 100 / period
    assert origins_in(7, 7 + AHEAD + 3) == [7, 8, 9, 10]
    assert origins_in(7, 7 + AHEAD) == [7]
    assert not origins_in(7, 6 + AHEAD)


def wandering(seed: int = 0) -> Array:
    return np.asarray(np.random.default_rng(seed).standard_normal(SAMPLES).cumsum())


@cache
def judged(seed: int = 0) -> Comparison:
    y = wandering(seed)
    return sb.compare(Record(y, 1.0), TRAIN, [sb.Persistence(), sb.Mean()], ahead=AHEAD)


def test_fits_ahead_are_those_of_all_origins_by_definition() -> None:
    y, found = wandering(), judged()
    at = np.array(origins_in(TRAIN, SAMPLES))
    for column, steps in (("1", 1), ("N/10", 2), ("N", AHEAD)):
        truth = y[at + steps - 1]
        lost = np.linalg.norm(truth - y[at - 1]) / np.linalg.norm(truth - truth.mean())
        table = found.table[f"{column} ahead fit %"]
        assert table["persistence"] == pytest.approx(100 * (1 - lost))
    # Beside the simulation of all 500 samples.
    lost = np.linalg.norm(y[TRAIN:] - y[TRAIN - 1]) / np.linalg.norm(y[TRAIN:] - y[TRAIN:].mean())
    assert found.table["forecast fit %"]["persistence"] == pytest.approx(100 * (1 - lost))


def test_methods_are_chosen_by_held_out_forecasts_of_all_samples_ahead() -> None:
    """Of a random walk, the error h samples ahead of the last value has the variance h."""
    y, found = wandering(), judged()
    at = origins_in(TRAIN - 375, TRAIN)
    errors = np.concatenate([y[n : n + AHEAD] - y[n - 1] for n in at])
    score = np.sqrt(np.mean(errors**2)) / y[:TRAIN].std()
    assert found.require_trial().scores["persistence"] == pytest.approx(score)
    assert found.recommended == "persistence"
    held = [judged(seed).require_trial().errors["persistence"][0] for seed in range(6)]
    assert np.mean(np.square(held)) == pytest.approx(np.mean(np.arange(1, AHEAD + 1)), rel=0.15)


def test_the_interval_is_that_of_so_many_samples_ahead() -> None:
    found = [judged(seed) for seed in range(12)]
    inside = [each.covers("persistence") for each in found]
    assert np.mean(inside) == pytest.approx(0.9, abs=0.04)
    first = found[0]
    interval = first.require_trial().intervals["persistence"]
    # Half-widths grow as the root of the samples ahead.
    assert interval.half_widths(AHEAD)[-1, 0] == pytest.approx(1.645 * np.sqrt(AHEAD), rel=0.4)
    outside = [
        abs(wandering()[n : n + AHEAD] - wandering()[n - 1]) > interval.half_widths(AHEAD)[:, 0]
        for n in origins_in(TRAIN, SAMPLES)
    ]
    assert first.covers("persistence") == pytest.approx(1 - np.mean(outside))
    # It is none of the free run beside.
    assert first.predictions["persistence"].lower is None


def test_a_linear_model_predicts_by_its_kalman_filter() -> None:
    """Of an AR(1) process, the error h samples ahead has the variance (1 - a^2h) / (1 - a^2)."""
    a, rng = 0.9, np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], 300), 20)
    e = 0.3 * rng.standard_normal(6000)
    y = scipy.signal.lfilter([0.0, 0.5], [1, -a], u) + scipy.signal.lfilter([1.0], [1, -a], e)
    model = sb.Linear(order=1, delay=1).fit(Record(y[:3000], 1.0, u=u[:3000]))
    record = Record(y, 1.0, u=u)
    made = forecasts(model, record, many_origins(3000, 3000, 6000, 10))
    left = np.stack([y[n.at : n.at + 10] - said.y[:, 0] for n, said in made.items()])
    size = np.sqrt(np.mean(left**2, axis=0)) / 0.3
    expected = np.sqrt((1 - a ** (2 * np.arange(1, 11))) / (1 - a**2))
    np.testing.assert_allclose(size, expected, rtol=0.25)


KINDS = [
    *("persistence", "seasonal-naive", "simulator-affine", "linear", "split-gru"),
    *("residual-gru-conditioned", "filtered-gru", "residual-linear-gru-conditioned"),
]


@pytest.mark.parametrize("gaps", [(), (slice(97, 100), 117)])
@pytest.mark.parametrize("name", KINDS)
def test_forecasts_judging_are_those_that_are_asked_for_one_by_one(
    name: str, gaps: Sequence[Any]
) -> None:
    made = short_record(nu=1)
    record = with_gaps(holed(made.y, *gaps), u=made.u, y_sim=made.y_sim)
    model = SETUP.forecaster(name).fit(record[: SETUP.train])
    found = forecasts(model, record, many_origins(SETUP.train, SETUP.train, len(record), 5))
    assert len(found) == len(record) - 5 - SETUP.train + 1
    # Where a filter goes on, the initial state is not estimated anew, as in a stream.
    near = 1e-3 if "linear" in name else 1e-9
    for origin, said in found.items():
        expected = model.predict(**after(record, origin.at, 5))
        np.testing.assert_allclose(said.y, expected.y, atol=near)
        assert said.grid == expected.grid


def test_networks_are_trained_over_a_warm_up_and_the_samples_ahead() -> None:
    record = Record(wandering(), 1.0)
    usual = plan(PlanRequest(record)).settings
    made = plan(PlanRequest(record, ahead=30))
    assert (made.settings.warmup, made.settings.window) == (usual.warmup, usual.warmup + 30)
    given = plan(PlanRequest(record, ahead=30, settings={"window": 70, "epochs": 3})).settings
    assert given.window == 70
    given = plan(PlanRequest(record, ahead=30, settings={"warmup": 12})).settings
    assert (given.warmup, given.window) == (12, 42)


def test_the_median_of_networks_is_judged_ahead_on_test_records_too() -> None:
    whole = short_record(nu=1)
    test = short_record(nu=1, seed=3)
    found = compare(whole, ["gru", "mean"], SETUP, seeds=2, ahead=6, tests=[test])
    (of_test, made), (_, own) = found.judging("gru")
    assert of_test is found.tests[0]
    assert min(origin.at for origin in made) == SETUP.settings.warmup
    assert min(origin.at for origin in own) == SETUP.train
    models = [fit.fitted for fit in found.fits["gru"]]
    origin = [*made][7]
    single = [m.predict(**after(test, origin.at, 6), other_record=True).y for m in models]
    np.testing.assert_allclose(made[origin].y, np.median(single, axis=0), atol=1e-9)
    assert {"1 ahead fit % 1", "N ahead fit % 1", "N ahead fit %"} <= {*found.table.columns}
    assert "N/10 ahead fit %" not in found.table.columns  # it is 1, too


def test_the_same_rounds_give_the_same_model() -> None:
    record = Record(wandering()[:400], 1.0)
    one, other = (
        sb.compare(
            record,
            methods=["gru", "mean"],
            ahead=8,
            rounds=1,
            sizes=Sizes(hidden_low=2, hidden_high=3),
        )
        for _ in range(2)
    )
    columns = [name for name in one.table.columns if "(s)" not in name]
    assert one.table[columns].equals(other.table[columns])
    description = one.fits["gru"][0].fitted.describe()
    assert "windows of 58" in description


@pytest.mark.parametrize(
    ("asked", "rule"),
    [
        ({"ahead": 5, "horizon": 50}, r"horizon and ahead exclude .* got 50 and 5"),
        ({"ahead": 376}, "ahead must be at most 375, the samples of the held-out"),
        ({"ahead": 120, "train": 1900}, "ahead must be at most 100, the samples of the part after"),
        ({"ahead": 0}, "ahead must be"),
    ],
)
def test_what_cannot_be_is_refused_with_the_way_out(asked: dict[str, Any], rule: str) -> None:
    record = Record(wandering(), 1.0)
    with pytest.raises(ValueError, match=rule):
        sb.compare(record, **{"train": TRAIN, "methods": ["persistence"], **asked})


def test_the_largest_number_of_samples_ahead_is_one_forecast_of_all_that_is_held_out() -> None:
    found = sb.compare(Record(wandering(), 1.0), TRAIN, [sb.Persistence()], ahead=375)
    y = wandering()
    expected = np.sqrt(np.mean((y[TRAIN - 375 : TRAIN] - y[TRAIN - 376]) ** 2))
    assert found.require_trial().errors["persistence"][0] == pytest.approx(expected)


def test_a_model_keeps_what_it_was_made_for(tmp_path: Any) -> None:
    judged().model.save(tmp_path)
    model = sb.load(tmp_path)
    assert model.held_out is not None
    assert model.held_out.ahead == AHEAD
    checked = sb.check(model, Record(wandering(9), 1.0))
    assert [*checked.fits] == [
        "simulation",
        "1 sample ahead",
        "2 samples ahead",
        "20 samples ahead",
    ]
    assert [*sb.check(model, Record(wandering(9), 1.0), ahead=5).fits][1:] == [
        *("1 sample ahead", "5 samples ahead"),
    ]
