"""Baselines of records with gaps."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.optimize
import scipy.stats

from splitband.baselines.seasonal import LastPeriod, _last_period, periodic
from splitband.baselines.sinusoids import MAX_FIT_SAMPLES, harmonic, recent
from splitband.comparison.methods import named
from splitband.forecasters.baselines import ByTime
from splitband.runtime.arrays import Array
from tests.signals import NAN, TRAIN, holed, record, rms, with_gaps


def sine(samples: int, seed: int = 0) -> tuple[Array, npt.NDArray[np.bool_]]:
    """A noisy sinusoid, and a mask that leaves out a fifth of it."""
    rng = np.random.default_rng(seed)
    y = 0.3 + np.sin(2 * np.pi * 0.0313 * np.arange(samples) + 0.4)
    measured = np.ones(samples, dtype=np.bool_)
    measured[rng.choice(samples, samples // 5, replace=False)] = False
    return (y + 0.1 * rng.standard_normal(samples))[:, None], measured[:, None]


def on_measured(frequency: float, y: Array, measured: npt.NDArray[np.bool_]) -> tuple[Any, float]:
    """Least squares of the measured rows alone: coefficients, and what they leave."""
    rows = np.flatnonzero(measured)
    phase = 2 * np.pi * frequency * rows
    basis = np.stack([np.ones(len(rows)), np.cos(phase), np.sin(phase)], axis=1)
    found, left, *_ = np.linalg.lstsq(basis, y[rows, 0], rcond=None)
    return found, float(left[0])


def test_a_sinusoid_comes_to_the_least_squares_of_what_was_measured() -> None:
    y, measured = sine(300)
    best = scipy.optimize.minimize_scalar(
        lambda f: on_measured(f, y, measured)[1],
        bounds=(0.0303, 0.0323),
        method="bounded",
        options={"xatol": 1e-10},
    ).x
    wanted = on_measured(best, y, measured)[0]
    found = harmonic(np.where(measured, y, NAN))
    phase = 2 * np.pi * best * np.arange(400)
    expected = wanted @ np.stack([np.ones(400), np.cos(phase), np.sin(phase)])
    np.testing.assert_allclose(found.predict(0, 400)[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("fit", [harmonic, periodic])
def test_what_has_no_noise_is_found_around_long_gaps(fit: Callable[[Array], ByTime]) -> None:
    n = np.arange(900)
    y = 0.3 + np.sin(2 * np.pi * n / 50 + 1) + 0.4 * np.cos(4 * np.pi * n / 50)
    y = np.stack([y, 1e3 * y[::-1]], axis=1)
    seen = holed(holed(y[:600], slice(150, 230), slice(560, None)), slice(0, 60), channel=1)
    found = fit(seen).predict(600, 300)
    np.testing.assert_allclose(found / [1, 1e3], y[600:] / [1, 1e3], atol=1e-5)


def test_what_is_missing_of_the_last_period_is_taken_from_the_one_before() -> None:
    y = np.arange(21.0)[:, None]
    y[[0, 3, 4, 18, 19]] = NAN
    period, error = _last_period(y, 4)
    np.testing.assert_array_equal(period[:, 0], [17, 14, 15, 20])
    # Of earlier samples of the same phases: 1, 5, 9, 13; 2, 6, 10; 7, 11; 8, 12, 16.
    left = [16, 12, 8, 4, 12, 8, 4, 8, 4, 12, 8, 4]
    assert error == pytest.approx(np.mean(np.square(left)))


def test_a_phase_that_was_never_measured_lies_on_a_straight_line() -> None:
    y = np.tile([0.0, 1, 2, 3, 4, 3, 2, 1], 6)[:, None]
    y[2::8] = NAN
    y[7::8] = NAN
    found = LastPeriod.fit(y)
    assert found.lag == 8
    np.testing.assert_allclose(found.predict(48, 8)[:, 0], [0, 1, 2, 3, 4, 3, 2, 1])


def test_of_a_long_record_that_ends_in_a_gap_the_last_measured_samples_are_fitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    longest = 400
    monkeypatch.setattr("splitband.baselines.sinusoids.MAX_FIT_SAMPLES", longest)
    n = np.arange(3 * longest)
    y = np.where(n < longest, 7.0, np.sin(2 * np.pi * n / 100))[:, None]
    y[2 * longest :] = NAN
    found = harmonic(y)
    assert found.begin == longest
    expected = np.sin(2 * np.pi * np.arange(200) / 100)
    np.testing.assert_allclose(found.predict(len(n), 200)[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize(("gap", "seed"), [(500, 0), (800, 1)])
def test_a_season_is_none_that_a_few_pairs_agree_in(gap: int, seed: int) -> None:
    noise = 0.3 * np.random.default_rng(seed).standard_normal(1500)
    y = (np.sin(2 * np.pi * np.arange(1500) / 37) + noise)[:, None]
    found = LastPeriod.fit(holed(y[:1000], slice(gap)))
    assert rms(found.predict(1000, 500) - y[1000:]) < 0.6


@pytest.mark.parametrize(("every", "seed"), [(7, 0), (10, 1)])
def test_a_channel_that_is_measured_now_and_then_has_its_own_frequency(
    every: int, seed: int
) -> None:
    noise = 0.05 * np.random.default_rng(seed).standard_normal(1500)
    y = (np.sin(2 * np.pi * np.arange(1500) / 50) + noise)[:, None]
    seen = holed(y[:1000], np.arange(1000) % every > 0)
    assert rms(harmonic(seen).predict(1000, 500) - y[1000:]) < 0.2


def test_a_sparse_channel_does_not_make_the_others_longer() -> None:
    y = np.random.default_rng(0).standard_normal((5 * MAX_FIT_SAMPLES, 2))
    begin, end = recent(holed(y, slice(3, None), channel=1))
    assert begin == 0
    assert (~np.isnan(end)).sum(axis=0).tolist() == [MAX_FIT_SAMPLES, 3]


def test_the_mean_of_a_record_with_long_gaps_is_that_of_what_was_measured() -> None:
    y = holed(record().y, slice(20, 74))
    found = named("mean").fit(with_gaps(y)[:TRAIN]).predict(1).y
    assert found[0, 0] == pytest.approx(np.nanmean(y[:TRAIN]))


@pytest.mark.parametrize("channels", [1, 2], ids=["every other sample", "never both channels"])
def test_a_season_is_found_where_no_two_samples_follow_each_other(channels: int) -> None:
    rows = slice(None, None, 2), slice(1, None, 2)
    y = record(channels).y
    for channel in range(channels):
        y = holed(y, rows[channel], channel=channel)
    found = named("seasonal-naive").fit(with_gaps(y)[:TRAIN]).predict(20).y
    assert np.isfinite(found).all()
