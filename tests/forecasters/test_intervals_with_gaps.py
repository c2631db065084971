"""Intervals from errors of which some are not known."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.optimize
import scipy.stats

from splitband.forecasters.intervals import HeldOut, Interval
from tests.records import LENGTH, SETUP, TRAIN, holed, with_gaps
from tests.support import compare

Array = npt.NDArray[np.float64]


def fitted(errors: Sequence[Array], y: Array, share: float = 0.9) -> Interval:
    """The interval that errors of forecasts of a record call for."""
    return HeldOut.of(errors, y).interval(share)


def forecast_errors(samples: int, ny: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((samples, ny)) * (1 + 0.01 * np.arange(samples))[:, None]


def test_an_interval_is_fitted_to_the_errors_that_are_known() -> None:
    y = 50 * np.random.default_rng(9).standard_normal((1000, 2))
    parts = [forecast_errors(150, 2, seed) for seed in range(3)]
    ends = [holed(part, slice(100 + i, None)) for i, part in enumerate(parts)]
    cut = fitted([part[: 100 + i] for i, part in enumerate(parts)], y)
    found = fitted(ends, y).half_widths(500)
    np.testing.assert_allclose(found, cut.half_widths(500), rtol=1e-9)
    # What is known counts at its own horizon: with holes it is nearly the same interval, which it
    # is not when the samples after a hole move into it.
    scattered = [holed(holed(p, slice(3, 40), channel=0), 0, 77, channel=1) for p in parts]
    found, whole = (fitted(each, y).half_widths(150)[50:] for each in (scattered, parts))
    np.testing.assert_allclose(found, whole, rtol=0.05)
    closed = [p[~np.isnan(p[:, 0])][:, :1] for p in scattered]
    moved = fitted(closed, y[:, :1]).half_widths(150)[50:, 0]
    assert (moved > 1.1 * whole[:, 0]).all()


def test_the_coverage_is_a_share_of_the_errors_that_are_known() -> None:
    interval = Interval((1.0, 2.0), (0.5, 0.0), (None, 9.0))
    errors = holed(holed(forecast_errors(80, 2, 5), slice(20, 33)), 60, channel=1)
    known = inside = 0
    for n, row in enumerate(errors):
        for error, half in zip(row, (np.sqrt(n + 1), 2.0), strict=True):
            known += not np.isnan(error)
            inside += abs(error) <= half
    assert 0 < inside < known
    assert interval.coverage(errors) == pytest.approx(inside / known)


@pytest.mark.parametrize("channel", [slice(None), 1])
def test_a_channel_without_an_error_has_no_interval(channel: Any) -> None:
    errors = holed(np.ones((5, 2)), slice(None), channel=channel)
    with pytest.raises(ValueError, match="errors must have a sample at least, in every channel"):
        fitted([errors], np.ones((9, 2)))


def test_an_interval_is_limited_by_the_spread_of_what_was_measured() -> None:
    y = holed(np.random.default_rng(6).standard_normal((LENGTH, 1)), slice(20, 60))
    apart = np.sqrt(2) * scipy.stats.norm.ppf(0.95)
    interval = compare(with_gaps(y), ["mean"], SETUP).require_trial().intervals["mean"]
    assert interval.most[0] == pytest.approx(apart * np.nanstd(y[:TRAIN]))
