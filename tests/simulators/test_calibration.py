"""Calibration: known gains, offsets, delays and clocks are found, and nothing is made up."""

import warnings
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from splitband import Record
from splitband.comparison.methods import named
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.forecasters.base import Forecaster
from splitband.forecasters.hybrid import Filtered, Residual
from splitband.forecasters.simulation import Calibrated
from splitband.metrics import ExtrapolationWarning, rmse
from splitband.records import drill_string
from splitband.records.named import van_der_pol
from splitband.simulators import Recorded
from splitband.simulators.calibration import (
    TERMS,
    Calibration,
    Term,
    affine_fit,
    calibrate,
    samples_needed,
)
from tests.signals import holed

Array = npt.NDArray[np.float64]
SAMPLES, TRAIN, DT = 800, 400, 0.05
NEEDED = samples_needed(SAMPLES, TRAIN)
NOISE = 0.05
GAIN, OFFSET = (1.7, -0.6), (0.4, -2.0)
WITHIN = {"gain": 0.02, "offset": 0.02, "delay": 0.005, "clock": 5e-4}


def signal(time: Array, ny: int = 1) -> Array:
    """Two sines of incommensurate frequencies in each channel, `(time, ny)`."""
    phases = np.arange(ny)
    slow = np.sin(2 * np.pi * 0.31 * time[:, None] + phases)
    return np.asarray(slow + 0.5 * np.sin(2 * np.pi * 0.31 * 7**0.5 * time[:, None] + 2 * phases))


def simulation(samples: int = NEEDED, ny: int = 1) -> Array:
    return signal(DT * np.arange(samples, dtype=np.float64), ny)


def measured(
    ny: int = 1,
    gain: tuple[float, ...] = (),
    offset: tuple[float, ...] = (),
    delay: float = 0.0,
    clock: float = 1.0,
    seed: int = 1,
) -> Array:
    """A record of what the simulator is off by so much; it stands still before its time 0."""
    time = clock * DT * np.arange(SAMPLES, dtype=np.float64) - delay
    y = np.array(gain or 1.0) * signal(np.maximum(time, 0.0), ny) + np.array(offset or 0.0)
    return np.asarray(y + NOISE * np.random.default_rng(seed).standard_normal(y.shape))


def record(y: Array, y_sim: Array) -> Record:
    return Record(y, DT, y_sim=y_sim)


def test_a_constant_simulator_is_fitted_by_the_mean() -> None:
    y = np.random.default_rng(2).standard_normal((40, 1))
    gain, offset = affine_fit(np.full((40, 1), 7.0), y)
    assert gain == [0.0]
    np.testing.assert_allclose(offset, y.mean(axis=0))


# ---------------------------------------------------------------- what is found


@pytest.mark.parametrize(
    ("term", "value", "ny"),
    [("gain", GAIN, 2), ("offset", OFFSET, 1), ("delay", -0.6, 2), ("clock", 1.03, 1)],
)
def test_one_term_is_found_and_the_others_are_left_alone(term: Any, value: Any, ny: int) -> None:
    true = value[:ny] if isinstance(value, tuple) else value
    off: dict[str, Any] = {term: true}
    y = measured(ny, **off)
    found = calibrate(simulation(ny=ny), y[:TRAIN], DT, terms=[term])
    assert getattr(found, term) == pytest.approx(true, abs=WITHIN[term])
    for other in set(TERMS) - {term}:
        assert getattr(found, other) == getattr(Calibration(), other)


@pytest.mark.parametrize(
    ("delay", "clock", "ny"), [(0.6, 1.0, 1), (0.0, 0.97, 2), (0.6, 1.03, 1), (-0.6, 0.97, 1)]
)
def test_the_terms_that_pay_are_found_together(delay: float, clock: float, ny: int) -> None:
    y = measured(ny, GAIN[:ny], OFFSET[:ny], delay, clock)
    found = calibrate(simulation(ny=ny), y[:TRAIN], DT)
    assert found.gain == pytest.approx(GAIN[:ny], abs=WITHIN["gain"])
    assert found.offset == pytest.approx(OFFSET[:ny], abs=WITHIN["offset"])
    assert found.delay == pytest.approx(delay, abs=WITHIN["delay"])
    assert found.clock == pytest.approx(clock, abs=WITHIN["clock"])
    assert (found.delay == 0, found.clock == 1) == (delay == 0, clock == 1)
    left = (y - found.apply(simulation(ny=ny), SAMPLES, DT))[TRAIN:]
    assert np.std(left, axis=0) == pytest.approx([NOISE] * ny, rel=0.15)


