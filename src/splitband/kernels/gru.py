"""A GRU's rollout, forward and backward, in compiled code (paper, Eqs. 8 and 9).

With x = [y, u, 1], the biases as the last columns of W, and `torch.nn.GRU`'s formulas,

    r = sigma(W_r x + U_r h),  z = sigma(W_z x + U_z h),  m = U_n h + c_n,
    n = tanh(W_n x + r m),     h' = n + z (h - n),        y = C h + c.

A step keeps the planes r, z, m, n, so that U takes the first three and W all but m.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numba import njit
from torch import Tensor
from torch.autograd.function import once_differentiable

from splitband.kernels.common import JIT, pad, run_rows, split_rows, tanh, zeros
from splitband.kernels.matmul import PAD, matmul

# Rows of gate gradients to gather before a product with them: enough to keep sums in registers,
# few enough to stay in the cache.
_GATHER = 128


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
    """Gru rollout"""
    weights = (weight_ih, weight_hh, bias_ih, bias_hh, weight_out, bias_out)
    u = y_warmup.new_empty(len(y_warmup), y_warmup.shape[1] + steps, 0) if u is None else u
    if torch.is_grad_enabled() and any(t.requires_grad for t in (y_warmup, u, *weights)):
        y: Tensor = _Rollout.apply(y_warmup, u, steps, *weights)  # type: ignore[no-untyped-call]
        return y
    return _simulate(y_warmup, u, steps, _pack(*weights), keep=False)[0]


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, y_warmup: Tensor, u: Tensor, steps: int, *weights: Tensor) -> Tensor:
        wx, wh, wy = _pack(*weights)
        y, x, h, gates = _simulate(y_warmup, u, steps, (wx, wh, wy), keep=True)
        ctx.save_for_backward(*weights, wx, *x, *h, *gates)
        ctx.shapes = y_warmup.shape, u.shape
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, dy: Tensor) -> tuple[Tensor | None, ...]:
        weight_ih, weight_hh, _, _, weight_out, _, wx, *saved = ctx.saved_tensors
        batch, warmup, ny, nu = *ctx.shapes[0], ctx.shapes[1][2]
        size = weight_hh.shape[1]
        n = len(saved) // 3
        dy_warmup, du = zeros(dy, *ctx.shapes[0]), zeros(dy, *ctx.shapes[1])
        dy = dy.contiguous()
        inputs = ctx.needs_input_grad[0] or ctx.needs_input_grad[1]
        whh, wih = (pad(w.detach().view(-1, size, w.shape[1])) for w in (weight_hh, weight_ih))
        wy = pad(weight_out)
        jobs = []
        grads = []
        at = 0
        for i in range(n):
            x, h, gates = saved[i::n]
            rows = x.shape[1]
            width = h.shape[2]
            p = slice(at, at + rows); at += rows
            block = max(1, _GATHER // rows)
            dgates = h.new_empty(4, block, rows, width)
            grads.append((zeros(wx, *wx.shape), zeros(wx, *whh.shape), zeros(wx, ny, width), zeros(wx, ny)))
            jobs.append((inputs, dy[p], x, h, gates, dgates, wih, whh, wy, *grads[-1], dy_warmup[p], du[p]))
        run_rows(_backward, jobs)
        dwx, dwh, dwy, dby = (sum(g.numpy() for g in gs) for gs in zip(*grads))
        k = [0, 1, 3]
        t = torch.from_numpy
        return (
            dy_warmup, du, None,
            t(dwx[k, :-1, :size].transpose(0, 2, 1).reshape(3 * size, ny + nu)),
            t(dwh[:, :, :size].reshape(3 * size, size)),
            t(dwx[k, -1, :size].reshape(-1)),
            t(dwx[:3, -1, :size].reshape(-1)),
            t(dwy[:, :size]), t(dby),
        )


def _pack(weight_ih, weight_hh, bias_ih, bias_hh, weight_out, bias_out):
    size = weight_hh.shape[1]
    wx = np.zeros((4, weight_ih.shape[1] + 1, size), weight_ih.detach().numpy().dtype)
    wx[[0, 1, 3], :-1] = weight_ih.detach().numpy().reshape(3, size, -1).transpose(0, 2, 1)
    wx[[0, 1, 3], -1] = bias_ih.detach().numpy().reshape(3, size)
    wx[:3, -1] += bias_hh.detach().numpy().reshape(3, size)
    wh = weight_hh.detach().view(3, size, size).transpose(1, 2)
    wy = torch.cat([weight_out.detach().t(), bias_out.detach()[None]])
    return pad(torch.from_numpy(wx)), pad(wh), pad(wy)


def _simulate(y_warmup, u, steps, weights, keep):
    batch, warmup, ny = y_warmup.shape
    wx, wh, wy = weights
    size, width = wh.shape[1:]
    last = warmup + steps - 1
    slots = last if keep else 1
    parts = split_rows(batch, 4.0 * batch * last * width * (size + PAD))
    y = y_warmup.new_empty(batch, steps, ny)
    x = [wx.new_empty(slots + 1, p.stop - p.start, wx.shape[1]) for p in parts]
    h = [wx.new_empty(slots + 1, p.stop - p.start, width) for p in parts]
    gates = [wx.new_empty(slots, 4, p.stop - p.start, width) for p in parts]
    y_warmup, u = y_warmup.contiguous(), u.contiguous()
    run_rows(_forward, [(y_warmup[p], u[p], wx, wh, wy, *state, y[p]) for p, *state in zip(parts, x, h, gates)])
    return y, x, h, gates


@njit(nogil=True, cache=True, **JIT)
def _forward(y_warmup, u, wx, wh, wy, xs, hs, gates, y):
    rows, warmup, ny = y_warmup.shape
    one, size = ny + u.shape[2], wh.shape[1]
    last = warmup + y.shape[1] - 1
    seen = np.empty((rows, wy.shape[1]), y.dtype)
    hs[0] = 0
    for t in range(last + 1):
        x, h = xs[t % len(xs)], hs[t % len(hs)]
        x[:, one] = 1
        if t < warmup:
            x[:, :ny] = y_warmup[:, t]
        else:
            matmul(seen, x[:, one:], wy[size:], False)
            matmul(seen, h[:, :size], wy[:size], True)
            x[:, :ny] = seen[:, :ny]
            y[:, t - warmup] = seen[:, :ny]
        if t == last:
            break
        x[:, ny:one] = u[:, t]
        g = gates[t % len(gates)]
        r, z, m, n = g[0], g[1], g[2], g[3]
        matmul(r, x, wx[0], False)
        matmul(z, x, wx[1], False)
        matmul(m, x[:, one:], wx[2, one:], False)
        matmul(n, x, wx[3], False)
        matmul(r, h[:, :size], wh[0], True)
        matmul(z, h[:, :size], wh[1], True)
        matmul(m, h[:, :size], wh[2], True)
        h_next = hs[(t + 1) % len(hs)]
        _gate(r.ravel(), z.ravel(), m.ravel(), n.ravel(), h.ravel(), h_next.ravel())


@njit(**JIT)
def _gate(r, z, m, n, h, h_next):
    half = r.dtype.type(0.5)
    for j in range(r.size):
        r[j] = half + half * tanh(half * r[j])
        z[j] = half + half * tanh(half * z[j])
        n[j] = tanh(n[j] + r[j] * m[j])
        h_next[j] = n[j] + z[j] * (h[j] - n[j])


@njit(nogil=True, cache=True, **JIT)
def _backward(inputs, dy, xs, hs, gates, dgates, wih, whh, wy, dwx, dwh, dwy, dby, dy_warmup, du):
    rows, warmup, ny = dy_warmup.shape
    one, size, width = ny + du.shape[2], whh.shape[1], whh.shape[2]
    last = warmup + dy.shape[1] - 1
    dh, dx = np.zeros((rows, width), dy.dtype), np.zeros((rows, wih.shape[2]), dy.dtype)
    for t in range(last, -1, -1):
        if t >= warmup:
            total = dy[:, t - warmup] + dx[:, :ny]
            matmul(dh, total, wy, True)
            matmul(dwy, total.T, hs[t], True)
            for i in range(ny):
                dby[i] += total[:, i].sum()
        elif inputs:
            dy_warmup[:, t] = dx[:, :ny]
        if t == 0:
            break
        s = t - 1
        block = s % dgates.shape[1]
        g = gates[s]
        r, z, m, n = g[0], g[1], g[2], g[3]
        dr, dz, dm, dn = dgates[0, block], dgates[1, block], dgates[2, block], dgates[3, block]
        _gate_back(r.ravel(), z.ravel(), m.ravel(), n.ravel(), hs[s].ravel(), dr.ravel(), dz.ravel(), dm.ravel(), dn.ravel(), dh.ravel())
        matmul(dh, dr[:, :size], whh[0], True)
        matmul(dh, dz[:, :size], whh[1], True)
        matmul(dh, dm[:, :size], whh[2], True)
        if inputs or s >= warmup:
            matmul(dx, dr[:, :size], wih[0], False)
            matmul(dx, dz[:, :size], wih[1], True)
            matmul(dx, dn[:, :size], wih[2], True)
        if inputs:
            du[:, s] = dx[:, ny:one]
        if block == 0:
            stop = min(s + dgates.shape[1], last)
            x = xs[s:stop].reshape(-1, one + 1)
            h = hs[s:stop].reshape(-1, width)
            for p in range(4):
                dg = dgates[p].reshape(-1, width)[: len(x)]
                first = one if p == 2 else 0
                matmul(dwx[p, first:], x[:, first:].T, dg, True)
                if p < 3:
                    matmul(dwh[p], dg[:, :size].T, h, True)


@njit(**JIT)
def _gate_back(r, z, m, n, h, dr, dz, dm, dn, dh):
    one = r.dtype.type(1)
    for j in range(r.size):
        dn[j] = dh[j] * (one - z[j]) * (one - n[j] * n[j])
        dz[j] = dh[j] * (h[j] - n[j]) * z[j] * (one - z[j])
        dm[j] = dn[j] * r[j]
        dr[j] = dm[j] * m[j] * (one - r[j])
        dh[j] = dh[j] * z[j]
