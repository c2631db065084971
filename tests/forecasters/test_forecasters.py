"""What every forecaster promises, whatever it is made of."""

import copy
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import splitband as sb
from splitband import GRU, Forecaster, Record
from splitband.forecasters.prediction import median, median_components
from splitband.metrics import ExtrapolationWarning
from tests.forecasters.support import (
    BANDS,
    DT,
    MADE,
    SETTINGS,
    START,
    STEPS,
    TRAIN,
    ahead,
    fitted,
    record,
)
from tests.support import with_other_samples


@pytest.mark.parametrize("name", MADE)
def test_it_goes_on_from_the_end_of_the_training_record(name: str) -> None:
    found = fitted(name).predict(STEPS, **ahead())
    assert found.y.shape == (STEPS, 1)
    assert np.isfinite(found.y).all()
    assert (found.time == record().stamps[TRAIN : TRAIN + STEPS]).all()
    if found.components:
        np.testing.assert_allclose(sum(found.components.values()), found.y, atol=1e-12)
    again = fitted(name).predict(STEPS, record()[:TRAIN], **ahead())
    np.testing.assert_array_equal(again.y, found.y)


@pytest.mark.parametrize(
    ("name", "slow"),
    [
        ("filtered linear", "linear, low band"),
        ("residual-periodic-gru", "periodic"),
        ("residual of a residual", "residual-gru"),
        ("filtered, simulator of its own", "simulator, low band"),
        ("residual-gru-calibrated", "simulator"),
        ("residual of a network called network", "base"),
    ],
)
def test_the_slow_component_of_a_hybrid_is_labelled_by_its_base(name: str, slow: str) -> None:
    band = ", high band" if "low band" in slow else ""
    assert [*fitted(name).predict(STEPS, **ahead()).components] == [slow, f"network{band}"]


# A linear model's state is estimated from all of the history: see test_histories.
@pytest.mark.filterwarnings("ignore:harmonic disagrees")  # on the samples beyond its training
@pytest.mark.parametrize(
    "name", [n for n in MADE if "residuals of networks" not in n and "linear" not in n]
)
def test_by_its_time_stamps_it_is_known_where_a_history_lies(name: str) -> None:
    """The end of a history says what all of it does, for what needs no more than the end."""
    at, begin = TRAIN + 7, 30
    whole = fitted(name).predict(STEPS, record()[:at], **ahead(at))
    part = fitted(name).predict(STEPS, record()[begin:at], **ahead(at))
    assert (part.time == whole.time).all()
    # The spline through a calibrated simulator's output bends a little where it begins.
    np.testing.assert_allclose(part.y, whole.y, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "name",
    [
        *("mean", "seasonal-naive", "harmonic", "linear", "simulator-calibrated", "gru"),
        *("state-space", "split-gru-hp", "residual-periodic-gru", "filtered linear"),
        *("filtered, simulator of its own", "ensemble of hybrids", "networks of different sizes"),
        "ensemble of residuals of networks",
    ],
)
def test_saved_and_loaded_it_says_the_same_to_the_bit(name: str, tmp_path: Path) -> None:
    """From its own end and from another history, with its interval; and saves the same again."""
    saved = copy.copy(fitted(name))
    later = record()[20 : TRAIN + 7]

    def asked(forecaster: Forecaster) -> list[Any]:
        return [
            forecaster.predict(STEPS, **ahead(), level=0.9),
            forecaster.predict(STEPS, later, **ahead(TRAIN + 7), level=0.9),
        ]

    expected = asked(saved)
    saved.save(tmp_path / "deep" / "one")
    loaded = sb.load(tmp_path / "deep" / "one")
    assert repr(loaded) == repr(saved)
    assert (loaded.name, loaded.needs, loaded.random) == (saved.name, saved.needs, saved.random)
    assert loaded.describe() == saved.describe()
    for one, other in zip(asked(loaded), expected, strict=True):
        for what in ("y", "lower", "upper"):
            np.testing.assert_array_equal(getattr(one, what), getattr(other, what))
        assert [*one.components] == [*other.components]
        assert (one.time == other.time).all()
        assert (one.lower < one.y).all()
        assert (one.y < one.upper).all()
        assert one.level == 0.9
    loaded.save(tmp_path / "two")
    first, second = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
        for folder in ("deep/one", "two")
    )
    assert first == second
    assert len(first) == 2


