"""Down- and up-sampling against plain indexing and np.interp."""

import numpy as np
import pytest
import torch
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from torch import Tensor

from splitband.filters.resampling import Alignment, check_downsampling, downsample, upsample
from splitband.runtime.arrays import Array
from tests.filters.support import noise

ALIGNMENTS: list[Alignment] = ["time", "paper"]

values = st.floats(-100, 100, width=64)
factors = st.integers(1, 9)


def interpolated(y: Array, k: int, shift: float) -> Array:
    """The slow series seen at the times of the fast one, which lag by `shift` fast samples."""
    return np.interp((np.arange(k * len(y)) - shift) / k, np.arange(len(y)), y)


def tolerance(y: Array) -> float:
    """What a few roundings are, of numbers as large as these."""
    return float(np.finfo(np.float64).tiny + 1e-14 * abs(y).max())


@given(y=hnp.arrays(np.float64, (2, 6, 2), elements=values), k=factors, cut=st.integers(0, 6))
def test_upsampling_is_linear_interpolation_and_ends_at_a_length(
    y: Array, k: int, cut: int
) -> None:
    """The paper's lags by half of k - 1."""
    for align, lag in zip(ALIGNMENTS, (0.0, (k - 1) / 2), strict=True):
        found = upsample(torch.from_numpy(y), k, k * 6 - cut, align).numpy()
        assert found.shape == (2, max(k * 6 - cut, 0), 2)
        for batch, channel in np.ndindex(2, 2):
            expected = interpolated(y[batch, :, channel], k, lag)[: found.shape[1]]
            np.testing.assert_allclose(
                found[batch, :, channel], expected, atol=tolerance(y), rtol=0
            )


@given(n=st.integers(0, 20), k=factors, offset=st.integers(0, 12))
def test_downsampling_takes_every_kth_sample_from_offset_on(n: int, k: int, offset: int) -> None:
    y = noise(2, n, 3)
    kept = list(range(offset, n, k))
    np.testing.assert_array_equal(downsample(torch.from_numpy(y), k, offset), y[:, kept])


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_gradients_and_float32(align: Alignment) -> None:
    def run(y: Tensor) -> tuple[Tensor, Tensor]:
        return upsample(y, 3, 10, align), downsample(y, 3, 1)

    assert torch.autograd.gradcheck(run, (torch.from_numpy(noise(3, 7, 2)).requires_grad_(),))
    assert run(torch.ones(1, 5, 2))[0].dtype == torch.float32


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
