"""The filters against SciPy, the recurrence that defines them, and what they promise."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from torch import Tensor

from splitband.filters import ComplementaryPair, Start, butterworth, filtfilt, lfilter

Array = npt.NDArray[Any]

RATE = 10.0
CUTOFF = 1.3
ORDERS = 1, 2, 3, 6
LENGTHS = [2, 3, 7, 64, 101]
TIGHT = 1e-10
SMALLEST = float(np.finfo(np.float64).tiny)
"""Below it numbers lose their relative accuracy."""
FLOAT32_STEPS = 4 * float(np.finfo(np.float32).eps)
ONE_WAY: list[Start] = ["zeros", "steady"]
BOTH_WAYS: list[Start] = ["zeros", "steady", "odd"]
FIR = (np.array([0.4, 0.3, 0.2, -0.1]), np.array([1.0]))
UNNORMALISED = (np.array([0.5, 1.0]), np.array([2.0, -1.0, 0.5]))

values = st.floats(-10, 10, width=64)


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).standard_normal(shape)


def tensor(*shape: int, seed: int = 0) -> Tensor:
    return torch.from_numpy(noise(*shape, seed=seed))


def scipy_one_way(b: Array, a: Array, x: Array, start: Start, axis: int = 0) -> Array:
    if start == "zeros":
        return np.asarray(scipy.signal.lfilter(b, a, x, axis=axis))
    moved = np.moveaxis(x, axis, -1)
    zi = moved[..., :1] * scipy.signal.lfilter_zi(b, a)
    return np.moveaxis(scipy.signal.lfilter(b, a, moved, zi=zi)[0], -1, axis)


def scipy_both_ways(b: Array, a: Array, x: Array, start: Start, axis: int = 0) -> Array:
    if start == "odd":
        return scipy.signal.filtfilt(b, a, x, axis=axis)
    if start == "steady":
        return scipy.signal.filtfilt(b, a, x, axis=axis, padtype=None)
    forward = np.flip(scipy.signal.lfilter(b, a, x, axis=axis), axis)
    return np.flip(scipy.signal.lfilter(b, a, forward, axis=axis), axis)


def recurrence(b: Array, a: Array, x: Array, first: Array) -> Array:
    """The definition of a filter that goes on from its first outputs, on `(time, ny)`."""
    y = np.full_like(x, np.nan)
    y[: len(first)] = first
    for n in range(len(first), len(x)):
        feedforward = sum(b[k] * x[n - k] for k in range(len(b)))
        feedback = sum(a[k] * y[n - k] for k in range(1, len(a)))
        y[n] = (feedforward - feedback) / a[0]
    return y


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
@pytest.mark.parametrize("cutoff", [0.3, 2.5, 4.4])
def test_butterworth_has_the_response_of_its_closed_form(order: int, cutoff: float) -> None:
    freqs: Array = np.linspace(0.05, 4.95, 50)
    warped = np.tan(np.pi * freqs / RATE) / np.tan(np.pi * cutoff / RATE)
    low = scipy.signal.freqz(*butterworth(cutoff, RATE, order), worN=freqs, fs=RATE)[1]
    high = scipy.signal.freqz(*butterworth(cutoff, RATE, order, "high"), worN=freqs, fs=RATE)[1]
    np.testing.assert_allclose(abs(low) ** 2, 1 / (1 + warped ** (2 * order)), atol=1e-9)
    np.testing.assert_allclose(abs(high) ** 2, 1 / (1 + warped ** (-2 * order)), atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("start", ONE_WAY)
def test_one_way_equals_scipy(order: int, start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    for length, channels in itertools.product([1, *LENGTHS], [1, 3]):
        x = 5 + noise(length, channels)
        expected = scipy_one_way(b, a, x, start)
        np.testing.assert_allclose(lfilter(b, a, x, start=start), expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("start", BOTH_WAYS)
def test_both_ways_equal_scipy(order: int, start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    shortest = 3 * (order + 1) + 1 if start == "odd" else 1
    for length, channels in itertools.product([shortest, shortest + 1, 64, 101], [1, 3]):
        x = 5 + noise(length, channels)
        expected = scipy_both_ways(b, a, x, start)
        np.testing.assert_allclose(filtfilt(b, a, x, start=start), expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize(("b", "a"), [FIR, UNNORMALISED])
def test_numerator_and_denominator_may_differ_in_length_and_scale(b: Array, a: Array) -> None:
    x = 5 + noise(50)
    np.testing.assert_allclose(lfilter(b, a, x), scipy_one_way(b, a, x, "zeros"), atol=TIGHT)
    for start in BOTH_WAYS:
        expected = scipy_both_ways(b, a, x, start)
        np.testing.assert_allclose(filtfilt(b, a, x, start=start), expected, atol=TIGHT)


@pytest.mark.parametrize("dim", [0, 1, 2, -1, -2, -3])
def test_dim_names_the_time_axis(dim: int) -> None:
    b, a = butterworth(CUTOFF, RATE, 2)
    x = noise(13, 14, 15)
    one_way = scipy_one_way(b, a, x, "steady", dim)
    np.testing.assert_allclose(lfilter(b, a, x, start="steady", dim=dim), one_way, atol=TIGHT)
    np.testing.assert_allclose(
        filtfilt(b, a, x, dim=dim), scipy_both_ways(b, a, x, "odd", dim), atol=TIGHT
    )
    first = np.take(one_way, range(2), axis=dim)
    np.testing.assert_allclose(lfilter(b, a, x, first=first, dim=dim), one_way, atol=TIGHT)


@pytest.mark.parametrize(("shape", "axis"), [((40,), 0), ((40, 2), 0), ((3, 40, 2), 1)])
def test_time_is_the_first_axis_without_a_batch_and_the_last_but_one_otherwise(
    shape: tuple[int, ...], axis: int
) -> None:
    b, a = butterworth(CUTOFF, RATE, 3)
    x = noise(*shape)
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 3)
    np.testing.assert_allclose(lfilter(b, a, x), scipy_one_way(b, a, x, "zeros", axis), atol=TIGHT)
    np.testing.assert_allclose(pair.lowpass(x), scipy_both_ways(b, a, x, "odd", axis), atol=TIGHT)


@pytest.mark.parametrize("shape", [(40,), (40, 2), (3, 40, 2)])
def test_torch_gives_the_numbers_of_numpy_as_a_tensor(shape: tuple[int, ...]) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 3)
    x = noise(*shape)
    for low, low_torch in zip(pair.split(x), pair.split(torch.from_numpy(x)), strict=True):
        assert isinstance(low, np.ndarray)
        assert isinstance(low_torch, Tensor)
        np.testing.assert_array_equal(low, low_torch.numpy())


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("start", BOTH_WAYS)
def test_float32_stays_float32_with_float32_accuracy(order: int, start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    x = (100 + noise(500, 2)).astype(np.float32)
    y = filtfilt(b, a, x, start=start)
    assert y.dtype == np.float32
    expected = scipy_both_ways(b, a, x.astype(np.float64), start)
    np.testing.assert_allclose(y, expected, atol=FLOAT32_STEPS * abs(expected).max(), rtol=0)
    y_torch = filtfilt(b, a, torch.from_numpy(x), start=start)
    assert y_torch.dtype == torch.float32
    np.testing.assert_array_equal(y_torch.numpy(), y)


@pytest.mark.parametrize("start", BOTH_WAYS)
def test_float32_accuracy_does_not_suffer_from_a_high_order(start: Start) -> None:
    b, a = butterworth(0.01 * RATE, RATE, 5)
    x = (100 + noise(2000)).astype(np.float32)
    expected = scipy_both_ways(b, a, x.astype(np.float64), start)
    y = filtfilt(b, a, x, start=start)
    np.testing.assert_allclose(y, expected, atol=FLOAT32_STEPS * abs(expected).max(), rtol=0)


def test_float32_accuracy_does_not_suffer_from_given_first_outputs() -> None:
    b, a = butterworth(0.01 * RATE, RATE, 5)
    x = (100 + noise(2000)).astype(np.float32)
    exact = x.astype(np.float64)[:, None]
    expected = recurrence(b, a, exact, exact[:5])[:, 0]
    y = lfilter(b, a, x, first=x[:5])
    np.testing.assert_allclose(y, expected, atol=FLOAT32_STEPS * abs(expected).max(), rtol=0)


@pytest.mark.parametrize("wider", [np.float64, np.int64])
def test_the_dtype_is_that_of_the_signal_whatever_first_is(wider: type[np.generic]) -> None:
    b, a = butterworth(CUTOFF, RATE, 2)
    x = noise(20).astype(np.float32)
    assert lfilter(b, a, x, first=np.array([1, 2], wider)).dtype == np.float32


def test_the_gradient_has_the_dtype_of_the_signal() -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 2)
    x = tensor(30).float().requires_grad_()
    (gradient,) = torch.autograd.grad(pair.lowpass(x).square().sum(), x)
    assert gradient.dtype == torch.float32


@pytest.mark.parametrize("integers", [np.int16, np.int64, np.uint8])
def test_integers_are_filtered_as_float64(integers: type) -> None:
    b, a = butterworth(CUTOFF, RATE, 2)
    x: Array = np.arange(30).astype(integers)
    y = filtfilt(b, a, x)
    assert y.dtype == np.float64
    np.testing.assert_allclose(y, scipy_both_ways(b, a, x.astype(float), "odd"), atol=TIGHT)


def test_views_and_read_only_arrays_are_filtered_and_left_alone() -> None:
    b, a = butterworth(CUTOFF, RATE, 2)
    base = noise(80, 3)
    read_only = base.copy()
    read_only.flags.writeable = False
    for view in (base[::2], base[::-1], base[:, 1:], np.asfortranarray(base), read_only, base.T):
        before = view.copy()
        np.testing.assert_allclose(
            lfilter(b, a, view), scipy_one_way(b, a, before, "zeros"), atol=TIGHT
        )
        np.testing.assert_allclose(
            lfilter(b, a, view, first=view[:2]), recurrence(b, a, before, before[:2]), atol=TIGHT
        )
        np.testing.assert_array_equal(view, before)


def test_non_contiguous_tensors_are_filtered() -> None:
    b, a = butterworth(CUTOFF, RATE, 2)
    x = tensor(3, 80).T[::2]
    expected = scipy_both_ways(b, a, x.numpy(), "odd")
    np.testing.assert_allclose(filtfilt(b, a, x).numpy(), expected, atol=TIGHT)


def test_the_result_does_not_share_memory_with_the_signal() -> None:
    x = noise(40)
    before = x.copy()
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 1, zero_phase=False)
    for part in (pair.lowpass(x), pair.highpass_from(x, x[:1])):
        part[:] = 0
        np.testing.assert_array_equal(x, before)


@pytest.mark.parametrize("order", ORDERS)
def test_first_outputs_start_the_recurrence(order: int) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    for length in (order, order + 1, order + 2, 60):
        x, first = noise(length, 3), noise(order, 3, seed=1)
        expected = recurrence(b, a, x, first)
        np.testing.assert_allclose(lfilter(b, a, x, first=first), expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize(("b", "a"), [FIR, UNNORMALISED])
def test_first_outputs_start_the_recurrence_of_any_coefficients(b: Array, a: Array) -> None:
    order = max(len(b), len(a)) - 1
    x, first = noise(40, 2), noise(order, 2, seed=1)
    np.testing.assert_allclose(
        lfilter(b, a, x, first=first), recurrence(b, a, x, first), atol=TIGHT
    )


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("start", ONE_WAY)
def test_its_own_first_outputs_change_nothing(order: int, start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    x = noise(2, 50, 3)
    y = lfilter(b, a, x, start=start)
    np.testing.assert_allclose(lfilter(b, a, x, first=y[:, :order]), y, atol=TIGHT, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("start", ONE_WAY)
def test_combine_one_way_is_the_sum_of_two_scipy_filters(order: int, start: Start) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase=False, start=start)
    low, high = noise(101, 2), noise(101, 2, seed=1)
    expected = scipy_one_way(pair.b_low, pair.a, low, start) + scipy_one_way(
        pair.b_high, pair.a, high, start
    )
    np.testing.assert_allclose(pair.combine(low=low, high=high), expected, atol=TIGHT, rtol=0)
    again = pair.combine(low=low, high=high, first=expected[:order])
    np.testing.assert_allclose(again, expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("start", BOTH_WAYS)
def test_combine_both_ways_is_the_sum_of_two_scipy_filters(order: int, start: Start) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, start=start)
    low, high = noise(101, 2), noise(101, 2, seed=1)
    expected = scipy_both_ways(pair.b_low, pair.a, low, start) + scipy_both_ways(
        pair.b_high, pair.a, high, start
    )
    np.testing.assert_allclose(pair.combine(low=low, high=high), expected, atol=TIGHT, rtol=0)


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


def test_combine_with_first_takes_the_named_time_axis() -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 3, zero_phase=False)
    low, high, first = noise(60, 2), noise(60, 2, seed=1), noise(3, 2, seed=2)
    turned = pair.combine(low=low.T, high=high.T, first=first.T, dim=-1)
    np.testing.assert_allclose(
        turned.T, pair.combine(low=low, high=high, first=first), atol=TIGHT, rtol=0
    )


@pytest.mark.parametrize("start", ONE_WAY)
def test_gradients_of_one_way_filtering(start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, 3)

    def run(x: Tensor) -> Tensor:
        return lfilter(b, a, x, start=start)

    for length in (2, 8):
        x = tensor(2, length, 2).requires_grad_()
        assert torch.autograd.gradcheck(run, (x,))
        assert torch.autograd.gradgradcheck(run, (x,))


@pytest.mark.parametrize("start", BOTH_WAYS)
def test_gradients_of_filtering_both_ways(start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, 2)

    def run(x: Tensor) -> Tensor:
        return filtfilt(b, a, x, start=start)

    x = tensor(11, 2).requires_grad_()
    assert torch.autograd.gradcheck(run, (x,))
    assert torch.autograd.gradgradcheck(run, (x,))


def test_gradients_with_first_outputs_given() -> None:
    b, a = butterworth(CUTOFF, RATE, 3)

    def run(x: Tensor, first: Tensor) -> Tensor:
        return lfilter(b, a, x, first=first)

    for length in (4, 9):
        inputs = (tensor(2, length, 2).requires_grad_(), tensor(2, 3, 2, seed=1).requires_grad_())
        assert torch.autograd.gradcheck(run, inputs)
        assert torch.autograd.gradgradcheck(run, inputs)


def test_gradients_of_combine_reach_both_bands_and_first() -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 2, zero_phase=False)

    def run(low: Tensor, high: Tensor, first: Tensor) -> Tensor:
        return pair.combine(low=low, high=high, first=first)

    shapes = [(8, 2), (8, 2), (2, 2)]
    inputs = tuple(tensor(*s, seed=i).requires_grad_() for i, s in enumerate(shapes))
    assert torch.autograd.gradcheck(run, inputs)
    assert torch.autograd.gradgradcheck(run, inputs)


@given(
    x=hnp.arrays(np.float64, 25, elements=values),
    v=hnp.arrays(np.float64, 25, elements=values),
    order=st.integers(1, 6),
    start=st.sampled_from(BOTH_WAYS),
)
def test_the_gradient_is_the_adjoint(x: Array, v: Array, order: int, start: Start) -> None:
    b, a = butterworth(CUTOFF, RATE, order)
    signal = torch.from_numpy(x).requires_grad_()
    weights = torch.from_numpy(v)
    for run in [filtfilt] if start == "odd" else [lfilter, filtfilt]:
        y = run(b, a, signal, start=start)
        (adjoint,) = torch.autograd.grad(y, signal, weights)
        tolerance = SMALLEST + 1e-11 * np.abs(x).sum() * np.abs(v).sum()
        assert abs(float(y.detach() @ weights) - float(signal.detach() @ adjoint)) <= tolerance


@given(
    x=hnp.arrays(np.float64, (25, 2), elements=values),
    z=hnp.arrays(np.float64, (25, 2), elements=values),
    scale=values,
    order=st.integers(1, 6),
    zero_phase=st.booleans(),
)
def test_a_pair_is_linear(x: Array, z: Array, scale: float, order: int, zero_phase: bool) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase)
    tolerance = SMALLEST + TIGHT * (abs(x).max() + abs(scale * z).max())
    for part in (pair.lowpass, pair.highpass):
        np.testing.assert_allclose(
            part(x + scale * z), part(x) + scale * part(z), atol=tolerance, rtol=0
        )


@pytest.mark.parametrize("zero_phase", [True, False])
def test_signals_of_a_batch_and_channels_do_not_meet(zero_phase: bool) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 3, zero_phase)
    x = noise(4, 50, 3)
    for part in (pair.lowpass, pair.highpass):
        together = part(x)
        for i, j in itertools.product(range(4), range(3)):
            np.testing.assert_allclose(together[i, :, j], part(x[i, :, j]), atol=1e-14, rtol=0)


@pytest.mark.parametrize("start", ONE_WAY)
def test_one_way_filtering_does_not_look_ahead(start: Start) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 4, zero_phase=False, start=start)
    x = noise(60)
    changed = x.copy()
    changed[30] += 100
    for part in (pair.lowpass, pair.highpass):
        np.testing.assert_array_equal(part(x)[:30], part(changed)[:30])
        assert (part(x)[30:] != part(changed)[30:]).any()


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


def test_the_third_order_pair_does_not_add_up_one_way() -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, 3, zero_phase=False)
    freqs = np.append(np.linspace(0.01, 4.99, 500), CUTOFF)
    low, high = pair.response(freqs)
    gap = abs(low + high - 1)
    assert gap.max() == pytest.approx(2, abs=1e-9)
    assert freqs[gap.argmax()] == CUTOFF
    y = np.cos(2 * np.pi * CUTOFF * np.arange(2000) / RATE)
    assert abs(pair.reconstruction_error(y))[500:].max() == pytest.approx(2, abs=0.05)


@pytest.mark.parametrize("order", ORDERS)
def test_powers_of_a_butterworth_pair_add_up_to_one(order: int) -> None:
    freqs = np.linspace(0, RATE / 2, 101)
    one_way = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase=False)
    low, high = one_way.response(freqs)
    np.testing.assert_allclose(abs(low) ** 2 + abs(high) ** 2, 1, atol=1e-9)
    low, high = ComplementaryPair.butterworth(CUTOFF, RATE, order).response(freqs)
    assert not np.iscomplexobj(low)
    np.testing.assert_allclose(low + high, 1, atol=1e-9)
    np.testing.assert_allclose(
        ComplementaryPair.butterworth(CUTOFF, RATE, order).response(CUTOFF)[0], 0.5, atol=1e-9
    )


@pytest.mark.parametrize("order", [1, 3, 6])
@pytest.mark.parametrize("zero_phase", [True, False])
@pytest.mark.parametrize("frequency", [0.4, 1.3, 3.1])
def test_the_response_is_the_measured_gain(order: int, zero_phase: bool, frequency: float) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase)
    phase = 2 * np.pi * frequency * np.arange(2000) / RATE
    settled = slice(500, 1500)
    basis = np.stack([np.cos(phase), -np.sin(phase)], axis=1)[settled]
    for part, response in zip(pair.split(np.cos(phase)), pair.response(frequency), strict=True):
        real, imaginary = np.linalg.lstsq(basis, part[settled], rcond=None)[0]
        assert real + 1j * imaginary == pytest.approx(complex(response[0]), abs=1e-8)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("zero_phase", [True, False])
def test_constants_belong_to_the_low_band(order: int, zero_phase: bool) -> None:
    pair = ComplementaryPair.butterworth(CUTOFF, RATE, order, zero_phase)
    y = np.full((101, 2), [3.0, -7.0])
    np.testing.assert_allclose(pair.lowpass(y), y, atol=TIGHT, rtol=0)
    np.testing.assert_allclose(pair.highpass(y), 0, atol=TIGHT, rtol=0)


@pytest.mark.parametrize("cutoff", [-1.0, 0.0, 5.0, 7.5, float("nan")])
@pytest.mark.parametrize("make", [butterworth, ComplementaryPair.butterworth])
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
    ("order", "cutoff"),
    [
        (3, 2e-5),
        (4, 1e-5),
        (4, 2.3e-4),
        (8, 1e-3),
        (15, 0.1),
    ],
)
@pytest.mark.parametrize("make", [butterworth, ComplementaryPair.butterworth])
def test_an_order_too_high_for_the_cutoff_is_named_with_it(
    make: Any, order: int, cutoff: float
) -> None:
    with pytest.raises(ValueError, match=f"order {order} is too high .* {cutoff:g} Hz at 10 Hz"):
        make(cutoff, RATE, order)


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