def test_a_simulation_that_is_late_is_loaded_with_what_it_needs_of_the_past(tmp_path: Path) -> None:
    """A forecast begins with what the simulator said before the end of the training record."""
    simulation = sb.Calibrated(terms=("delay",)).fit(record()[:TRAIN])
    assert simulation.applied.delay
    simulation.save(tmp_path / "model")
    found = sb.load(tmp_path / "model").predict(STEPS, **ahead())
    np.testing.assert_array_equal(found.y, simulation.predict(STEPS, **ahead()).y)


@pytest.mark.parametrize("name", ["ensemble", "filtered linear", "filtered, simulator of its own"])
def test_no_forecast_depends_on_a_measured_sample_after_its_origin(name: str) -> None:
    """The names are asked the same in tests/models."""
    other = with_other_samples(record(), TRAIN)
    found = MADE[name]().fit(other[:TRAIN], seed=1)
    expected = fitted(name).predict(STEPS, **ahead()).y
    np.testing.assert_array_equal(found.predict(STEPS, **ahead()).y, expected)
    at = TRAIN + 5
    expected = fitted(name).predict(STEPS, record()[:at], **ahead(at)).y
    later = with_other_samples(record(), at)
    np.testing.assert_array_equal(found.predict(STEPS, later[:at], **ahead(at)).y, expected)


@pytest.mark.parametrize(
    "name", ["state-space", "split-gru-conditioned", "residual-euler-mlp", "ensemble"]
)
def test_a_seed_says_what_the_first_weights_are(name: str) -> None:
    """Whatever torch's own generator is at, and without moving it."""
    untrained = MADE[name]()
    torch.manual_seed(123)
    before = torch.get_rng_state()
    again = untrained.fit(record()[:TRAIN], seed=1)
    assert torch.equal(torch.get_rng_state(), before)
    other = MADE[name]().fit(record()[:TRAIN], seed=5)
    expected = fitted(name).predict(STEPS, **ahead()).y
    np.testing.assert_array_equal(again.predict(STEPS, **ahead()).y, expected)
    assert not np.array_equal(other.predict(STEPS, **ahead()).y, expected)


@pytest.mark.parametrize(
    ("options", "seeds"), [({"count": 3}, (3, 4, 5)), ({"seeds": (0, 2)}, (3, 5))]
)
def test_an_ensemble_says_the_median_of_its_members(options: Any, seeds: tuple[int, ...]) -> None:
    """Their seeds can be chosen; those of two fits share none."""
    part, single = record()[:TRAIN], sb.Single(GRU(3), SETTINGS)
    members = [single.clone().fit(part, seed=s).predict(STEPS, **ahead()).y for s in seeds]
    found = sb.Ensemble(single, **options).fit(part, seed=1).predict(STEPS, **ahead())
    np.testing.assert_allclose(found.y, np.median(members, axis=0), rtol=0, atol=1e-12)


@pytest.mark.parametrize("several", [False, True])
def test_a_simulation_that_ends_too_early_for_its_clock_is_said_to(several: bool) -> None:
    """Its clock is a twentieth too slow, and nothing is known beyond the record."""
    t = DT * np.arange(300)
    y, y_sim = np.sin(1.04 * t), np.sin(t)
    whole = Record(y, DT, y_sim=y_sim)
    model: Forecaster = sb.Filtered(
        sb.Calibrated(terms=["clock"]), GRU(3), BANDS, settings=SETTINGS
    )
    if several:
        model = sb.Ensemble(model, 2)
    model.fit(whole[:200])
    with pytest.warns(ExtrapolationWarning, match="output ends too early for its calibration"):
        found = model.predict(100, y_sim=y_sim[200:])
    (said,) = [text for text in found.warnings if "too early" in text]
    assert "clock 1.04" in said
    assert re.search(r"the last 1[0-3] of 100 samples", said)
    found = model.predict(50, y_sim=y_sim[200:])
    assert not [text for text in found.warnings if "too early" in text]


def test_a_late_simulator_runs_on_with_the_inputs_that_are_known_after_the_forecast() -> None:
    """Without them it says that its end is held."""
    u = np.sin(0.3 * np.arange(300.0))[:, None]
    whole = Record(np.roll(u, -3), DT, u=u)
    late = sb.Function(lambda time, u: u)
    model = sb.Calibrated(late, terms=["delay"]).fit(whole[:200])
    longer, found = (model.predict(steps, whole[:220], u=u[220:]) for steps in (50, 10))
    np.testing.assert_allclose(found.y, longer.y[:10], rtol=0, atol=1e-6)
    assert not found.warnings
    with pytest.warns(ExtrapolationWarning, match="for the last 3 of 10 samples"):
        model.predict(10, whole[:220], u=u[220:230])
    assert "ends too early" in str(sb.check(model, whole))