def test_noise_above_the_band_of_a_hybrid_does_not_change_its_gain() -> None:
    y = measured(gain=(1.7,))
    fast = np.diff(np.random.default_rng(3).standard_normal((SAMPLES + 1, 1)), axis=0)
    noisy = Record(y, DT, y_sim=simulation(SAMPLES) + 0.5 * fast)
    whole, below = (Calibrated(terms=["gain"], below=f).fit(noisy).applied for f in (None, 1.0))
    assert whole.gain is not None
    assert whole.gain[0] < 1.0  # least squares with an uncertain regressor
    assert below.gain == pytest.approx([1.7], rel=0.05)
    (planned,) = plan(PlanRequest(noisy, TRAIN, "filtered-gru-calibrated")).methods
    assert planned.get_params()["base"].below == planned.get_params()["bands"].cutoff


def test_a_perfect_simulator_is_left_as_it_comes() -> None:
    exact = calibrate(simulation(), simulation()[:TRAIN], DT)
    assert str(exact) == "unmodified"
    for seed in range(2):
        noisy = calibrate(simulation(), measured(seed=seed)[:TRAIN], DT)
        assert str(noisy) == "unmodified"


def test_unrelated_noise_gets_no_delay_and_no_clock() -> None:
    rng = np.random.default_rng(0)
    y_sim, y = rng.standard_normal((NEEDED, 1)), rng.standard_normal((TRAIN, 1))
    found = calibrate(y_sim, y, DT)
    assert (found.delay, found.clock) == (0.0, 1.0)


def test_calibration_brings_the_simulator_of_system_v_closer() -> None:
    """The figures of docs/theory/simulators.md and the changelog."""
    r = van_der_pol()
    model = Calibrated().fit(r[:600])
    with pytest.warns(ExtrapolationWarning, match="for the last 4 of 1400 samples"):
        found = model.predict(1400, y_sim=r.y_sim[600:])
    assert rmse(r.y[600:], found.y) == pytest.approx(0.264, abs=5e-4)


@pytest.mark.usefixtures("public_data")
def test_the_simulator_of_the_drill_string_keeps_its_clock() -> None:
    """It comes a tenth of a second late, that is all."""
    r = drill_string()
    assert r.y_sim is not None
    found = calibrate(r.y_sim, r.y[:2000], r.sampling_time)
    assert found.clock == 1.0
    raw, calibrated = r.y_sim[2000:], found.apply(r.y_sim, len(r), r.sampling_time)[2000:]
    assert rmse(r.y[2000:], calibrated) < 0.7 * rmse(r.y[2000:], raw)


# ---------------------------------------------------------------- what may be known


def seen_by(simulation: Forecaster, r: Record) -> tuple[Record, Calibration]:
    """The record with the simulator fitted to its training part, and the calibration."""
    simulation.fit(r[:TRAIN])
    return simulation.on(r), simulation.calibration or Calibration()


def test_samples_after_the_training_part_do_not_change_a_calibration() -> None:
    y = measured(1, GAIN[:1], OFFSET[:1], -0.6, 0.97)
    altered = y.copy()
    altered[TRAIN:] = 25.0
    (expected_record, expected), (found_record, found) = (
        seen_by(Calibrated(), record(values, simulation())) for values in (y, altered)
    )
    assert expected == found
    assert expected_record.y_sim is not None
    np.testing.assert_array_equal(found_record.y_sim, expected_record.y_sim)
    np.testing.assert_array_equal(found_record.y, altered)
    np.testing.assert_allclose(
        expected_record.y_sim, expected.apply(simulation(), SAMPLES, DT), atol=1e-12
    )


def test_only_calibrated_methods_see_another_simulator() -> None:
    r = record(measured(1, GAIN[:1]), simulation())
    for method, gain in (("filtered-gru-conditioned", ()), ("residual-gru-calibrated", GAIN[:1])):
        network = named(method)
        assert isinstance(network, Filtered | Residual)
        changed, found = seen_by(network.base, r)
        assert changed.y_sim is not None
        assert found.gain == pytest.approx(gain, abs=WITHIN["gain"])
        expected = signal(r.time) * np.array(found.gain or 1.0) + (found.offset or 0)
        np.testing.assert_allclose(changed.y_sim, expected)


@pytest.mark.parametrize(
    ("delay", "clock", "recorded", "spare"),
    [(-0.6, 1.0, False, 0), (0.0, 1.03, True, 5), (-0.3, 1.01, True, 0), (0.3, 1.01, False, 5)],
)
def test_a_simulation_that_ends_with_the_record_is_calibrated_all_the_same(
    delay: float, clock: float, recorded: bool, spare: int
) -> None:
    """Most exported ones do; what it does not reach is held, and said."""
    y, y_sim = measured(1, (), (), delay, clock), simulation(SAMPLES + spare)
    simulator = Recorded(y_sim, DT) if recorded else None
    model = Calibrated(simulator)
    model.fit((Record(y, DT) if recorded else record(y, y_sim))[:TRAIN])
    found = model.applied
    assert found.delay == pytest.approx(delay, abs=WITHIN["delay"])
    assert found.clock == pytest.approx(clock, abs=WITHIN["clock"])
    missing = int((found.positions(SAMPLES, DT) > SAMPLES + spare - 0.5).sum())
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        prediction = model.predict(SAMPLES - TRAIN, y_sim=y_sim[TRAIN:])
    said = [str(w.message) for w in caught]
    assert len(said) == (1 if missing else 0)
    assert not missing or f"for the last {missing} of {SAMPLES - TRAIN} samples" in said[0]
    left = (prediction.y - y[TRAIN:])[: SAMPLES - TRAIN - missing]
    assert np.std(left) == pytest.approx(NOISE, rel=0.15)


