"""Complementary pairs: what two filters of SciPy say together, and what adds up to one."""

import itertools
from typing import Any

import numpy as np
import pytest
import scipy.signal
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from torch import Tensor

from splitband.filters import ComplementaryPair, Start
from splitband.runtime.arrays import Array
from tests.filters.support import (
    BOTH_WAYS,
    CUTOFF,
    ONE_WAY,
    ORDERS,
    RATE,
    TIGHT,
    noise,
    scipy_both_ways,
    scipy_one_way,
    tensor,
)


def rounding(b: Array, a: Array, x: Array) -> float:
    """The most that rounding can add up to in a filtered signal, to a small factor.

    Each step of the recurrence rounds the terms that it adds, and 1 / a amplifies what it rounds.
    """
    impulse = np.eye(1, len(x))[0]
    y = scipy.signal.lfilter(b, a, x, axis=0)
    terms = abs(b).sum() * abs(x).max() + abs(a).sum() * abs(y).max()
    amplified = abs(scipy.signal.lfilter([1.0], a, impulse)).sum()
    return float(10 * np.finfo(np.float64).eps * amplified * terms)


def stable_filter(radii: list[float], angles: list[float]) -> Array:
    poles = np.array(radii) * np.exp(1j * np.array(angles))
    return np.real(np.poly(np.concatenate([poles, poles.conj()])))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize(
    ("zero_phase", "start"),
    [*((False, start) for start in ONE_WAY), *((True, start) for start in BOTH_WAYS)],
)
def test_combine_is_the_sum_of_two_scipy_filters(
    order: int, zero_phase: bool, start: Start
) -> None:
    scipys = scipy_both_ways if zero_phase else scipy_one_way
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase=zero_phase, start=start)
    low, high = noise(101, 2), noise(101, 2, seed=1)
    expected = scipys(pair.b_low, pair.a, low, start) + scipys(pair.b_high, pair.a, high, start)
    np.testing.assert_allclose(pair.combine(low=low, high=high), expected, atol=TIGHT, rtol=0)
    if not zero_phase:
        again = pair.combine(low=low, high=high, first=expected[:order])
        np.testing.assert_allclose(again, expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_combine_with_first_is_the_joint_recurrence(order: int) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase=False)
    low, high, first = noise(60, 2), noise(60, 2, seed=1), noise(order, 2, seed=2)
    expected = np.concatenate([first, np.zeros((60 - order, 2))])
    for n in range(order, 60):
        for k in range(order + 1):
            expected[n] += pair.b_low[k] * low[n - k] + pair.b_high[k] * high[n - k]
        for k in range(1, order + 1):
            expected[n] -= pair.a[k] * expected[n - k]
    np.testing.assert_allclose(
        pair.combine(low=low, high=high, first=first), expected, atol=TIGHT, rtol=0
    )
    turned = pair.combine(low=low.T, high=high.T, first=first.T, dim=-1)
    np.testing.assert_allclose(turned.T, expected, atol=TIGHT, rtol=0)


def test_gradients_of_combine_reach_both_bands_and_first() -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 2, zero_phase=False)

    def run(low: Tensor, high: Tensor, first: Tensor) -> Tensor:
        return pair.combine(low=low, high=high, first=first)

    shapes = [(8, 2), (8, 2), (2, 2)]
    inputs = tuple(tensor(*s, seed=i).requires_grad_() for i, s in enumerate(shapes))
    assert torch.autograd.gradcheck(run, inputs)
    assert torch.autograd.gradgradcheck(run, inputs)


@pytest.mark.parametrize("order", ORDERS)
def test_zero_phase_butterworth_pairs_add_up_to_the_interior(order: int) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order)
    y = 5 + noise(1000, 2)
    settled = int(np.log(1e-12) / np.log(abs(np.roots(pair.a)).max()))
    assert settled < 300
    low, high = pair.split(y)
    interior = slice(settled, -settled)
    np.testing.assert_allclose((low + high)[interior], y[interior], atol=TIGHT, rtol=0)
    np.testing.assert_array_equal(pair.reconstruction_error(y), y - low - high)
    assert abs(pair.reconstruction_error(y)).max() > 1e-6


