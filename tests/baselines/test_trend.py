"""Trends, and frequencies of less than a cycle, of which the truth or SciPy's fit is known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy

from splitband.baselines.sinusoids import MAX_FIT_SAMPLES, Sinusoids, harmonic, trend
from splitband.forecasters.baselines import ByTime
from tests.baselines.test_naive import FITS, one_period, repeated

Array = npt.NDArray[Any]
TRAINING, SAMPLES = 400, 1000
N = np.arange(SAMPLES)
# The first of FITS repeats noise, so that its error is larger by a factor of 1.4.


def noise(samples: int = SAMPLES, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal(samples)


def cooling(index: Array, limit: float, size: float, rate: float) -> Array:
    return np.asarray(limit + size * np.exp(-rate * index))


def rise(y: Array) -> float:
    """By how much the trend of a channel changes over its samples."""
    return float(np.ptp(trend(y).predict(np.arange(len(y)))))


def season(index: Array, period: float = 50.0) -> Array:
    angle = 2 * np.pi * index / period
    return np.asarray(np.sin(angle) + 0.4 * np.cos(2 * angle))


def error(fit: Callable[[Array], ByTime], y: Array, training: int = TRAINING) -> float:
    ahead = fit(y[:training, None]).predict(training, len(y) - training)
    return float(np.sqrt(np.mean((ahead[:, 0] - y[training:]) ** 2)))


@pytest.mark.parametrize(
    ("signal", "levels"),
    [
        (cooling(N, 20, 60, 1 / 300), (0.02, 0.2, 0.5)),
        (N / 250 + season(N), (0.3, 0.1, 0.02)),
    ],
    ids=["a cooling curve", "a season on a line"],
)
def test_a_trend_is_forecast_to_its_noise(signal: Array, levels: tuple[float, ...]) -> None:
    for fit, level in zip(FITS, levels, strict=True):
        assert error(fit, signal + level * noise()) < 1.7 * level


@pytest.mark.parametrize("fit", FITS[1:])
def test_a_season_on_an_exponential_goes_on_exactly(fit: Callable[[Array], ByTime]) -> None:
    assert error(fit, cooling(N, -3, 5, 1 / 150) + season(N)) < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_an_exponential_is_the_least_squares_fit(seed: int) -> None:
    y = cooling(N[:TRAINING], 20, 6, 1 / 130) + 0.3 * noise(TRAINING, seed)
    wanted = scipy.optimize.curve_fit(cooling, N[:TRAINING], y, (19, 5, 1 / 100))[0]
    found = harmonic(y[:, None])
    assert found.channels[0].dampings[0] == pytest.approx(wanted[2], rel=1e-4)
    ahead = found.predict(TRAINING, 600)[:, 0]
    np.testing.assert_allclose(ahead, cooling(N[TRAINING:], *wanted), atol=1e-4)


@pytest.mark.parametrize(
    "signal",
    [
        lambda seed: noise(TRAINING, seed),
        lambda seed: season(N[:TRAINING]) + 0.2 * noise(TRAINING, seed),
        lambda seed: scipy.signal.lfilter([1], [1, -0.95], noise(TRAINING, seed)),
        lambda seed: np.full(TRAINING, seed / 3),
    ],
    ids=["noise", "season", "autoregression", "constant"],
)
def test_what_has_no_trend_gets_none(signal: Callable[[int], Array]) -> None:
    assert [rise(signal(seed)) for seed in range(4)] == [0.0] * 4


def test_a_swelling_season_is_forecast_on_its_level() -> None:
    for seed in range(8):
        y = (1 + N / 400) * season(N) + 0.1 * noise(seed=seed)
        assert rise(y[:TRAINING]) < 0.1 * y[:TRAINING].std()


@pytest.mark.parametrize(
    ("shape", "period", "samples"),
    [("random", 3, 31), ("overtones", 4, 20), ("sawtooth", 5, 21), ("square", 15, 52)],
)
def test_what_sinusoids_leave_of_a_clean_period_is_no_trend(
    shape: str, period: int, samples: int
) -> None:
    assert rise(repeated(one_period(shape, period), 0, samples)[:, 0]) == 0


def test_a_line_in_a_random_walk_is_the_exception() -> None:
    found = [rise(np.cumsum(noise(TRAINING, seed))) for seed in range(10)]
    assert np.count_nonzero(found) <= 3


def test_each_channel_has_its_own_trend_around_gaps() -> None:
    y = np.stack([N / 100 + season(N), cooling(N, 9, 5, 1 / 90), season(N)], axis=1)
    y += 0.1 * noise(3 * SAMPLES).reshape(-1, 3)
    seen = y[:TRAINING].copy()
    seen[50:120, 0] = seen[200:260, 1] = seen[::3, 2] = np.nan
    for fit in FITS[:2]:
        found = fit(seen)
        left = found.predict(TRAINING, 600) - y[TRAINING:]
        assert (np.sqrt(np.mean(left**2, axis=0)) < 0.2).all()
        assert "straight line" in str(found)
        assert "exponential" in str(found)


def test_of_a_long_record_the_end_is_fitted_and_the_trend_is_held_before_it() -> None:
    n, begin = np.arange(3 * MAX_FIT_SAMPLES), 2 * MAX_FIT_SAMPLES
    y = 5 + np.maximum(n - begin, 0) / 1000
    for fit in FITS:
        found = fit(y[:, None]).predict(len(n), 3)[:, 0]
        np.testing.assert_allclose(found, 9 + np.arange(3) / 1000, atol=2e-3)
    np.testing.assert_allclose(harmonic(y[:, None]).predict(0, begin), 5.0, atol=2e-3)


def test_a_part_of_a_cycle_is_no_oscillation() -> None:
    """A sine of period 900, seen for 500 samples."""
    y = np.sin(2 * np.pi * N / 900) + 0.05 * noise()
    persistence = float(np.sqrt(np.mean((y[500:] - y[499]) ** 2)))
    found = harmonic(y[:500, None])
    ahead = found.predict(500, 500)
    assert np.ptp(ahead) == 0
    assert np.sqrt(np.mean((ahead[:, 0] - y[500:]) ** 2)) < 1.1 * persistence


def test_a_part_of_a_cycle_does_not_hide_a_fast_sinusoid() -> None:
    y = 2 * np.sin(2 * np.pi * N / 900) + season(N, 31) + 0.05 * noise()
    found = harmonic(y[:500, None])
    fast = found.channels[0].frequencies[found.channels[0].frequencies * 500 >= 1]
    np.testing.assert_allclose(np.sort(fast), [1 / 31, 2 / 31], rtol=1e-3)
    assert np.ptp(found.predict(500, 500)) == pytest.approx(np.ptp(season(N, 31)), rel=0.1)


def test_the_fit_is_a_local_least_squares_optimum() -> None:
    """Around gaps, with harmonics that stay multiples, and a decay: SciPy finds none better."""
    y = N[:200] / 100 + season(N[:200]) + 0.1 * noise(200)
    y += 2 * np.exp(-N[:200] / 40) * np.cos(2 * np.pi * 0.11 * N[:200])
    y[20:30] = np.nan
    frequencies, dampings = np.array([0.0201, 0.0402, 0.1102]), np.array([0.0, 0.0, 0.02])
    start = Sinusoids(frequencies, dampings, np.zeros(8), 200, line=True, harmonics=2)
    found = start.refined(y)

    def squares(moved: Array) -> float:
        first, other, damping = moved
        size = np.exp(-damping * N[:200])
        columns = [np.ones(200), N[:200]]
        for frequency, factor in ((first, 1.0), (2 * first, 1.0), (other, size)):
            phase = 2 * np.pi * frequency * N[:200]
            columns += [factor * np.cos(phase), factor * np.sin(phase)]
        basis, seen = np.stack(columns, axis=1), ~np.isnan(y)
        left = y[seen] - basis[seen] @ np.linalg.lstsq(basis[seen], y[seen], rcond=None)[0]
        return float(left @ left)

    at = np.array([found.frequencies[0], found.frequencies[2], found.dampings[2]])
    best = scipy.optimize.minimize(squares, at, method="Nelder-Mead", options={"xatol": 1e-9})
    assert float(np.nansum(found.residual(y) ** 2)) == pytest.approx(best.fun, rel=1e-6)
    assert found.frequencies[1] == pytest.approx(2 * found.frequencies[0], rel=1e-12)
