"""Compile the rollout of a GRU, forward and backward.

With x = [y, u, 1], the biases as last columns of W, and the formulas of `torch.nn.GRU`,

    r = sigma(W_r x + U_r h),  z = sigma(W_z x + U_z h),  m = U_m h + c_m,
    n = tanh(W_n x + r m),     h' = n + z (h - n),        y = C h + c.

The gates of a step are stored as planes r, z, m, n: U has the first three, W all but m.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from splitband.kernels.common import PAD, Array, Arrays, copy, kernel, part, tanh
from splitband.kernels.matmul import matmul
from splitband.kernels.rollouts import Kernel, Shapes, gradient_steps, pad, run, split_rows

_W_PLANES = [0, 1, 3]
"""Planes of gates that W has, out of r, z, m and n."""


def gru_rollout(
    y_warmup: Tensor,
    steps: int,
    u: Tensor | None,
    *weights: Tensor,
) -> Tensor:
    """Warm up from h = 0 on measured samples, then simulate (paper, Eq. 8, rollout).

    Differentiable once, with respect to every tensor.

    Returns the samples R..R+steps-1, shape `(batch, steps, ny)`.

    Parameters
    ----------
    y_warmup : Measured samples `(batch, R, ny)`, float32 or float64.
    steps : Number of samples to simulate.
    u : Known inputs `(batch, R + steps - 1, nu)` or longer, or None.
    weights : `(3 H, ny + nu)` and `(3 H, H)`, gates r, z, n as in `torch.nn.GRUCell`; their biases,
        `(3 H,)` each; C `(ny, H)` and c `(ny,)`.
    """
    batch, warmup, ny = y_warmup.shape
    last = warmup + steps - 1
    u = y_warmup.new_empty(batch, last, 0) if u is None else u
    kernel = _GRU(batch, steps, ny, u.shape[-1], last, _forward, _backward)
    return run(kernel, (y_warmup, u), weights)


@dataclass(frozen=True)
class _GRU(Kernel):
    """Keep x, h and the gates of all steps."""

    def pack(self, *weights: Array) -> Arrays:
        """Pack W' and U' by planes, and C' over c, to multiply from the right."""
        weight_ih, weight_hh, bias_ih, bias_hh, weight_out, bias_out = weights
        size = weight_hh.shape[1]
        wx = np.zeros((4, weight_ih.shape[1] + 1, size), weight_ih.dtype)
        wx[_W_PLANES, :-1] = weight_ih.reshape(3, size, -1).transpose(0, 2, 1)
        wx[_W_PLANES, -1] = bias_ih.reshape(3, size)
        wx[:3, -1] += bias_hh.reshape(3, size)
        wh = weight_hh.reshape(3, size, size).transpose(0, 2, 1)
        return pad(wx), pad(wh), pad(np.concatenate([weight_out.T, bias_out[None]]))

    def pack_back(self, *weights: Array) -> Arrays:
        weight_ih, weight_hh, _, _, weight_out, _ = weights
        wih, whh = (pad(w.reshape(3, weight_hh.shape[1], -1)) for w in (weight_ih, weight_hh))
        return wih, whh, pad(weight_out)

    def split(self, packed: Arrays) -> list[slice]:
        width = packed[1].shape[2]
        return split_rows(self.batch, 4.0 * self.batch * self.last * width * (width + PAD))

    def kept(self, packed: Arrays, rows: int, keep: bool) -> Shapes:
        wx, wh, _ = packed
        slots, width = max(self.last, 1) if keep else 1, wh.shape[2]
        return (slots + 1, rows, wx.shape[1]), (slots + 1, rows, width), (slots, 4, rows, width)

    def scratch(self, packed: Arrays, rows: int) -> Shapes:
        return ((4, gradient_steps(rows), rows, packed[1].shape[2]),)

    def sums(self, packed: Arrays) -> Shapes:
        _, whh, wy = packed
        return (4, self.ny + self.nu + 1, whh.shape[2]), whh.shape, wy.shape, (self.ny,)

    def unpack(self, *sums: Array) -> Iterable[Array]:
        dwx, dwh, dwy, dby = sums
        size = dwh.shape[1]
        dw = dwx[_W_PLANES, :, :size].transpose(0, 2, 1).reshape(3 * size, -1)
        du, db = dwh[:, :, :size].reshape(3 * size, size), dwx[:3, -1, :size].reshape(-1)
        return dw[:, :-1], du, dw[:, -1], db, dwy, dby