@pytest.mark.parametrize("start", ONE_WAY)
def test_the_first_order_pair_adds_up_everywhere_one_way(start: Start) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 1, zero_phase=False, start=start)
    y = 5 + noise(300, 2)
    np.testing.assert_allclose(sum(pair.split(y)), y, atol=TIGHT, rtol=0)


@given(
    radii=st.lists(st.floats(0, 0.9), min_size=1, max_size=2),
    angles=st.lists(st.floats(0, np.pi), min_size=2, max_size=2),
    numerator=st.lists(st.floats(-1, 1), min_size=1, max_size=5),
    band=st.sampled_from(["low", "high"]),
    start=st.sampled_from(ONE_WAY),
)
@example(radii=[0.75, 0.875], angles=[0.0, 0.0], numerator=[1.0], band="low", start="zeros")
def test_any_stable_filter_is_completed_to_the_identity(
    radii: list[float],
    angles: list[float],
    numerator: list[float],
    band: Any,
    start: Start,
) -> None:
    a = stable_filter(radii, angles[: len(radii)])
    pair = ComplementaryPair.perfect(numerator, a, RATE, band, start=start)
    y = 5 + noise(200, 2)
    low, high = pair.split(y)
    tolerance = rounding(pair.b_low, pair.a, y) + rounding(pair.b_high, pair.a, y)
    np.testing.assert_allclose(low + high, y, atol=tolerance, rtol=0)
    width = max(len(numerator), len(a))
    padded = [np.pad(c, (0, width - len(c))) for c in (np.array(numerator), a)]
    expected = scipy_one_way(padded[0], padded[1], y, start)
    np.testing.assert_allclose(low if band == "low" else high, expected, atol=tolerance, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
def test_powers_of_a_butterworth_pair_add_up_to_one(order: int) -> None:
    freqs = np.linspace(0, RATE / 2, 101)
    one_way = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase=False)
    low, high = one_way.response(freqs)
    np.testing.assert_allclose(abs(low) ** 2 + abs(high) ** 2, 1, atol=1e-9)
    low, high = ComplementaryPair.butterworth(CUTOFF, RATE, order).response(freqs)
    assert not np.iscomplexobj(low)
    np.testing.assert_allclose(low + high, 1, atol=1e-9)


@pytest.mark.parametrize(
    ("order", "zero_phase", "frequency"),
    [
        *((1, True, 0.4), (3, True, 1.3), (6, True, 3.1)),
        *((1, False, 1.3), (3, False, 3.1), (6, False, 0.4)),
    ],
)
def test_the_response_is_the_measured_gain(order: int, zero_phase: bool, frequency: float) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase)
    phase = 2 * np.pi * frequency * np.arange(2000) / RATE
    settled = slice(500, 1500)
    basis = np.stack([np.cos(phase), -np.sin(phase)], axis=1)[settled]
    for part, response in zip(pair.split(np.cos(phase)), pair.response(frequency), strict=True):
        real, imaginary = np.linalg.lstsq(basis, part[settled], rcond=None)[0]
        assert real + 1j * imaginary == pytest.approx(complex(response[0]), abs=1e-8)


def test_an_accepted_pair_has_the_responses_of_its_sections() -> None:
    accepted = 0
    for order, cutoff in itertools.product(range(1, 13), np.geomspace(1e-3, 4.95, 30)):
        try:
            pair = ComplementaryPair.butterworth(cutoff, RATE, order, zero_phase=False)
        except ValueError:
            continue
        accepted += 1
        freqs: Array = np.geomspace(cutoff / 10, RATE / 2, 100)
        bands: list[Any] = ["lowpass", "highpass"]
        for band, response in zip(bands, pair.response(freqs), strict=True):
            sections = scipy.signal.butter(order, cutoff, band, fs=RATE, output="sos")
            expected = scipy.signal.freqz_sos(sections, freqs, fs=RATE)[1]
            np.testing.assert_allclose(response, expected, atol=1e-4, err_msg=f"{order} {cutoff}")
    assert accepted > 150
