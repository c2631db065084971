"""Down-sample and up-sample signals by a factor k (Ensinger et al. 2023, Sec. 4.2).

Signals are `(time,)`, `(time, ny)` or `(batch, time, ny)`.
NumPy in, NumPy out; torch in, torch out.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from splitband.filters.iir import Signal
from splitband.runtime.errors import InputError

Alignment = Literal["time", "paper"]


def check_downsampling(downsampling: int, cutoff: float, sampling_rate: float) -> None:
    """Check that down-sampling keeps frequencies up to `cutoff`: 2 cutoff < sampling_rate / k."""
    if downsampling < 1:
        raise InputError(f"downsampling must be at least 1, got {downsampling}")
    nyquist = sampling_rate / downsampling / 2
    if not cutoff < nyquist:
        best = next((k for k in range(downsampling, 0, -1) if cutoff < sampling_rate / k / 2), None)
        advice = f"; at most {best} will do" if best else ""
        raise InputError(
            f"downsampling by {downsampling} leaves a Nyquist frequency of {nyquist:g} Hz, which "
            f"must exceed the cut-off of {cutoff:g} Hz{advice}"
        )


def downsample(y: Signal, k: int, offset: int = 0) -> Signal:
    """Return every k-th sample from `offset` on (Ensinger et al. 2023, Eq. 9, down-sampling)."""
    if k < 1:
        raise InputError(f"k must be at least 1, got {k}")
    if offset < 0:
        raise InputError(f"offset must not be negative, got {offset}")
    return y[offset::k] if y.ndim == 1 else y[..., offset::k, :]


def upsample(y: Signal, k: int, length: int | None = None, align: Alignment = "time") -> Signal:
    """Insert k - 1 samples after each one by linear interpolation (Ensinger et al. 2023, Sec. 4.2).

    y : The down-sampled signal, n samples.
    k : The factor.
    length : Number of samples to return, at most k n; all by default.
    align : `"time"` keeps sample j of `y` at index j k, and repeats the last sample k - 1 times;
        `"paper"` is torch's `align_corners=False`, which shifts time by (k - 1) / 2 samples.
    """
    if k < 1:
        raise InputError(f"k must be at least 1, got {k}")
    if align not in get_args(Alignment):
        raise InputError(f"align must be one of {get_args(Alignment)}, got {align!r}")
    import torch  # noqa: PLC0415  `check_downsampling` and `downsample` need no torch

    from splitband.filters.tensors import floating  # noqa: PLC0415

    slow = floating(y)[:, None] if y.ndim == 1 else floating(y)
    n = slow.shape[-2]
    length = k * n if length is None else length
    if not 0 <= length <= k * n:
        raise InputError(f"length must be at most k n = {k * n}, got {length}")
    if align == "paper":
        batch = slow.reshape(-1, n, slow.shape[-1]).transpose(1, 2)
        fast = torch.nn.functional.interpolate(batch, scale_factor=float(k), mode="linear")
        fast = fast.transpose(1, 2).reshape(*slow.shape[:-2], k * n, slow.shape[-1])
    else:
        following = torch.cat([slow[..., 1:, :], slow[..., -1:, :]], dim=-2)
        fraction = torch.arange(k, dtype=slow.dtype, device=slow.device)[:, None] / k
        between = torch.lerp(slow[..., :, None, :], following[..., :, None, :], fraction)
        fast = between.flatten(-3, -2)
    fast = fast[:length, 0] if y.ndim == 1 else fast[..., :length, :]
    return fast.numpy() if isinstance(y, np.ndarray) else fast
