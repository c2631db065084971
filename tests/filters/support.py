"""What SciPy says of a filter, and signals for it."""

import numpy as np
import scipy.signal
import torch
from torch import Tensor

from splitband.filters import Start
from splitband.runtime.arrays import Array

RATE = 10.0
CUTOFF = 1.3
ORDERS = 1, 2, 3, 6
TIGHT = 1e-10
SMALLEST = float(np.finfo(np.float64).tiny)
"""Below it numbers lose their relative accuracy."""
ONE_WAY: list[Start] = ["zeros", "steady"]
BOTH_WAYS: list[Start] = ["zeros", "steady", "odd"]


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
