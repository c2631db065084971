"""Compile the rollout of a GRU, forward and backward.

With x = [y, u, 1], the biases as last columns of W, and the formulas of `torch.nn.GRU`,

    r = sigma(W_r x + U_r h),  z = sigma(W_z x + U_z h),  m = U_m h + c_m,
    n = tanh(W_n x + r m),     h' = n + z (h - n),        y = C h + c.

The gates of a step are kept as planes r, z, m, n: U has the first three, W all but m.
"""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from splitband.kernels.common import (
    PAD,
    Array,
    add,
    array,
    buffers,
    check,
    copy,
    kernel,
    pad,
    part,
    run_rows,
    split_rows,
    tanh,
    zeros,
)
from splitband.kernels.matmul import matmul

_W_PLANES = [0, 1, 3]
"""Planes of gates that W has, out of r, z, m and n."""
_GRADIENT_ROWS = 64
"""Rows of gate gradients worth a product with them."""


def gru_rollout(
    y_warmup: Tensor,
    steps: int,
    u: Tensor | None,
    weight_ih: Tensor,
    weight_hh: Tensor,
    bias_ih: Tensor,
    bias_hh: Tensor,
    weight_out: Tensor,
    bias_out: Tensor,
) -> Tensor:
    """Warm up from h = 0 on measured samples, then simulate (paper, Eq. 8, rollout).

    Differentiable once, with respect to every tensor. Without gradients the memory does not grow
    with the steps, apart from the result.

    Returns the samples R..R+steps-1, shape `(batch, steps, ny)`.

    Parameters
    ----------
    y_warmup : Measured samples `(batch, R, ny)`, float32 or float64.
    steps : How many samples to simulate.
    u : Known inputs `(batch, R + steps - 1, nu)` or longer, or None.
    weight_ih, weight_hh : `(3 H, ny + nu)` and `(3 H, H)`, gates r, z, n as in `torch.nn.GRUCell`.
    bias_ih, bias_hh : `(3 H,)` each.
    weight_out, bias_out : C `(ny, H)` and c `(ny,)`.
    """
    batch, warmup, ny = y_warmup.shape
    size, last = weight_hh.shape[-1], warmup + steps - 1
    u = y_warmup.new_empty(batch, last, 0) if u is None else u
    check(
        y_warmup,
        u=(u, (batch, max(last, *u.shape[1:2]), u.shape[-1])),
        weight_ih=(weight_ih, (3 * size, ny + u.shape[-1])),
        weight_hh=(weight_hh, (3 * size, size)),
        bias_ih=(bias_ih, (3 * size,)),
        bias_hh=(bias_hh, (3 * size,)),
        weight_out=(weight_out, (ny, size)),
        bias_out=(bias_out, (ny,)),
    )
    weights = (weight_ih, weight_hh, bias_ih, bias_hh, weight_out, bias_out)
    if torch.is_grad_enabled() and any(t.requires_grad for t in (y_warmup, u, *weights)):
        y: Tensor = _Rollout.apply(y_warmup, u, steps, *weights)  # type: ignore[no-untyped-call]
        return y
    return _simulate(y_warmup, u, steps, weights, keep=False)[0]


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, y_warmup: Tensor, u: Tensor, steps: int, *weights: Tensor) -> Tensor:
        y, ctx.rows, kept = _simulate(y_warmup, u, steps, weights, keep=True)
        ctx.save_for_backward(*weights, *chain(*kept))
        ctx.shapes = y_warmup.shape, u.shape
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, dy: Tensor) -> tuple[Tensor | None, ...]:
        weight_ih, weight_hh, _, _, weight_out, _, *kept = ctx.saved_tensors
        ny, size = weight_out.shape
        wih, whh = (pad(w.reshape(3, size, -1)) for w in (weight_ih, weight_hh))
        wy, dy = pad(weight_out), dy.contiguous()
        dy_warmup, du = (zeros(dy, *shape) for shape in ctx.shapes)
        wanted = ctx.needs_input_grad[0] or ctx.needs_input_grad[1]
        sizes = ((4, weight_ih.shape[1] + 1, whh.shape[2]), whh.shape, wy.shape, (ny,))
        sums = [[zeros(dy, *size) for size in sizes] for _ in ctx.rows]
        jobs = []
        for i, rows in enumerate(ctx.rows):
            n = rows.stop - rows.start
            dgates = dy.new_empty(4, -(-_GRADIENT_ROWS // max(n, 1)), n, whh.shape[2])
            saved = (*kept[3 * i : 3 * i + 3], dgates, wih, whh, wy)
            jobs.append((wanted, dy[rows], *saved, *sums[i], dy_warmup[rows], du[rows]))
        run_rows(_backward, jobs)
        return dy_warmup, du, None, *_unpack(size, *add(sums))


def _simulate(
    y_warmup: Tensor, u: Tensor, steps: int, weights: tuple[Tensor, ...], keep: bool
) -> tuple[Tensor, list[slice], list[list[Tensor]]]:
    """Return the samples, the rows of each job, and x, h and gates of every step or the last."""
    packed = wx, wh, _ = _pack(*(array(w) for w in weights))
    batch, warmup, ny = y_warmup.shape
    width, last = wh.shape[2], warmup + steps - 1
    slots = max(last, 1) if keep else 1
    split = split_rows(batch, 4.0 * batch * last * width * (width + PAD))
    y = y_warmup.new_empty(batch, steps, ny)
    y_warmup, u = y_warmup.contiguous(), u.contiguous()
    sizes = (slots + 1, wx.shape[1]), (slots + 1, width), (slots, 4, width)
    kept = buffers(y, split, *sizes)
    jobs = [
        (y_warmup[rows], u[rows], *packed, *saved, y[rows])
        for rows, saved in zip(split, kept, strict=True)
    ]
    run_rows(_forward, jobs)
    return y, split, kept


def _pack(
    weight_ih: Array,
    weight_hh: Array,
    bias_ih: Array,
    bias_hh: Array,
    weight_out: Array,
    bias_out: Array,
) -> tuple[Tensor, Tensor, Tensor]:
    """Pack W' and U' by planes, and C' over c, all to multiply from the right."""
    size = weight_hh.shape[1]
    wx = np.zeros((4, weight_ih.shape[1] + 1, size), weight_ih.dtype)
    wx[_W_PLANES, :-1] = weight_ih.reshape(3, size, -1).transpose(0, 2, 1)
    wx[_W_PLANES, -1] = bias_ih.reshape(3, size)
    wx[:3, -1] += bias_hh.reshape(3, size)
    wh = weight_hh.reshape(3, size, size).transpose(0, 2, 1)
    return pad(wx), pad(wh), pad(np.concatenate([weight_out.T, bias_out[None]]))


def _unpack(size: int, dwx: Array, dwh: Array, dwy: Array, dby: Array) -> list[Tensor]:
    """Return the gradients in the order and shapes of the weights."""
    dw = dwx[_W_PLANES, :, :size].transpose(0, 2, 1).reshape(3 * size, -1)
    du = dwh[:, :, :size].reshape(3 * size, size)
    db = dwx[:3, -1, :size].reshape(-1)
    return [torch.from_numpy(d) for d in (dw[:, :-1], du, dw[:, -1], db, dwy[:, :size], dby)]


@kernel
def _forward(
    y_warmup: Array,
    u: Array,
    wx: Array,
    wh: Array,
    wy: Array,
    xs: Array,
    hs: Array,
    gates: Array,
    y: Array,
) -> None:
    rows, warmup, ny = y_warmup.shape
    one, size = ny + u.shape[2], wh.shape[1]
    last = warmup + y.shape[1] - 1
    seen = np.empty((rows, wy.shape[1]), y.dtype)
    hs[0] = 0
    for t in range(last + 1):
        x, h = xs[t % len(xs)], hs[t % len(hs)]
        x[:, one] = 1
        if t < warmup:
            copy(x, y_warmup[:, t])
        else:
            matmul(seen, x[:, one:], wy[size:], False)
            matmul(seen, h[:, :size], wy[:size], True)
            copy(x, seen[:, :ny])
            copy(y[:, t - warmup], seen[:, :ny])
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
    wanted: bool,
    dy: Array,
    xs: Array,
    hs: Array,
    gates: Array,
    dgates: Array,
    wih: Array,
    whh: Array,
    wy: Array,
    dwx: Array,
    dwh: Array,
    dwy: Array,
    dby: Array,
    dy_warmup: Array,
    du: Array,
) -> None:
    rows, warmup, ny = dy_warmup.shape
    one, size, width = ny + du.shape[2], whh.shape[1], whh.shape[2]
    last = warmup + dy.shape[1] - 1
    dh, dx = np.zeros((rows, width), dy.dtype), np.zeros((rows, wih.shape[2]), dy.dtype)
    for t in range(last, -1, -1):
        if t >= warmup:
            seen = dy[:, t - warmup] + dx[:, :ny]
            for i in range(ny):
                dby[i] += seen[:, i].sum()
            matmul(dwy, seen.T, hs[t], True)
            matmul(dh, seen, wy, True)
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
