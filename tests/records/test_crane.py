"""The generated crane, against what is known of a pendulum below a trolley."""

import numpy as np
import pytest

from splitband.records import named as crane
from splitband.records.named import overhead_crane


def test_a_small_swing_has_the_period_of_a_pendulum(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crane, "DAMPING", 0.0)
    monkeypatch.setattr(crane, "DRAG", 0.0)
    speed, length = np.zeros(1500), 4.0
    speed[5:10] = 0.05
    load = crane._swinging(speed, np.full(1500, length))[50:]
    load = load - load.mean()
    power = np.abs(np.fft.rfft(load * np.hanning(len(load)), 2**18))
    frequency = np.fft.rfftfreq(2**18, crane.STEP)[np.argmax(power)]
    assert frequency == pytest.approx(np.sqrt(crane.GRAVITY / length) / (2 * np.pi), rel=1e-3)


def test_the_record_goes_by_its_seed_and_its_simulator_is_right_but_for_the_swing() -> None:
    record, again, other = (overhead_crane(2000, seed=seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(record.y, again.y)
    assert np.abs(record.u - other.u).max() > 1
    assert np.std(record.y - record.y_true) == pytest.approx(0.02, rel=0.2)
    errors = record.y_true - record.y_sim
    assert np.abs(errors.mean()) < 0.1
    assert 0.5 < errors.std() < 0.25 * record.y_true.std()