@pytest.mark.parametrize(
    ("delay", "clock"),
    [(0.0, 1.0), (0.12, 1.0), (-0.33, 1.02), (0.4, 0.97)],
)
def test_a_part_of_a_record_is_calibrated_as_in_the_whole(delay: float, clock: float) -> None:
    """Time counts from the origin, wherever the part and its simulation begin."""
    y_sim, found = simulation(2 * SAMPLES), Calibration(delay=delay, clock=clock)
    whole, begin = found.apply(y_sim, SAMPLES, DT), 25
    np.testing.assert_array_equal(found.apply(y_sim, 60, DT, begin), whole[begin : begin + 60])
    positions = found.positions(60, DT, begin)
    first, last = int(positions[0]), int(np.ceil(positions[-1] - 1e-9))
    # A spline through a few samples more, as its ends are bent otherwise.
    near = slice(max(first - 10, 0), last + 11)
    part = found.apply(y_sim[near], 60, DT, begin, near.start)
    np.testing.assert_allclose(part, whole[begin : begin + 60], atol=1e-5)


# ---------------------------------------------------------------- around gaps


@pytest.mark.parametrize("terms", [["gain"], ["offset"], ["gain", "offset"]])
def test_a_simulator_is_calibrated_by_the_measured_samples_alone(terms: list[Term]) -> None:
    rng = np.random.default_rng(5)
    y_sim, y = rng.standard_normal((2, 200, 2))
    y = holed(holed(y, slice(50, 90)), slice(120, 160), channel=1)
    found = calibrate(y_sim, y, DT, terms=terms)
    for channel in range(2):
        rows = ~np.isnan(y[:, channel])
        basis = np.stack([y_sim[rows, channel], np.ones(rows.sum())], axis=1)
        wanted = y[rows, channel]
        if terms == ["offset"]:
            wanted = wanted - basis[:, 0]
        kept = [("gain", "offset").index(term) for term in terms]
        expected = np.linalg.lstsq(basis[:, kept], wanted, rcond=None)[0]
        given = [getattr(found, term)[channel] for term in terms]
        np.testing.assert_allclose(given, expected, rtol=1e-9)


@pytest.mark.parametrize("rows", [slice(790, None), slice(20, None), slice(980)])
def test_a_channel_that_is_hardly_measured_does_not_spoil_the_calibration(rows: slice) -> None:
    time = np.arange(1000)
    y_sim = np.stack([np.sin(time / 20), np.cos(time / 17)], axis=1)
    late = np.stack([np.sin((time - 3) / 20), np.cos((time - 3) / 17)], axis=1)
    noise = np.random.default_rng(0).standard_normal((1000, 2))
    y = holed(2 * late + 0.5 + 0.05 * noise, rows, channel=1)
    found = calibrate(y_sim, y, DT)
    assert found.gain[0] == pytest.approx(2, rel=0.02)
    assert found.offset[0] == pytest.approx(0.5, abs=0.02)
    assert found.delay == pytest.approx(3 * DT, rel=0.1)


# ---------------------------------------------------------------- applying


@pytest.mark.parametrize(("delay", "clock"), [(-0.23, 1.0), (0.0, 1.04), (0.5, 0.97)])
def test_a_calibrated_ramp_is_a_ramp_that_stands_still_at_the_simulations_ends(
    delay: float, clock: float
) -> None:
    ramp = (DT * np.arange(SAMPLES))[:, None] * [1.0, -3.0]
    found = Calibration((2.0, 0.5), (1.0, -4.0), delay, clock).apply(ramp, SAMPLES, DT)
    time = np.clip(clock * DT * np.arange(SAMPLES) - delay, 0, DT * (SAMPLES - 1))
    expected = np.stack([2 * time + 1, -1.5 * time - 4], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda y, y_sim: calibrate(y_sim, y, DT, terms=["speed"]),  # type: ignore[list-item]
            "terms must be out of gain, offset, delay, clock, got speed",
        ),
        (lambda y, y_sim: calibrate(y_sim[:399], y[:400], DT), r"400 samples .* got \(399, 1\)"),
        (
            lambda y, y_sim: calibrate(y_sim, holed(y[:9], slice(1, None)), DT),
            "y have 2 samples at least, got .* of which 1 were measured",
        ),
        (lambda y, y_sim: Calibration().apply(y_sim[:10], 11, DT), "y_sim must have 11 .* got 10"),
    ],
)
def test_errors_name_the_rule_and_the_value(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call(measured(), simulation())
