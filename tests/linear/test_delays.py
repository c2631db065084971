"""Dead time: found by the linear model, and taken out of what networks see."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.signal

import splitband as sb
from benchmarks import kinds as records
from benchmarks.linear import structure
from splitband import Record, TrainingSettings
from splitband.linear.delays import delayed, input_delays
from splitband.metrics import leaves_range, rmse
from tests.support import known_after

TRAIN, SAMPLES, DT = 600, 900, 0.02


def late(*delays: int, seed: int = 0) -> Record:
    """One pole under steps of each input, which act late, with noise of 0.01."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.standard_normal((SAMPLES // 10, len(delays))), 10, axis=0)
    y = sum(
        scipy.signal.lfilter([0.0] * delay + [0.05 * (i + 1)], [1, -0.95], u[:, i])
        for i, delay in enumerate(delays)
    )
    noise = 0.01 * rng.standard_normal(SAMPLES)
    return Record(np.asarray(y) + noise, DT, u=u, y_true=np.asarray(y))


@pytest.fixture(scope="module")
def model() -> sb.Linear:
    return sb.Linear().fit(late(20)[:TRAIN])


def test_a_late_input_costs_no_accuracy(model: sb.Linear) -> None:
    """As little noise is left as with an input that acts at once."""
    record: Any = late(20)
    y = model.predict(SAMPLES - TRAIN, u=record.u[TRAIN:]).y
    assert model.delays == (20,)
    assert "dead time u 19 samples (0.38 s; its impulse response begins at sample 20)" in (
        model.describe()
    )
    assert rmse(np.asarray(y), record.truth[TRAIN:]) < 2e-3