@kernel
def _forward(inputs: Arrays, weights: Arrays, buffers: Arrays, y: Array) -> None:
    y_warmup, u = inputs
    wx, wh, wy = weights
    xs, hs, gates = buffers
    rows, warmup, ny = y_warmup.shape
    one, size = ny + u.shape[2], wh.shape[1]
    last = warmup + y.shape[1] - 1
    sample = np.empty((rows, wy.shape[1]), y.dtype)
    hs[0] = 0
    for t in range(last + 1):
        x, h = xs[t % len(xs)], hs[t % len(hs)]
        x[:, one] = 1
        if t < warmup:
            copy(x, y_warmup[:, t])
        else:
            matmul(sample, x[:, one:], wy[size:], False)
            matmul(sample, h[:, :size], wy[:size], True)
            copy(x, sample[:, :ny])
            copy(y[:, t - warmup], sample[:, :ny])
        if t == last:
            break
        copy(x[:, ny:], u[:, t])
        g = gates[t % len(gates)]
        for p in range(4):
            first = one if p == 2 else 0
            matmul(g[p], x[:, first:], wx[p, first:], False)
        for p in range(3):
            matmul(g[p], h[:, :size], wh[p], True)
        _gate(g.reshape(4, -1), h.reshape(-1), hs[(t + 1) % len(hs)].reshape(-1))


@part
def _gate(g: Array, h: Array, h_next: Array) -> None:
    r, z, m, n = g[0], g[1], g[2], g[3]
    half = h.dtype.type(0.5)
    for j in range(h.size):
        r[j] = half + half * tanh(half * r[j])
        z[j] = half + half * tanh(half * z[j])
        n[j] = tanh(n[j] + r[j] * m[j])
        h_next[j] = n[j] + z[j] * (h[j] - n[j])


@kernel
def _backward(
    wanted: bool, dy: Array, weights: Arrays, buffers: Arrays, sums: Arrays, gradients: Arrays
) -> None:
    wih, whh, wy = weights
    xs, hs, gates, dgates = buffers
    dwx, dwh, dwy, dby = sums
    dy_warmup, du = gradients
    rows, warmup, ny = dy_warmup.shape
    one, size, width = ny + du.shape[2], whh.shape[1], whh.shape[2]
    last = warmup + dy.shape[1] - 1
    dh, dx = np.zeros((rows, width), dy.dtype), np.zeros((rows, wih.shape[2]), dy.dtype)
    for t in range(last, -1, -1):
        if t >= warmup:
            dsample = dy[:, t - warmup] + dx[:, :ny]
            for i in range(ny):
                dby[i] += dsample[:, i].sum()
            matmul(dwy, dsample.T, hs[t], True)
            matmul(dh, dsample, wy, True)
        elif wanted:
            copy(dy_warmup[:, t], dx[:, :ny])
        if t == 0:
            break
        s = t - 1
        step = s % dgates.shape[1]
        _gate_back(gates[s].reshape(4, -1), hs[s].reshape(-1), dgates, step, dh.reshape(-1))
        for p in range(3):
            matmul(dh, dgates[p, step, :, :size], whh[p], True)
        if wanted or s >= warmup:
            for i in range(3):
                p = i if i < 2 else 3
                matmul(dx, dgates[p, step, :, :size], wih[i], i > 0)
        if wanted:
            copy(du[:, s], dx[:, ny:one])
        if step == 0:
            stop = min(s + dgates.shape[1], last)
            _gather(dwx, dwh, xs[s:stop], hs[s:stop], dgates)


@part
def _gate_back(g: Array, h: Array, dgates: Array, step: int, dh: Array) -> None:
    r, z, m, n = g[0], g[1], g[2], g[3]
    dr, dz = dgates[0, step].reshape(-1), dgates[1, step].reshape(-1)
    dm, dn = dgates[2, step].reshape(-1), dgates[3, step].reshape(-1)
    one = h.dtype.type(1)
    for j in range(h.size):
        dn[j] = dh[j] * (one - z[j]) * (one - n[j] * n[j])
        dz[j] = dh[j] * (h[j] - n[j]) * z[j] * (one - z[j])
        dm[j] = dn[j] * r[j]
        dr[j] = dm[j] * m[j] * (one - r[j])
        dh[j] = dh[j] * z[j]


@part
def _gather(dwx: Array, dwh: Array, xs: Array, hs: Array, dgates: Array) -> None:
    x, h = xs.reshape(-1, xs.shape[2]), hs.reshape(-1, hs.shape[2])
    for p in range(4):
        dg = dgates[p].reshape(-1, h.shape[1])[: len(h)]
        first = x.shape[1] - 1 if p == 2 else 0
        matmul(dwx[p, first:], x[:, first:].T, dg, True)
        if p < 3:
            matmul(dwh[p], dg[:, : dwh.shape[1]].T, h, True)
