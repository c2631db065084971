"""Bands around forecasts: what they hold, and how they grow."""

from dataclasses import asdict
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from splitband.bands import EXPECTED_GROWTH, Band

Array = npt.NDArray[np.float64]
RECORD = np.random.default_rng(0).standard_normal((2000, 1)) * 50


def errors(samples: int, growth: float, seed: int, scale: float = 1.0) -> Array:
    """Independent errors whose deviation is scale * sqrt(1 + (growth n)²)."""
    horizon = np.arange(samples)
    size = scale * np.hypot(1.0, growth * horizon)
    return (np.random.default_rng(seed).standard_normal(samples) * size)[:, None]


@pytest.mark.parametrize("share", [0.5, 0.9])
@pytest.mark.parametrize("growth", [0.001, 0.02])
def test_a_band_holds_its_share_of_errors_like_those_it_was_fitted_to(
    growth: float, share: float
) -> None:
    found = [
        Band.fit([errors(500, growth, seed)], RECORD, share).coverage(
            errors(500, growth, 100 + seed)
        )
        for seed in range(10)
    ]
    assert np.mean(found) == pytest.approx(share, abs=0.05)


def test_several_forecasts_count_each_from_its_own_beginning() -> None:
    """Errors that restart with each forecast: taken for one long forecast they would not grow."""
    parts = [errors(170, 0.02, seed) for seed in range(12)]
    band, glued = Band.fit(parts, RECORD), Band.fit([np.concatenate(parts)], RECORD)
    expected = np.hypot(1, 0.02 * 1000)
    assert band.half_widths(1001)[-1, 0] / band.base[0] == pytest.approx(expected, rel=0.3)
    assert glued.half_widths(1001)[-1, 0] / glued.base[0] < 0.5 * expected


def test_a_band_goes_on_growing_beyond_the_held_out_part() -> None:
    held = [Band.fit([errors(500, 0.02, seed)], RECORD) for seed in range(10)]
    beyond = [
        (abs(errors(1500, 0.02, 100 + i)) <= band.half_widths(1500))[500:].mean()
        for i, band in enumerate(held)
    ]
    assert np.mean(beyond) == pytest.approx(0.9, abs=0.06)


def test_it_widens_and_never_beyond_what_the_records_range_says() -> None:
    band = Band.fit([errors(400, 0.5, 1)], RECORD)
    widths = band.half_widths(100_000)[:, 0]
    assert (np.diff(widths) >= 0).all()
    # Two independent Gaussians of the record's deviation: nine tenths of their differences.
    apart = np.quantile(
        abs(np.diff(np.random.default_rng(2).standard_normal((2, 10**6)), axis=0)), 0.9
    )
    assert widths[-1] == pytest.approx(apart * RECORD.std(), rel=0.01)


def test_a_short_held_out_part_leaves_the_growth_as_expected() -> None:
    """One error says nothing about growth: a horizon as long as the record is what it is for."""
    band = Band.fit([np.array([[1.0]])], RECORD)
    widths = band.half_widths(len(RECORD) + 1)[:, 0]
    assert widths[0] == pytest.approx(1.0)
    assert widths[-1] == pytest.approx(np.hypot(1, EXPECTED_GROWTH), rel=0.02)


def test_it_scales_with_the_unit_of_each_channel() -> None:
    e = np.hstack([errors(300, 0.01, 3), errors(300, 0.0, 4)])
    y = np.hstack([RECORD, RECORD])
    one = Band.fit([e], y).half_widths(700)
    other = Band.fit([e * [1000.0, 0.1]], y * [1000.0, 0.1]).half_widths(700)
    np.testing.assert_allclose(other, one * [1000.0, 0.1], rtol=1e-3)


def test_a_perfect_forecast_has_no_band() -> None:
    assert Band.fit([np.zeros((50, 1))], RECORD).half_widths(100).max() < 1e-12 * abs(RECORD).max()


def test_it_survives_json() -> None:
    band = Band.fit([errors(200, 0.01, 5)], RECORD)
    facts: dict[str, Any] = {
        k: list(v) if isinstance(v, tuple) else v for k, v in asdict(band).items()
    }
    np.testing.assert_array_equal(Band(**facts).half_widths(50), band.half_widths(50))


@pytest.mark.parametrize("share", [0.0, 1.0, -1.0])
def test_a_share_outside_is_named(share: float) -> None:
    with pytest.raises(ValueError, match=f"share must lie between 0 and 1, got {share}"):
        Band.fit([np.ones((3, 1))], RECORD, share)


def test_no_errors_are_named() -> None:
    with pytest.raises(ValueError, match="errors must have a sample at least"):
        Band.fit([np.empty((0, 1))], RECORD)


def test_a_change_of_mind_widens_a_band_in_the_long_run() -> None:
    band = Band((1.0, 2.0), (0.01, 0.02), (100.0, 100.0))
    horizon = np.arange(50, 250)[:, None]
    wider = band.widened(horizon * np.array([0.1, 0.0]), begin=50)
    np.testing.assert_allclose(wider.growth, [np.hypot(0.01, 0.1), 0.02])
    assert (wider.base, wider.most) == (band.base, band.most)
    assert band.widened(np.zeros((0, 2)), begin=50) == band


def test_a_few_large_changes_do_not_widen_a_band() -> None:
    change = np.zeros((100, 1))
    change[3:8] = 1e3
    assert Band((1.0,), (0.5,), (9.0,)).widened(change, begin=10).growth == (0.5,)