def test_a_dead_time_is_that_of_the_continuous_plant() -> None:
    """SciPy samples 1 / (s + 1) with the input held; a dead time of 30 samples is put before it."""
    plant = tuple(np.array([[x]]) for x in (-1.0, 1.0, 1.0, 0.0))
    a, b, *_ = scipy.signal.cont2discrete(plant, DT)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    u = np.repeat(rng.standard_normal(SAMPLES // 10), 10)
    late = np.append(np.zeros(30), u[:-30])
    y = scipy.signal.lfilter([0.0, b[0, 0]], [1.0, -a[0, 0]], late)
    model = sb.Linear().fit(Record(y + 0.01 * y.std() * rng.standard_normal(SAMPLES), DT, u=u))
    assert "dead time u 30 samples (0.6 s;" in model.describe()
    _, (response,) = scipy.signal.dimpulse(model.state_space(), n=40)  # type: ignore[arg-type]
    assert np.flatnonzero(abs(response) > 1e-9)[0] == model.delays[0] == 31


def test_a_delay_is_found_although_the_state_at_the_beginning_is_forgotten_within_it() -> None:
    """The input was at rest before the record, and at another value from its first sample on."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(SAMPLES // 10), 10)
    y = scipy.signal.lfilter([0.0] * 40 + [0.3], [1, -0.9], u)
    record = Record(y + 0.01 * rng.standard_normal(SAMPLES), DT, u=u)
    model = sb.Linear().fit(record[:TRAIN])
    assert model.delays == (40,)
    ahead = model.predict(SAMPLES - TRAIN, u=u[TRAIN:]).y
    assert rmse(np.asarray(ahead), y[TRAIN:, None]) < 2e-3


def test_before_the_delayed_inputs_a_fast_system_is_where_it_usually_is() -> None:
    """What it has forgotten by then, the record does not show; a network is trained on the rest."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(400)
    y = scipy.signal.lfilter([0.0] * 21 + [1.0], [1, -0.3], u) + 0.1 * rng.standard_normal(400)
    record = Record(y, DT, u=u)
    model = sb.Linear().fit(record[:300])
    assert model.delays == (21,)
    for first in (True, False):
        simulated = model.on(record[:300], first).y_sim
        assert leaves_range(record.y, simulated) is None
        assert rmse(simulated[21:], record.y[21:300]) < 0.12


def test_each_input_has_a_delay_of_its_own() -> None:
    model = sb.Linear().fit(late(0, 25))
    assert model.delays == (0, 25)
    assert "dead time u1 24 samples" in model.describe()


@pytest.mark.parametrize("make", [*records.WITH_INPUTS.values(), records.tanks_and_cycle])
def test_a_record_without_dead_time_has_none(make: Any) -> None:
    record = make(np.random.default_rng(0))[:1200]
    assert input_delays([(record.y_with_gaps, record.u)]) == (0,)


def test_a_delay_is_found_from_several_records_and_beside_gaps() -> None:
    one: Any = late(15)[:300]
    other: Any = late(15, seed=1)[:300]
    seen = other.y_with_gaps.copy()
    seen[50:80] = np.nan
    assert input_delays([(one.y_with_gaps, one.u), (seen, other.u)]) == (15,)


def test_a_delay_that_a_larger_model_needs_no_more_is_not_taken() -> None:
    """Lightly damped modes correlate most after some samples; each output then had its own model.

    The outputs without noise are those of `scipy.signal.dlsim`.
    """
    u, y = structure(3, 4000, hardens=0.3)
    noise = 0.01 * y.std(axis=0) * np.random.default_rng(1).standard_normal(y.shape)
    model = sb.Linear().fit(Record(y + noise, 1.0, u=u))
    assert model.delays == (0, 0, 0)
    assert "samples of u2 predicts held-out samples no better: none is taken" in model.describe()
    v, x = structure(4, 2000, hardens=0.3)
    history = Record(x[:500], 1.0, u=v[:500])
    ahead = model.predict(1500, history, u=v[500:], other_record=True).y
    assert np.min(sb.fit_percent(x[500:], ahead)) > 90


def test_an_input_that_moves_once_shows_no_delay() -> None:
    """A friction makes the answer to each step late by chance; a given delay is taken."""
    u = np.where(np.arange(1200) < 500, 1.0, 1.5)
    y = scipy.signal.lfilter([0.0] * 40 + [0.05], [1, -0.95], u)
    record = Record(y + 0.01 * np.random.default_rng(0).standard_normal(1200), DT, u=u)
    model = sb.Linear().fit(record)
    assert model.delays == (0,)
    assert "u moves too rarely to show its delay: Linear(delay=) sets one" in model.describe()
    given = sb.Linear(delay=40).fit(record)
    assert given.delays == (40,)
    assert "too rarely" not in given.describe()
    ahead = given.predict(300, u=np.full(300, 1.5)).y
    np.testing.assert_allclose(ahead, 1.5, atol=0.02)


@pytest.mark.parametrize("samples", [2, 5, 30])
def test_of_a_short_record_no_delay_is_asked(samples: int) -> None:
    record = late(8)[:samples]
    assert sb.Linear().fit(record).delays == (0,)


def test_inputs_are_shifted_and_the_first_value_held() -> None:
    u = np.arange(8.0).reshape(4, 2)
    np.testing.assert_array_equal(delayed(u, (0, 2)), [[0, 1], [2, 1], [4, 1], [6, 3]])


def test_a_network_sees_what_acts_late_when_it_acts(tmp_path: Path) -> None:
    """As one that is given the shifted input, and saved it does the same."""
    record: Any = late(20)
    model = sb.Single(sb.GRU(3), TrainingSettings.paper(60, 10, 1)).fit(record[:TRAIN], seed=1)
    assert model.delays == (20,)
    assert "dead time u 19 samples" in model.describe()
    shifted = Record(record.y, DT, u=delayed(record.u, (20,)))
    by_hand = sb.Single(sb.GRU(3), TrainingSettings.paper(60, 10, 1)).fit(shifted[:TRAIN], seed=1)
    assert by_hand.delays == (0,)
    y = model.predict(50, u=record.u[TRAIN:]).y
    np.testing.assert_array_equal(y, by_hand.predict(50, **known_after(shifted, TRAIN)).y)
    at = TRAIN + 9
    np.testing.assert_array_equal(
        model.predict(50, record[:at], **known_after(record, at)).y,
        by_hand.predict(50, shifted[:at], **known_after(shifted, at)).y,
    )
    model.save(tmp_path / "model")
    loaded = sb.load(tmp_path / "model")
    np.testing.assert_array_equal(loaded.predict(50, u=record.u[TRAIN : TRAIN + 50]).y, y)
    assert loaded.describe() == model.describe()


def test_no_output_depends_on_a_later_input(model: sb.Linear) -> None:
    record: Any = late(20)
    u = record.u[TRAIN:].copy()
    expected = np.asarray(model.predict(100, record[:TRAIN], u=u).y)
    u[50:] *= -0.5
    found = np.asarray(model.predict(100, record[:TRAIN], u=u).y)
    np.testing.assert_array_equal(found[:70], expected[:70])
    assert (found[71:] != expected[71:]).all()


def test_a_delay_has_a_standard_error_and_an_input_without_one_has_none() -> None:
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((1500, 2)), np.zeros(1500)
    for n in range(7, 1500):
        y[n] = 0.8 * y[n - 1] + u[n - 7, 0] + u[n - 1, 1]
    record = sb.Record(y + 0.3 * rng.standard_normal(1500), 0.1, u=u)
    model = sb.Linear(order=1).fit(record)
    errors = model.uncertainty().delay_errors
    assert errors.shape == (1, 2)
    assert 0 < errors[0, 0] < 0.2
    assert errors[0, 1] == 0
