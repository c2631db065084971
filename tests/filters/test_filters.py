"""The filters against SciPy, the recurrence that defines them, and what they promise."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.signal
import torch
from torch import Tensor

from splitband.filters import ComplementaryPair, Start, butterworth, filtfilt, lfilter
from tests.filters.support import (
    BOTH_WAYS,
    CUTOFF,
    ONE_WAY,
    ORDERS,
    RATE,
    TIGHT,
    Array,
    noise,
    scipy_both_ways,
    scipy_one_way,
    tensor,
)

LENGTHS = [2, 3, 7, 64, 101]
FLOAT32_STEPS = 4 * float(np.finfo(np.float32).eps)
FIR = (np.array([0.4, 0.3, 0.2, -0.1]), np.array([1.0]))
ORDER_3 = butterworth(CUTOFF, RATE, 3)
UNNORMALISED = (np.array([0.5, 1.0]), np.array([2.0, -1.0, 0.5]))


def recurrence(b: Array, a: Array, x: Array, first: Array) -> Array:
    """The definition of a filter that goes on from its first outputs, on `(time, ny)`."""
    y = np.full_like(x, np.nan)
    y[: len(first)] = first
    for n in range(len(first), len(x)):
        feedforward = sum(b[k] * x[n - k] for k in range(len(b)))
        feedback = sum(a[k] * y[n - k] for k in range(1, len(a)))
        y[n] = (feedforward - feedback) / a[0]
    return y


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


@pytest.mark.parametrize(
    ("shape", "dim"),
    [((40,), 0), ((40, 2), 0), ((15, 11, 12), 0), ((3, 40, 2), 1), ((3, 2, 40), 2)],
)
def test_torch_gives_the_numbers_of_numpy_as_a_tensor(shape: tuple[int, ...], dim: int) -> None:
    b, a = butterworth(CUTOFF, RATE, 3)
    x: Any = noise(*shape)
    first = x.take(range(3), dim)
    given: Any = torch.from_numpy(x)
    pairs = [
        *((filtfilt(b, a, of, start=s, dim=dim) for of in (x, given)) for s in BOTH_WAYS),
        *((lfilter(b, a, of, start=s, dim=dim) for of in (x, given)) for s in ONE_WAY),
        (
            lfilter(b, a, x, first=first, dim=dim),
            lfilter(b, a, given, first=torch.from_numpy(first), dim=dim),
        ),
    ]
    for array, tensor_ in pairs:
        assert isinstance(array, np.ndarray)
        assert isinstance(tensor_, Tensor)
        np.testing.assert_allclose(array, tensor_.numpy(), rtol=0, atol=TIGHT)


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


GRADIENTS: list[Callable[[Tensor, Tensor], Tensor]] = [
    *(lambda x, _, s=s: lfilter(*ORDER_3, x, start=s) for s in ONE_WAY),
    *(lambda x, _, s=s: filtfilt(*ORDER_3, x, start=s) for s in BOTH_WAYS),
    lambda x, first: lfilter(*ORDER_3, x, first=first),
]


@pytest.mark.parametrize("run", GRADIENTS)
def test_gradients(run: Callable[[Tensor, Tensor], Tensor]) -> None:
    for length in (13, 14):
        inputs = (tensor(2, length, 2).requires_grad_(), tensor(2, 3, 2, seed=1).requires_grad_())
        assert torch.autograd.gradcheck(run, inputs)
        assert torch.autograd.gradgradcheck(run, inputs)
