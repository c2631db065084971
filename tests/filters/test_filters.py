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

FLOAT32_STEPS = 4 * float(np.finfo(np.float32).eps)
FIR = (np.array([0.4, 0.3, 0.2, -0.1]), np.array([1.0]))
ORDER_3 = butterworth(CUTOFF, RATE, 3)
UNNORMALISED = (np.array([0.5, 1.0]), np.array([2.0, -1.0, 0.5]))
Run = Callable[..., Any]
WAYS: list[tuple[Run, Run, Start]] = [
    *((lfilter, scipy_one_way, start) for start in ONE_WAY),
    *((filtfilt, scipy_both_ways, start) for start in BOTH_WAYS),
]
EACH = pytest.mark.parametrize(
    ("b", "a"), [*(butterworth(CUTOFF, RATE, order) for order in ORDERS), FIR, UNNORMALISED]
)


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


@EACH
@pytest.mark.parametrize(("run", "scipys", "start"), WAYS)
def test_it_equals_scipy(run: Run, scipys: Run, start: Start, b: Array, a: Array) -> None:
    """Numerator and denominator may differ in length and scale."""
    shortest = 3 * max(len(a), len(b)) + 1 if start == "odd" else 1
    for samples, channels in itertools.product([*range(shortest, shortest + 3), 101], [1, 3]):
        x = 5 + noise(samples, channels)
        expected = scipys(b, a, x, start)
        np.testing.assert_allclose(run(b, a, x, start=start), expected, atol=TIGHT, rtol=0)


@pytest.mark.parametrize(
    ("shape", "dim", "axis"),
    [
        *(((40,), None, 0), ((40, 2), None, 0), ((3, 40, 2), None, 1), ((3, 2, 40), 2, 2)),
        *(((13, 14, 15), dim, dim) for dim in (0, 1, 2, -1, -2, -3)),
    ],
)
def test_time_is_the_named_axis_or_the_usual_one_and_torch_gives_the_same_numbers(
    shape: tuple[int, ...], dim: int | None, axis: int
) -> None:
    """Without a batch the first axis, and the last but one otherwise."""
    (b, a), x = ORDER_3, noise(*shape)
    named: Any = {} if dim is None else {"dim": dim}
    for run, scipys, start in WAYS:
        y = run(b, a, x, start=start, **named)
        assert isinstance(y, np.ndarray)
        np.testing.assert_allclose(y, scipys(b, a, x, start, axis), atol=TIGHT)
        of_torch = run(b, a, torch.from_numpy(x), start=start, **named)
        assert isinstance(of_torch, Tensor)
        np.testing.assert_allclose(of_torch.numpy(), y, rtol=0, atol=TIGHT)
    steady: Any = scipy_one_way(b, a, x, "steady", axis)
    first = steady.take(range(3), axis)
    np.testing.assert_allclose(lfilter(b, a, x, first=first, **named), steady, atol=TIGHT)
    given: Any = torch.from_numpy(x)
    found = lfilter(b, a, given, first=torch.from_numpy(first), **named)
    np.testing.assert_allclose(found.numpy(), steady, rtol=0, atol=TIGHT)


@pytest.mark.parametrize("order", [1, 2])
def test_torch_filters_with_a_steady_state_that_lies_backwards(
    order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As SciPy gives it from 1.18 on, where Python is 3.12 or newer."""
    found = scipy.signal.lfilter_zi
    backwards = lambda b, a: found(b, a)[::-1].copy()[::-1]  # noqa: E731
    monkeypatch.setattr(scipy.signal, "lfilter_zi", backwards)
    (b, a), x = butterworth(0.9 * CUTOFF, RATE, order), noise(40)
    for run, scipys, start in WAYS:
        y = run(b, a, torch.from_numpy(x), start=start)
        np.testing.assert_allclose(y.numpy(), scipys(b, a, x, start, 0), atol=TIGHT)


@pytest.mark.parametrize(("order", "cutoff"), [(1, CUTOFF), (2, CUTOFF), (5, 0.01 * RATE)])
@pytest.mark.parametrize("start", BOTH_WAYS)
def test_float32_stays_float32_with_float32_accuracy(
    order: int, cutoff: float, start: Start
) -> None:
    b, a = butterworth(cutoff, RATE, order)
    x = (100 + noise(2000, 2)).astype(np.float32)
    expected = scipy_both_ways(b, a, x.astype(np.float64), start)
    for y in (filtfilt(b, a, x, start=start), filtfilt(b, a, torch.from_numpy(x), start=start)):
        found = np.asarray(y)
        assert found.dtype == np.float32
        error = abs(found - expected).max()
        assert error <= FLOAT32_STEPS * abs(expected).max()


def test_float32_accuracy_does_not_suffer_from_given_first_outputs() -> None:
    b, a = butterworth(0.01 * RATE, RATE, 5)
    x = (100 + noise(2000)).astype(np.float32)
    exact = x.astype(np.float64)[:, None]
    expected = recurrence(b, a, exact, exact[:5])[:, 0]
    y = lfilter(b, a, x, first=x[:5])
    np.testing.assert_allclose(y, expected, atol=FLOAT32_STEPS * abs(expected).max(), rtol=0)


def test_the_dtype_is_that_of_the_signal_and_of_integers_float64() -> None:
    b, a = butterworth(CUTOFF, RATE, 2)
    x = noise(20).astype(np.float32)
    for first in ([1.0, 2.0], [1, 2]):
        assert lfilter(b, a, x, first=np.array(first)).dtype == np.float32
    single = torch.from_numpy(x).requires_grad_()
    (gradient,) = torch.autograd.grad(filtfilt(b, a, single).square().sum(), single)
    assert gradient.dtype == torch.float32
    for integers in (np.int16, np.int64, np.uint8):
        count: Array = np.arange(30).astype(integers)
        y = filtfilt(b, a, count)
        assert y.dtype == np.float64
        np.testing.assert_allclose(y, scipy_both_ways(b, a, count.astype(float), "odd"), atol=TIGHT)


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


@EACH
def test_first_outputs_start_the_recurrence(b: Array, a: Array) -> None:
    order = max(len(b), len(a)) - 1
    for length in (order, order + 1, order + 2, 60):
        x, first = noise(length, 3), noise(order, 3, seed=1)
        expected = recurrence(b, a, x, first)
        np.testing.assert_allclose(lfilter(b, a, x, first=first), expected, atol=TIGHT, rtol=0)


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
