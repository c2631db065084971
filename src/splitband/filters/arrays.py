"""Filter NumPy arrays by SciPy; `tensors` has the same functions for tensors."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array

xp = np


def rows(x: npt.ArrayLike, axis: int) -> Array:
    """Return a signal in float64 with its time axis last."""
    return np.moveaxis(np.asarray(x, np.float64), axis, -1)


def signal(y: Array, axis: int, like: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return filtered rows with the axes of the signal `like`, and its dtype if it is floating."""
    kind = like.dtype if np.issubdtype(like.dtype, np.floating) else np.float64
    return np.ascontiguousarray(np.moveaxis(y, -1, axis), kind)


def one_pass(b: Array, a: Array, x: Array, state: Array, reverse: bool = False) -> Array:
    """Filter `(..., time)` from `state` `(..., P)`; `reverse`: from the last sample to the first.

    The state is that of the transposed direct form II, as in `scipy.signal.lfilter`.
    """
    if not x.size:
        return x
    order = slice(None, None, -1 if reverse else 1)
    return np.asarray(scipy.signal.lfilter(b, a, x[..., order], zi=state)[0][..., order])
