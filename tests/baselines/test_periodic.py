"""Periodic regression on signals whose period, harmonics and vibrations are known."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from splitband.baselines.seasonal import LastPeriod, periodic
from splitband.baselines.sinusoids import SinusoidRegression

Array = npt.NDArray[Any]

TRAINING, AHEAD = 600, 1400
"""A last measured sample that it may not look at."""


def wave(period: float, index: Array, harmonics: int = 5) -> Array:
    """A sawtooth's Fourier series."""
    order = np.arange(1, harmonics + 1)
    return np.sin(2 * np.pi * np.outer(index, order) / period) @ (1 / order)


def period(found: SinusoidRegression, channel: int = 0) -> float:
    return float(1 / found.channels[channel].frequencies[0])


def vibrations(found: SinusoidRegression) -> int:
    return int((found.channels[0].dampings > 0).sum())


def noise(samples: int, seed: int) -> Array:
    return np.random.default_rng(seed).standard_normal(samples)


def assert_multiple(found: float, period: float) -> None:
    """A multiple of a period is one, too."""
    assert found / period == pytest.approx(round(found / period), abs=1e-4)


@pytest.mark.soak
@settings(max_examples=settings().max_examples // 4)
@given(
    period=st.floats(25, 150),
    offset=st.floats(-1e4, 1e4),
    unit=st.floats(1e-6, 1e6),
    harmonics=st.integers(1, 11),
    training=st.sampled_from([TRAINING, 2000]),
)
def test_a_clean_series_goes_on_exactly(
    period: float, offset: float, unit: float, harmonics: int, training: int
) -> None:
    y = offset * unit + unit * wave(period, np.arange(training + AHEAD), harmonics)
    found = periodic(y[:training, None])
    ahead = found.predict(training, AHEAD)[:, 0]
    assert np.abs(ahead - y[training:]).max() < 2e-3 * unit
    assert_multiple(1 / found.channels[0].frequencies[0], period)


@pytest.mark.parametrize("spread", [0, 0.1])
@pytest.mark.parametrize("lag", [2, 4, 12])
def test_an_even_period_of_samples_without_any_relation_goes_on(lag: int, spread: float) -> None:
    """Half a cycle per sample is one of its harmonics."""
    y = np.resize(np.random.default_rng(5).standard_normal(lag), 40 * lag + AHEAD)
    seen = y + spread * noise(len(y), 0)
    ahead = periodic(seen[: 40 * lag, None]).predict(40 * lag, AHEAD)[:, 0]
    assert np.std(ahead - y[40 * lag :]) < 1e-6 + 0.5 * spread


def test_what_dies_out_is_told_from_what_stays() -> None:
    index = np.arange(TRAINING + AHEAD)
    y = wave(80, index) + np.exp(-index / 90) * np.cos(2 * np.pi * index / 13)
    y += 0.01 * noise(len(y), 0)
    found = periodic(y[:TRAINING, None])
    assert vibrations(found) >= 1
    assert_multiple(period(found), 80)
    assert np.std(found.predict(TRAINING, AHEAD)[:, 0] - y[TRAINING:]) < 0.012


def test_it_takes_the_mean_over_noisy_periods() -> None:
    y = wave(100, np.arange(TRAINING + AHEAD))[:, None]
    seen = y[:TRAINING] + 0.3 * noise(TRAINING, 0)[:, None]
    errors = [
        np.std(method.predict(TRAINING, AHEAD) - y[TRAINING:])
        for method in (periodic(seen), LastPeriod.fit(seen))
    ]
    assert errors[0] < 0.6 * errors[1]


def test_noise_alone_gets_no_vibrations_and_stays_within_its_range() -> None:
    for seed in range(2):
        y = noise(400, seed)[:, None]
        found = periodic(y)
        assert vibrations(found) == 0
        assert np.abs(found.predict(400, 2000)).max() < np.ptp(y)


def test_channels_have_their_own_periods_and_the_description_says_them() -> None:
    index = np.arange(TRAINING)
    found = periodic(np.stack([wave(50, index), wave(80, index)], axis=1))
    assert [period(found, channel) for channel in (0, 1)] == pytest.approx([50, 80], rel=1e-4)
    assert str(found).startswith("5 harmonics of a period of 50 samples, a constant; 5 harmonics")


def test_what_wanders_has_no_period() -> None:
    for seed in range(3):
        y = scipy.signal.lfilter([1], [1, -0.95], noise(2000, seed))
        found = periodic(y[:, None])
        assert str(found) == "a constant"
        np.testing.assert_allclose(found.predict(2000, 3), y.mean())


def test_a_period_below_strong_noise_is_still_found() -> None:
    index = np.arange(1500)
    y = np.sin(2 * np.pi * index / 57.3) + 1.4 * noise(1500, 3)
    found = periodic(y[:, None])
    assert period(found) == pytest.approx(57.3, rel=1e-2)
