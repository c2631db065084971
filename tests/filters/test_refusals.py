"""Filters and pairs that cannot be: the rule and the value are named."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from splitband.filters import ComplementaryPair, butterworth, filtfilt, lfilter
from tests.filters.support import CUTOFF, ORDERS, RATE, Array, noise


@pytest.mark.parametrize(
    ("make", "cutoff"),
    [
        *((butterworth, cutoff) for cutoff in (-1.0, 0.0, 5.0, float("nan"))),
        (ComplementaryPair.butterworth, 7.5),
    ],
)
def test_a_cutoff_outside_the_nyquist_range_is_named(make: Any, cutoff: float) -> None:
    with pytest.raises(ValueError, match=rf"cutoff must .* 5 Hz, got {cutoff:g} Hz"):
        make(cutoff, RATE)


@pytest.mark.parametrize("rate", [0.0, -2.0, float("nan")])
def test_a_sampling_rate_that_is_not_positive_is_named(rate: float) -> None:
    with pytest.raises(ValueError, match=rf"sampling_rate must be positive, got {rate:g} Hz"):
        butterworth(CUTOFF, rate)


@pytest.mark.parametrize("order", [0, -3])
def test_an_order_below_one_is_named(order: int) -> None:
    with pytest.raises(ValueError, match=f"order must be at least 1, got {order}"):
        butterworth(CUTOFF, RATE, order)


@pytest.mark.parametrize(
    ("make", "order", "cutoff"),
    [
        (butterworth, 3, 2e-5),
        (butterworth, 4, 1e-5),
        (ComplementaryPair.butterworth, 4, 2.3e-4),
        (butterworth, 8, 1e-3),
        (ComplementaryPair.butterworth, 15, 0.1),
    ],
)
def test_an_order_too_high_for_the_cutoff_is_named_with_it(
    make: Any, order: int, cutoff: float
) -> None:
    with pytest.raises(ValueError, match=f"order {order} is too high .* {cutoff:g} Hz at 10 Hz"):
        make(cutoff, RATE, order)


@pytest.mark.parametrize("a", [[1.0, -1.2], [1.0, -1.0], [1.0, 0.0, 1.0]])
def test_an_unstable_filter_is_refused_with_its_pole(a: list[float]) -> None:
    largest = f"{abs(np.roots(a)).max():.6g}"
    with pytest.raises(ValueError, match=rf"must be stable, .* got one at \|z\| = {largest}"):
        ComplementaryPair.perfect([1.0], a, RATE)


def test_a_leading_zero_coefficient_is_named() -> None:
    with pytest.raises(ValueError, match=r"a\[0\] must not be zero, got 0"):
        lfilter([1.0], [0.0, 1.0], noise(5))


@pytest.mark.parametrize("given", [0, 2, 4])
def test_first_of_a_wrong_length_is_named(given: int) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 3, zero_phase=False)
    x = noise(30, 2)
    runs: list[Callable[[Array], object]] = [
        lambda first: lfilter(pair.b_low, pair.a, x, first=first),
        lambda first: pair.highpass_from(x, first),
        lambda first: pair.combine(low=x, high=x, first=first),
    ]
    for run in runs:
        with pytest.raises(ValueError, match=rf"first 3 outputs, .* got \({given}, 2\)"):
            run(x[:given])


def test_first_of_other_channels_is_named() -> None:
    b, a = butterworth(CUTOFF, RATE, 3)
    for first in (noise(3), noise(3, 1), noise(2, 3, 2)):
        with pytest.raises(ValueError, match="first"):
            lfilter(b, a, noise(30, 2), first=first)


def test_a_signal_shorter_than_first_is_named() -> None:
    b, a = butterworth(CUTOFF, RATE, 3)
    with pytest.raises(ValueError, match=r"\b2\b"):
        lfilter(b, a, noise(2), first=noise(3))


def test_first_is_refused_both_ways() -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 2)
    x = noise(30)
    with pytest.raises(ValueError, match=r"zero_phase=False"):
        pair.combine(low=x, high=x, first=x[:2])


@pytest.mark.parametrize("order", ORDERS)
def test_a_signal_too_short_for_the_odd_extension_is_named(order: int) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    pad = 3 * (order + 1)
    with pytest.raises(ValueError, match=f"order {order} needs more than {pad} samples, got {pad}"):
        filtfilt(b, a, noise(pad, 2))


@pytest.mark.parametrize(("shape", "dim"), [((30,), 1), ((30, 2), 2), ((30, 2), -3)])
def test_a_dim_out_of_range_is_named(shape: tuple[int, ...], dim: int) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE)
    one_way = ComplementaryPair.butterworth(CUTOFF, RATE, zero_phase=False)
    for run in (pair.lowpass, pair.highpass, one_way.lowpass):
        with pytest.raises(ValueError, match=f"dim must name one of the {len(shape)} axes.* {dim}"):
            run(noise(*shape), dim=dim)


def test_odd_extension_is_refused_one_way() -> None:
    b, a = butterworth(CUTOFF, RATE)
    with pytest.raises(ValueError, match='start="odd"'):
        lfilter(b, a, noise(30), start="odd")
    with pytest.raises(ValueError, match='start="odd" needs zero_phase=True'):
        ComplementaryPair.butterworth(CUTOFF, RATE, zero_phase=False, start="odd")


def test_coefficients_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"one length, got \[2, 3\]"):
        ComplementaryPair(np.ones(2), np.ones(3), np.ones(2), RATE)
