"""The naive baselines on signals whose period and frequencies are known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from splitband.baselines.seasonal import LastPeriod, periodic
from splitband.baselines.sinusoids import SinusoidRegression, harmonic
from splitband.forecasters.baselines import ByTime, Persistence
from splitband.forecasters.prediction import ForecastContext
from splitband.records.named import double_mass_spring
from splitband.runtime.arrays import Array

FITS: list[Callable[[Array], ByTime]] = [LastPeriod.fit, periodic, harmonic]

SHAPES = ["sine", "overtones", "sawtooth", "square", "random"]
SPRING_FREQUENCIES = np.array([0.0115, 0.057])
SPRING_AMPLITUDES = np.array([1.28, 0.677])
TRAINING = 250


def one_period(shape: str, period: int, seed: int = 0) -> Array:
    phase = np.arange(period) / period
    return {
        "sine": np.sin(2 * np.pi * phase + 1),
        "overtones": np.sin(2 * np.pi * phase) + 0.5 * np.cos(4 * np.pi * phase + 1),
        "sawtooth": 2 * phase,
        "square": np.where(phase < 0.4, 1.0, -1.0),
        "random": np.random.default_rng(seed).standard_normal(period),
    }[shape]


def repeated(period: Array, start: int, steps: int) -> Array:
    return period[np.arange(start, start + steps) % len(period)][:, None]


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal(shape)


class Tones:
    """A sum of sinusoids of well separated frequencies, drawn from a seed."""

    def __init__(self, count: int, samples: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.frequencies = np.sort(rng.uniform(0.02, 0.48, count))
        while count > 1 and np.diff(self.frequencies).min() < 4 / samples:
            self.frequencies = np.sort(rng.uniform(0.02, 0.48, count))
        self.amplitudes = rng.uniform(0.7, 2, count)
        self.phases = rng.uniform(-np.pi, np.pi, count)
        self.offset = rng.normal()

    def __call__(self, start: int, steps: int) -> Array:
        angles = 2 * np.pi * np.outer(np.arange(start, start + steps), self.frequencies)
        return (self.offset + np.cos(angles + self.phases) @ self.amplitudes)[:, None]


def amplitudes(model: SinusoidRegression, channel: int = 0) -> Array:
    found = model.channels[channel]
    count = len(found.frequencies)
    return np.hypot(*found.coefficients[1 : 1 + 2 * count].reshape(2, count))


def strongest(model: SinusoidRegression, count: int) -> tuple[Array, Array]:
    """Frequencies, in their order, and amplitudes of the strongest sinusoids."""
    found, sizes = model.channels[0].frequencies, amplitudes(model)
    order = np.sort(np.argsort(-sizes)[:count])
    order = order[np.argsort(found[order])]
    return found[order], sizes[order]


def test_persistence_holds_the_last_measured_sample_of_each_channel() -> None:
    y = np.array([[1.0, 2.0], [3.0, -1.0], [4.0, np.nan]])
    found = Persistence().extrapolate(ForecastContext(y, 4))
    np.testing.assert_array_equal(found, [[4.0, -1.0]] * 4)
    with pytest.raises(ValueError, match="history must have a measured sample in every channel"):
        Persistence().extrapolate(ForecastContext(y[2:], 4))


CLEAN = ((2, 2), (3, -1), (4, -1))
"""Lengths of records, in periods and samples more."""


@pytest.mark.parametrize(
    ("shape", "period", "lengths"),
    [
        ("sine", 4, CLEAN),
        ("overtones", 7, CLEAN),
        ("sawtooth", 3, CLEAN),
        ("square", 41, CLEAN),
        ("random", 160, CLEAN),
        ("sine", 7, [(9, 2)]),  # of which the multiples are periods, too
        ("sawtooth", 41, [(9, 2)]),
        ("random", 5, [(2, 0)]),
        ("random", 41, [(2, 1)]),
    ],
)
def test_the_shortest_period_of_a_clean_signal_is_found(
    shape: str, period: int, lengths: Any
) -> None:
    for periods, extra in lengths:
        y = repeated(one_period(shape, period), 0, periods * period + extra)
        assert LastPeriod.fit(y).lag == period


@pytest.mark.parametrize(
    ("shape", "period", "seed"),
    [("overtones", 7, 0), ("sawtooth", 13, 1), ("square", 37, 2), ("random", 13, 0)],
)
def test_the_period_of_a_noisy_signal_is_found(shape: str, period: int, seed: int) -> None:
    base = one_period(shape, period)
    level = 0.1 * base.std()
    for samples in (3 * period + 1, 4 * period - 1):
        y = repeated(base, 0, samples) + level * noise(samples, 1, seed=seed)
        assert LastPeriod.fit(y).lag == period
    y = repeated(base, 0, 20 * period) + level * noise(20 * period, 1, seed=seed)
    assert LastPeriod.fit(y).lag % period == 0


def test_the_period_of_several_channels_is_common_to_all() -> None:
    samples = 40
    y = np.hstack([repeated(one_period("random", p, seed=p), 0, samples) for p in (3, 5)])
    model = LastPeriod.fit(y)
    assert model.lag == 15
    assert model.period.shape == (15, 2)


@pytest.mark.parametrize(
    "other",
    [
        *(unit * noise(300, 1, seed=2) for unit in (1.0, 1000.0, 0.001)),
        np.where(np.arange(300)[:, None] == 299, 1.0, np.nan),
    ],
    ids=["noise", "of a large unit", "of a small unit", "measured once"],
)
def test_a_channel_that_has_no_period_does_not_choose_it(other: Array) -> None:
    season = repeated(one_period("random", 12), 0, 300) + 0.1 * noise(300, 1, seed=1)
    assert LastPeriod.fit(np.hstack([season / season.std(), other])).lag % 12 == 0


@pytest.mark.parametrize("level", [0.0, 0.01])
def test_a_smooth_oversampled_signal_does_not_get_a_tiny_lag(level: float) -> None:
    period = 500
    for shape in ("sine", "overtones"):
        y = repeated(one_period(shape, period), 0, 1800) + level * noise(1800, 1)
        assert abs(LastPeriod.fit(y).lag - period) <= 500 * level


@settings(max_examples=settings().max_examples // 4)
@given(
    shape=st.sampled_from(SHAPES),
    period=st.integers(3, 40),
    periods=st.floats(2.5, 12),
    channels=st.integers(1, 2),
    start=st.integers(-100, 300) | st.just(10**9),
)
def test_seasonal_predictions_continue_the_phase(
    shape: str, period: int, periods: float, channels: int, start: int
) -> None:
    base, samples = one_period(shape, period), int(periods * period)
    scales = [1.0, -3.0][:channels]
    model = LastPeriod.fit(repeated(base, 0, samples) * scales)
    # A few short records of a clean period are taken to drift a little.
    assume(str(model).endswith("on a constant" + "; a constant" * (channels - 1)))
    np.testing.assert_allclose(
        model.predict(start, 2 * period + 1),
        repeated(base, start, 2 * period + 1) * scales,
        atol=1e-9,
    )


def test_the_repeated_period_is_the_last_one_as_measured() -> None:
    y = repeated(one_period("sawtooth", 10), 0, 38) + 0.01 * noise(38, 1)
    kept = y.copy()
    model = LastPeriod.fit(y)
    y[:] = 0
    assert (model.lag, model.end) == (10, 38)
    assert "10 training samples" in str(model)
    np.testing.assert_array_equal(model.predict(38, 20), np.tile(kept[-10:], (2, 1)))
    np.testing.assert_array_equal(model.predict(28, 10), kept[-10:])


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize(
    ("samples", "slope"), [(2, 0.0), (4, 0.0), (7, 0.0), (3, 1.0), (10, 1.0), (30, 1.0)]
)
def test_the_shortest_records_still_give_a_prediction(
    fit: Callable[[Array], ByTime], samples: int, slope: float
) -> None:
    y = slope * np.arange(samples)[:, None] + 0.1 * noise(samples, 2)
    ahead = fit(y).predict(samples, 20)
    assert ahead.shape == (20, 2)
    assert np.isfinite(ahead).all()


@pytest.mark.parametrize("fit", FITS)
@pytest.mark.parametrize(("value", "samples"), [(0.0, 3), (1 / 3, 100), (-1e6, 100)])
def test_a_constant_record_stays_constant(
    fit: Callable[[Array], ByTime], value: float, samples: int
) -> None:
    ahead = fit(np.full((samples, 2), value)).predict(samples, 50)
    np.testing.assert_allclose(ahead, value, atol=1e-9 * (1 + abs(value)), rtol=0)


@pytest.mark.parametrize(("count", "seed"), [(1, 0), (2, 5), (3, 1), (4, 3)])
def test_harmonic_regression_recovers_clean_sinusoids(count: int, seed: int) -> None:
    samples = 150 + 40 * seed
    tones = Tones(count, samples, seed)
    model = harmonic(tones(0, samples))
    frequencies, found = strongest(model, count)
    assert len(model.channels[0].frequencies) == count
    np.testing.assert_allclose(frequencies, tones.frequencies, atol=1e-9, rtol=0)
    np.testing.assert_allclose(found, tones.amplitudes, atol=1e-7, rtol=0)
    assert model.channels[0].coefficients[0] == pytest.approx(tones.offset, abs=1e-7)
    for start in (-50, 10, 3 * samples):
        np.testing.assert_allclose(model.predict(start, 100), tones(start, 100), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    "count", [3, *(pytest.param(count, marks=pytest.mark.soak) for count in (0, 1, 2))]
)
def test_sinusoids_in_noise_are_counted(count: int) -> None:
    draws = 3
    found = []
    for seed in range(draws):
        y = Tones(count, 250, seed)(0, 250) + 0.2 * noise(250, 1, seed=seed + 1000)
        found.append(len(harmonic(y).channels[0].frequencies))
    assert min(found) == count
    assert found.count(count) >= draws - 1


def test_harmonic_regression_does_not_depend_on_unit_and_offset() -> None:
    y = Tones(2, 250, 3)(0, 250) + 0.2 * noise(250, 1)
    expected = harmonic(y).predict(250, 250)
    for unit, offset in ((1e-12, 0.0), (1.0, 1e6)):
        found = harmonic(unit * y + offset).predict(250, 250)
        np.testing.assert_allclose((found - offset) / unit, expected, atol=1e-5, rtol=0)


def test_frequencies_in_noise_reach_the_cramer_rao_bound() -> None:
    variance, draws = 0.1, 25
    bound = np.sqrt(24 * variance / (SPRING_AMPLITUDES**2 * TRAINING**3)) / (2 * np.pi)
    errors = []
    for seed in range(draws):
        y = double_mass_spring(TRAINING, variance, seed).y
        errors.append(strongest(harmonic(y), 2)[0] - SPRING_FREQUENCIES)
    spread = np.sqrt(np.mean(np.square(errors), axis=0))
    assert (spread < 1.4 * bound).all()
    assert (spread > 0.6 * bound).all()


def test_a_drifting_record_is_extrapolated_along_a_line_at_most() -> None:
    y = np.cumsum(noise(200, 1), axis=0)
    prediction = harmonic(y).predict(200, 2000)
    assert abs(prediction).max() < 2 * 2200 / 200 * np.ptp(y)
