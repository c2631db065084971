"""Compile the recurrence of an IIR filter over the rows of a batch."""

from __future__ import annotations

import numpy as np

from splitband.kernels.common import Array, kernel, part

_LANES = 8
"""Rows that run side by side, in one vector."""


@kernel
def recurrence(b: Array, a: Array, state: Array, x: Array, y: Array, reverse: bool) -> None:
    """Filter each row of `x` `(rows, time)` into `y`, which may be `x` itself.

    Parameters
    ----------
    b, a : Coefficients `(P + 1,)`, a_0 = 1.
    state : `(rows, P)` before the first sample, as in `scipy.signal.lfilter` (transposed direct
        form II).
    reverse : From the last sample to the first.
    """
    rows = len(x)
    alone = rows % _LANES if rows % _LANES < _LANES // 2 else 0
    for i in range(0, rows - alone, _LANES):
        _side_by_side(b, a, state, x, y, reverse, i, min(_LANES, rows - i))
    for i in range(rows - alone, rows):
        _one(b, a, state, x, y, reverse, i)


@part
def _side_by_side(
    b: Array, a: Array, state: Array, x: Array, y: Array, reverse: bool, first: int, n: int
) -> None:
    order, samples = state.shape[1], x.shape[1]
    s, seen, out = np.zeros((order + 1, _LANES)), np.zeros(_LANES), np.zeros(_LANES)
    for m in range(order):
        for j in range(n):
            s[m, j] = state[first + j, m]
    for k in range(samples):
        t = samples - 1 - k if reverse else k
        for j in range(n):
            seen[j] = x[first + j, t]
        for j in range(_LANES):
            out[j] = b[0] * seen[j] + s[0, j]
        for m in range(order):
            for j in range(_LANES):
                s[m, j] = b[m + 1] * seen[j] - a[m + 1] * out[j] + s[m + 1, j]
        for j in range(n):
            y[first + j, t] = out[j]


@part
def _one(b: Array, a: Array, state: Array, x: Array, y: Array, reverse: bool, row: int) -> None:
    order, samples = state.shape[1], x.shape[1]
    s = np.zeros(order + 1)
    for m in range(order):
        s[m] = state[row, m]
    for k in range(samples):
        t = samples - 1 - k if reverse else k
        seen = x[row, t]
        out = b[0] * seen + s[0]
        for m in range(order):
            s[m] = b[m + 1] * seen - a[m + 1] * out + s[m + 1]
        y[row, t] = out
