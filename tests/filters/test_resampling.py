"""Down- and up-sampling against plain indexing, np.interp and torch."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from torch import Tensor

from splitband.filters.resampling import Alignment, check_downsampling, downsample, upsample
from tests.filters.support import Array, noise

ALIGNMENTS: list[Alignment] = ["time", "paper"]
SHAPES = [(7,), (7, 2), (3, 7, 2)]
RATE = 50.0

values = st.floats(-100, 100, width=64)
factors = st.integers(1, 9)


def series(y: Array) -> list[Array]:
    """Each channel of each batch, `(time,)`."""
    columns = y[:, None] if y.ndim == 1 else y
    return list(np.moveaxis(columns, -2, -1).reshape(-1, columns.shape[-2]))


def interpolated(y: Array, k: int, shift: float) -> Array:
    """The slow series seen at the times of the fast one, which lag by `shift` fast samples."""
    return np.interp((np.arange(k * len(y)) - shift) / k, np.arange(len(y)), y)


def tolerance(y: Array) -> float:
    """What a few roundings are, of numbers as large as these."""
    return float(np.finfo(np.float64).tiny + 1e-14 * abs(y).max())


@given(y=hnp.arrays(np.float64, st.integers(1, 12), elements=values), k=factors)
def test_upsampling_is_linear_interpolation(y: Array, k: int) -> None:
    """The paper's lags by half of k - 1."""
    for align, lag in zip(ALIGNMENTS, (0.0, (k - 1) / 2), strict=True):
        expected, found = interpolated(y, k, lag), upsample(y, k, align=align)
        np.testing.assert_allclose(found, expected, atol=tolerance(y), rtol=0)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("align", ALIGNMENTS)
def test_upsampling_acts_on_each_channel_of_each_batch(
    shape: tuple[int, ...], align: Alignment
) -> None:
    y = noise(*shape)
    fast = upsample(y, 3, align=align)
    assert fast.shape == ((21,) if y.ndim == 1 else (*shape[:-2], 21, shape[-1]))
    for one, expected in zip(series(fast), series(y), strict=True):
        np.testing.assert_allclose(one, upsample(expected, 3, align=align), atol=1e-14)


@given(n=st.integers(0, 20), k=factors, offset=st.integers(0, 12))
def test_downsampling_takes_every_kth_sample_from_offset_on(n: int, k: int, offset: int) -> None:
    y = noise(2, n, 3)
    kept = list(range(offset, n, k))
    np.testing.assert_array_equal(downsample(y, k, offset), y[:, kept])
    np.testing.assert_array_equal(downsample(y[0], k, offset), y[0, kept])
    np.testing.assert_array_equal(downsample(y[0, :, 0], k, offset), y[0, kept, 0])


@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("length", [0, 1, 19, 20, 21])
def test_length_cuts_the_end_off(align: Alignment, length: int) -> None:
    y = noise(7, 2)
    cut = upsample(y, 3, length, align)
    assert cut.shape == (length, 2)
    np.testing.assert_array_equal(cut, upsample(y, 3, align=align)[:length])


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_torch_gives_the_numbers_of_numpy_as_a_tensor(align: Alignment) -> None:
    y = noise(3, 7, 2)
    before = y.copy()
    fast, fast_torch = upsample(y, 3, align=align), upsample(torch.from_numpy(y), 3, align=align)
    assert isinstance(fast, np.ndarray)
    assert isinstance(fast_torch, Tensor)
    np.testing.assert_array_equal(fast, fast_torch.numpy())
    for k in (1, 3):  # the signal is left alone
        upsample(y, k, align=align)[:] = 0
        np.testing.assert_array_equal(y, before)
    assert isinstance(downsample(torch.from_numpy(y), 3), Tensor)


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_float32_stays_and_integers_are_interpolated_as_real_numbers(align: Alignment) -> None:
    assert upsample(torch.ones(5, 2), 3, align=align).dtype == torch.float32
    assert upsample(np.ones((5, 2), np.float32), 3, align=align).dtype == np.float32
    y = np.array([0, 3, 1])
    expected = upsample(y.astype(np.float64), 2, align=align)
    np.testing.assert_array_equal(upsample(y, 2, align=align), expected)
    fast = upsample(torch.from_numpy(y), 2, align=align)
    np.testing.assert_allclose(fast.double().numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_gradients(align: Alignment) -> None:
    def run(y: Tensor) -> tuple[Tensor, Tensor]:
        return upsample(y, 3, length=10, align=align), downsample(y, 3, offset=1)

    for shape in SHAPES:
        assert torch.autograd.gradcheck(run, (torch.from_numpy(noise(*shape)).requires_grad_(),))


def allowed(k: int, cutoff: float, rate: float) -> bool:
    try:
        check_downsampling(k, cutoff, rate)
    except ValueError:
        return False
    return True


@given(k=st.integers(1, 60), rate=st.floats(0.01, 1e4), share=st.floats(0.02, 0.98))
def test_downsampling_is_allowed_below_the_nyquist_frequency(
    k: int, rate: float, share: float
) -> None:
    cutoff = share * rate / 2
    assume(abs(k * share - 1) > 1e-9)
    assert allowed(k, cutoff, rate) == (2 * cutoff * k < rate)


@given(rate=st.floats(0.01, 1e4), share=st.floats(0.02, 0.98))
@example(rate=50.0, share=0.034482758620689655)
@example(rate=100.0, share=0.03225806451612903)
def test_the_factor_that_will_do_is_the_largest_allowed(rate: float, share: float) -> None:
    cutoff = share * rate / 2
    with pytest.raises(ValueError, match="at most") as caught:
        check_downsampling(60, cutoff, rate)
    best = int(str(caught.value).rpartition("at most ")[2].removesuffix(" will do"))
    assert allowed(best, cutoff, rate)
    assert not allowed(best + 1, cutoff, rate)


@pytest.mark.parametrize("largest", [1, 2, 3, 5, 12])
def test_the_factor_at_the_limit_is_not_allowed(largest: int) -> None:
    cutoff = 64.0 / 2 / (largest + 1)
    with pytest.raises(ValueError, match=rf"leaves .* {cutoff:g} Hz, .* {cutoff:g} Hz; at most"):
        check_downsampling(largest + 1, cutoff, 64.0)
    check_downsampling(largest, cutoff, 64.0)


@pytest.mark.parametrize("k", [0, -2])
def test_a_factor_below_one_is_named(k: int) -> None:
    runs: list[Callable[[], object]] = [
        lambda: downsample(noise(5), k),
        lambda: upsample(noise(5), k),
        lambda: check_downsampling(k, 1.0, RATE),
    ]
    for run in runs:
        with pytest.raises(ValueError, match=rf"^(k|downsampling) must be at least 1, got {k}$"):
            run()


@pytest.mark.parametrize("length", [-1, 16])
def test_a_length_out_of_range_is_named(length: int) -> None:
    with pytest.raises(ValueError, match=rf"length must be .* k n = 15, got {length}"):
        upsample(noise(5), 3, length)
