"""Spectra of signals whose spectrum is known."""

import numpy as np
import pytest

from splitband.filters.spectrum import periodogram
from splitband.runtime.arrays import Array

RATE = 20.0
SAMPLES = 1000


def sinusoid(frequency: float, amplitude: float = 1.0, samples: int = SAMPLES) -> Array:
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(samples) / RATE + 0.4)[:, None]


def test_the_density_integrates_to_the_power() -> None:
    y = np.hstack([7 + sinusoid(1.0, 3.0), sinusoid(2.0, 0.5)])
    spectrum = periodogram(y, RATE)
    assert spectrum.frequencies[0] == 0
    assert spectrum.frequencies[-1] == RATE / 2
    power = spectrum.density.sum(axis=0) * spectrum.frequencies[1]
    np.testing.assert_allclose(power, [4.5, 0.125])


@pytest.mark.parametrize(("slow", "fast"), [(1.0, 1.0), (3.0, 1.0), (0.2, 1.0)])
def test_share_below_is_that_of_the_squared_amplitudes(slow: float, fast: float) -> None:
    spectrum = periodogram(50 + sinusoid(0.5, slow) + sinusoid(4.0, fast), RATE)
    assert spectrum.share_below(2.0) == pytest.approx(slow**2 / (slow**2 + fast**2))
    assert spectrum.share_below(0.4) == pytest.approx(0, abs=1e-12)
    assert spectrum.share_below(RATE / 2) == pytest.approx(1)


def test_channels_weigh_the_same_whatever_their_unit() -> None:
    y = np.hstack([sinusoid(0.5, 1e-3), sinusoid(4.0, 1e3)])
    assert periodogram(y, RATE).share_below(2.0) == pytest.approx(0.5)


def test_the_mean_s_bin_has_no_power_although_the_window_leaks_into_it() -> None:
    slowest = sinusoid(RATE / SAMPLES)
    assert periodogram(slowest, RATE).share_below(0.0) == 0
    assert periodogram(np.hstack([slowest, sinusoid(4.0)]), RATE).share_below(2.0) == (
        pytest.approx(0.5)
    )


@pytest.mark.parametrize("constant", [0.0, 2.0, 1 / 3])
def test_a_constant_channel_has_no_weight(constant: float) -> None:
    y = np.hstack([sinusoid(4.0), np.full((SAMPLES, 1), constant)])
    assert periodogram(y, RATE).share_below(2.0) == pytest.approx(0, abs=1e-12)


def test_peaks_are_the_sinusoids_by_strength() -> None:
    y = sinusoid(0.5, 1.0) + sinusoid(4.0, 3.0) + sinusoid(7.0, 2.0)
    spectrum = periodogram(y, RATE)
    found = np.array(spectrum.peaks())
    np.testing.assert_allclose(found[:, 0], [4.0, 7.0, 0.5])
    np.testing.assert_allclose(found[:, 1], np.array([9, 4, 1]) / 14)


@pytest.mark.parametrize("bins", [1, 25, 100.25, 100.5])
def test_a_sinusoid_is_one_peak_with_all_of_the_power(bins: float) -> None:
    """On a bin or between two, where the window spreads it over four."""
    found = periodogram(sinusoid(bins * RATE / SAMPLES), RATE).peaks()
    assert len(found) == 1
    frequency, share = found[0]
    assert frequency == pytest.approx(bins * RATE / SAMPLES, abs=RATE / SAMPLES)
    assert share == pytest.approx(1, abs=2e-3)


def test_shares_of_peaks_do_not_count_a_bin_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitband.filters.spectrum.MOST_PEAKS", SAMPLES)
    monkeypatch.setattr("splitband.filters.spectrum.LEAST_PEAK", 0.0)
    noise = np.random.default_rng(0).standard_normal((SAMPLES, 1))
    found = periodogram(noise, RATE).peaks()
    assert len(found) > 50
    assert sum(share for _, share in found) <= 1 + 1e-12


@pytest.mark.parametrize("constant", [0.0, 2.0])
def test_a_constant_record_has_no_peaks_and_no_power_above(constant: float) -> None:
    spectrum = periodogram(np.full((SAMPLES, 2), constant), RATE)
    assert spectrum.peaks() == []
    assert spectrum.share_below(0.0) == 1
