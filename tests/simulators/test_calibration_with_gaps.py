"""Calibration of a simulator by what was measured."""

import numpy as np
import numpy.typing as npt
import pytest

from splitband.simulators.calibration import Term, calibrate
from tests.records import DT, holed

Array = npt.NDArray[np.float64]


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


def test_delay_and_clock_are_found_around_gaps() -> None:
    def signal(time: Array) -> Array:
        return np.sin(2 * np.pi * time / 83) + 0.5 * np.sin(2 * np.pi * time / 31 + 1)

    n: Array = np.arange(1000, dtype=np.float64)
    y_sim = signal(n)[:, None]
    y = 2 * signal(1.01 * n[:600] - 7.3)[:, None] + 0.5
    found = calibrate(y_sim, holed(y, slice(100, 180), slice(400, 450)), DT)
    assert found.gain == pytest.approx((2.0,), rel=1e-3)
    assert found.offset == pytest.approx((0.5,), abs=1e-3)
    assert found.delay == pytest.approx(7.3 * DT, rel=1e-2)
    assert found.clock == pytest.approx(1.01, rel=1e-4)


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


def test_a_calibration_needs_two_measured_samples() -> None:
    y = holed(np.ones((9, 1)), slice(1, None))
    with pytest.raises(ValueError, match="2 samples at least"):
        calibrate(np.ones((9, 1)), y, DT)
