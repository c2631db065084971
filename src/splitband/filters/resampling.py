"""Down-sample and up-sample signals by a factor k (Ensinger et al. 2023, Sec. 4.2).

Signals are tensors `(batch, time, ny)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

Alignment = Literal["time", "paper"]


def check_downsampling(downsampling: int, cutoff: float, sampling_rate: float) -> None:
    """Check that down-sampling keeps frequencies up to `cutoff`: 2 cutoff < sampling_rate / k."""
    nyquist = sampling_rate / downsampling / 2
    if not cutoff < nyquist:
        best = next((k for k in range(downsampling, 0, -1) if cutoff < sampling_rate / k / 2), None)
        advice = f"; at most {best} will do" if best else ""
        raise InputError(
            f"downsampling by {downsampling} leaves a Nyquist frequency of {nyquist:g} Hz, which "
            f"must exceed the cut-off of {cutoff:g} Hz{advice}"
        )


def downsample(y: Tensor, k: int, offset: int) -> Tensor:
    """Return every k-th sample from `offset` on (Ensinger et al. 2023, Eq. 9, down-sampling)."""
    return y[:, offset::k]


def upsample(y: Tensor, k: int, length: int, align: Alignment) -> Tensor:
    """Insert k - 1 samples after each one by linear interpolation (paper, Sec. 4.2).

    y : The down-sampled signal, n samples.
    k : The factor.
    length : Number of samples to return, at most k n.
    align : `"time"` keeps sample j of `y` at index j k, and repeats the last sample k - 1 times;
        `"paper"` is torch's `align_corners=False`, which shifts time by (k - 1) / 2 samples.
    """
    if align not in get_args(Alignment):
        raise InputError(f"align must be one of {get_args(Alignment)}, got {align!r}")
    import torch  # noqa: PLC0415  `check_downsampling` needs no torch

    if align == "paper":
        interpolate = torch.nn.functional.interpolate
        fast = interpolate(y.transpose(1, 2), scale_factor=float(k), mode="linear").transpose(1, 2)
    else:
        following = torch.cat([y[:, 1:], y[:, -1:]], dim=1)
        fraction = torch.arange(k, dtype=y.dtype, device=y.device)[:, None] / k
        fast = torch.lerp(y[:, :, None], following[:, :, None], fraction).flatten(1, 2)
    return fast[:, :length]
