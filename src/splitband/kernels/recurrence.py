"""Compile the recurrence of an IIR filter over the rows of a batch."""

from __future__ import annotations

import numpy as np

from splitband.kernels.common import Array, kernel

_LANES = 8
"""Rows in a vector."""


@kernel
def recurrence(b: Array, a: Array, state: Array, x: Array, y: Array, reverse: bool) -> None:
    """Filter the rows of `x` `(rows, time)` into `y`, possibly `x` itself.

    Parameters
    ----------
    b, a : Coefficients `(P + 1,)`, a_0 = 1.
    state : `(rows, P)` before the first sample, as in `scipy.signal.lfilter` (transposed direct
        form II).
    reverse : From the last sample to the first.
    """
    order, samples = state.shape[1], x.shape[1]
    for first in range(0, len(x), _LANES):
        n = min(_LANES, len(x) - first)
        s, sample, out = np.zeros((order + 1, _LANES)), np.zeros(_LANES), np.zeros(_LANES)
        for m in range(order):
            for j in range(n):
                s[m, j] = state[first + j, m]
        for k in range(samples):
            t = samples - 1 - k if reverse else k
            for j in range(n):
                sample[j] = x[first + j, t]
            for j in range(_LANES):
                out[j] = b[0] * sample[j] + s[0, j]
            for m in range(order):
                for j in range(_LANES):
                    s[m, j] = b[m + 1] * sample[j] - a[m + 1] * out[j] + s[m + 1, j]
            for j in range(n):
                y[first + j, t] = out[j]