def test_the_stamps_of_another_record_are_not_compared() -> None:
    """Dates in one, seconds in the other."""
    other = replace(record()[:30], start=7.0)
    one, same = (
        fitted("gru").predict(STEPS, each, **ahead(30), other_record=True).y
        for each in (other, replace(other, start=START))
    )
    np.testing.assert_array_equal(one, same)


def test_a_table_has_a_column_of_its_own_for_the_time() -> None:
    record = sb.Record(np.arange(20.0).reshape(10, 2), 0.5, columns=("time", "time (s)"))
    table = sb.Persistence().fit(record).predict(2).to_frame()
    assert [*table] == ["time (s) (s)", *record.columns]
    np.testing.assert_array_equal(table, [[0.5, 18, 19], [1.0, 18, 19]])


def test_before_the_training_record_a_simulator_begins_with_the_history() -> None:
    """A calibration's time counts from the training record and says nothing of earlier ones."""
    t, begin = DT * np.arange(300), 40.0

    def output(time: Any) -> Any:
        return np.cos(0.3 * time)

    known = Record(output(begin + t), DT, start=begin)
    model = sb.Simulation(sb.Function(output, start="record")).fit(known)
    for start, samples in ((20.0, 100), (38.5, 40)):
        history = Record(output(start + DT * np.arange(samples)), DT, start=start)
        expected = output(start + DT * np.arange(samples, samples + STEPS))
        found = model.predict(STEPS, history).y[:, 0]
        np.testing.assert_allclose(found, expected, atol=1e-9)
    late = sb.Calibrated(sb.Function(lambda time: output(time + 0.5), start="record"), ["delay"])
    late.fit(known)
    with pytest.raises(ValueError, match="must not begin before the training record"):
        late.predict(STEPS, replace(known[:100], start=20.0))


def test_every_level_follows_from_forecasts_that_are_made_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also after loading, where the training records are not all there any more."""
    parts = record()[:TRAIN], replace(record()[TRAIN:], start=None)
    model = sb.Single(GRU(3), SETTINGS).fit(*parts, seed=0)
    fits: list[int] = []
    learn = sb.Single.learn

    def counted(self: sb.Single, *arguments: Any, **named: Any) -> None:
        fits.append(1)
        learn(self, *arguments, **named)

    monkeypatch.setattr(sb.Single, "learn", counted)
    u = ahead()["u"]
    expected = {level: model.predict(STEPS, u=u, level=level).upper for level in (0.9, 0.5)}
    model.save(tmp_path / "model")
    loaded = sb.load(tmp_path / "model")
    for level in (0.9, 0.5, 0.9, 0.7):
        model.predict(STEPS, u=u, level=level)
        loaded.predict(STEPS, u=u, level=level)
    assert len(fits) == 1
    for level, upper in expected.items():
        found = loaded.predict(STEPS, u=u, level=level)
        np.testing.assert_array_equal(found.upper, upper)
    uppers = [loaded.predict(STEPS, u=u, level=level).upper for level in (0.5, 0.7, 0.9)]
    assert (np.diff(np.array(uppers), axis=0) > 0).all()
    loaded.held_out = None  # another interval would be of the first record alone
    with pytest.raises(ValueError, match="level must be left out for a model that was saved"):
        loaded.predict(STEPS, level=0.8, u=u)


@given(count=st.integers(1, 9), seed=st.integers(0, 2**16))
def test_the_median_is_numpys_with_ties_and_odd_or_even_members(count: int, seed: int) -> None:
    values = [*np.random.default_rng(seed).integers(0, 4, (count, 6, 2)).astype(float)]
    expected = np.median(values, axis=0)
    whole = median_components([{"": each} for each in values], values)
    np.testing.assert_array_equal(whole[""], expected)
    np.testing.assert_array_equal(median(values), expected)


@given(count=st.integers(1, 6), seed=st.integers(0, 2**16))
def test_the_parts_of_the_members_in_the_middle_add_up(count: int, seed: int) -> None:
    low, high = np.random.default_rng(seed).standard_normal((2, count, 5, 1))
    members = [{"low": one, "high": other} for one, other in zip(low, high, strict=True)]
    parts = median_components(members, [*(low + high)])
    np.testing.assert_allclose(
        parts["low"] + parts["high"], np.median(low + high, axis=0), atol=1e-12
    )
