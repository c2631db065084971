"""Compile the rollout of a three-layer perceptron's Euler steps, forward and backward.

With x = [h, u, 1] and the biases as last columns of the weights (paper, supplement, "MLP
training"),

    a = tanh(W_1 x),  b = tanh(W_2 [a, 1]),  h' = h + dt W_3 [b, 1],

and y is the first entries of h.
"""

from __future__ import annotations

from itertools import chain
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from splitband.kernels.common import (
    Array,
    add,
    array,
    buffers,
    check,
    copy,
    kernel,
    pad,
    padded,
    part,
    run_rows,
    split_rows,
    zeros,
)
from splitband.kernels.matmul import matmul
from splitband.kernels.state_space_lanes import tanh_back, tanh_of

_GRADIENT_ROWS = 64
"""Rows of gradients worth a product with them."""


def euler_rollout(
    h0: Tensor,
    steps: int,
    ny: int,
    step_size: float,
    u: Tensor | None,
    weight_1: Tensor,
    bias_1: Tensor,
    weight_2: Tensor,
    bias_2: Tensor,
    weight_3: Tensor,
    bias_3: Tensor,
) -> Tensor:
    """Simulate from a given state (paper, Eq. 8, rollout).

    Differentiable once, with respect to every tensor. Without gradients the memory does not grow
    with the steps, apart from the result.

    Returns the samples R..R+steps-1, shape `(batch, steps, ny)`.

    Parameters
    ----------
    h0 : The state h_R of the first sample `(batch, S)`, float32 or float64.
    steps : How many samples to simulate.
    ny : How many entries of the state are the sample.
    step_size : dt.
    u : Known inputs `(batch, steps - 1, nu)` or longer, from time R on, or None.
    weight_1, bias_1 : `(M, S + nu)` and `(M,)`.
    weight_2, bias_2 : `(N, M)` and `(N,)`.
    weight_3, bias_3 : `(S, N)` and `(S,)`.
    """
    batch, size = h0.shape
    last = max(steps - 1, 0)
    u = h0.new_empty(batch, last, 0) if u is None else u
    check(
        h0,
        u=(u, (batch, max(last, *u.shape[1:2]), u.shape[-1])),
        weight_1=(weight_1, (len(bias_1), size + u.shape[-1])),
        bias_1=(bias_1, (len(bias_1),)),
        weight_2=(weight_2, (len(bias_2), len(bias_1))),
        bias_2=(bias_2, (len(bias_2),)),
        weight_3=(weight_3, (size, len(bias_2))),
        bias_3=(bias_3, (size,)),
    )
    weights = (weight_1, bias_1, weight_2, bias_2, weight_3, bias_3)
    if torch.is_grad_enabled() and any(t.requires_grad for t in (h0, u, *weights)):
        y: Tensor = _Rollout.apply(h0, u, steps, ny, step_size, *weights)  # type: ignore[no-untyped-call]
        return y
    return _simulate(h0, u, steps, ny, step_size, weights, keep=False)[0]


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, h0: Tensor, u: Tensor, steps: int, ny: int, step_size: float, *weights: Tensor
    ) -> Tensor:
        y, ctx.rows, kept = _simulate(h0, u, steps, ny, step_size, weights, keep=True)
        ctx.save_for_backward(*weights, *chain(*kept))
        ctx.shapes, ctx.step_size = (h0.shape, u.shape), step_size
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, dy: Tensor) -> tuple[Tensor | None, ...]:
        weights, kept = ctx.saved_tensors[:6], ctx.saved_tensors[6:]
        w1, w2, w3 = (pad(w) for w in weights[::2])
        first, *_ = _pack(weights)
        dy = dy.contiguous()
        dh, du = (zeros(dy, *shape) for shape in ctx.shapes)
        sizes = first.shape, w2.shape, (1, w3.shape[1]), w3.shape, (len(w3),)
        sums = [[zeros(dy, *size) for size in sizes] for _ in ctx.rows]
        jobs = []
        for i, rows in enumerate(ctx.rows):
            n = rows.stop - rows.start
            widths = w2.shape[1], w2.shape[1], w3.shape[1], padded(len(w3))
            layers = [dy.new_empty(-(-_GRADIENT_ROWS // max(n, 1)), n, width) for width in widths]
            saved = (*kept[2 * i : 2 * i + 2], *layers, first, w1, w2, w3)
            jobs.append((ctx.step_size, dy[rows], *saved, *sums[i], dh[rows], du[rows]))
        run_rows(_backward, jobs)
        return dh, du, None, None, None, *_unpack(*weights[2].shape, *add(sums))


def _simulate(
    h0: Tensor,
    u: Tensor,
    steps: int,
    ny: int,
    step_size: float,
    weights: tuple[Tensor, ...],
    keep: bool,
) -> tuple[Tensor, list[slice], list[list[Tensor]]]:
    """Return the samples, the rows of each job, and x and b of every step or the last.

    The narrow first layer is cheap: a is computed anew on the way back.
    """
    packed = w1, w2, _ = _pack(weights)
    slots = max(steps - 1, 1) if keep else 1
    split = split_rows(len(h0), float(len(h0)) * steps * sum(w.numel() for w in packed))
    y = h0.new_empty(len(h0), steps, ny)
    h0, u = h0.contiguous(), u.contiguous()
    kept = buffers(y, split, (slots + 1, len(w1)), (slots, w2.shape[1]))
    jobs = [
        (step_size, h0[rows], u[rows], *packed, *saved, y[rows])
        for rows, saved in zip(split, kept, strict=True)
    ]
    run_rows(_forward, jobs)
    return y, split, kept


def _pack(weights: tuple[Tensor, ...]) -> tuple[Tensor, Tensor, Tensor]:
    """Pack each layer's W' over its bias, to multiply from the right."""
    w1, b1, w2, b2, w3, b3 = (array(w) for w in weights)
    pairs = (w1, b1), (w2, b2), (w3, b3)
    first, second, third = (pad(np.concatenate([w.T, bias[None]])) for w, bias in pairs)
    return first, second, third


def _unpack(
    n: int, m: int, dw1: Array, dw2: Array, db2: Array, dw3: Array, db3: Array
) -> list[Tensor]:
    """Return the gradients in the order and shapes of the weights."""
    first = dw1[:, :m].T
    grads = first[:, :-1], first[:, -1], dw2[:, :m], db2[0, :n], dw3[:, :n], db3
    return [torch.from_numpy(np.ascontiguousarray(grad)) for grad in grads]


@kernel
def _forward(
    step_size: float,
    h0: Array,
    u: Array,
    w1: Array,
    w2: Array,
    w3: Array,
    xs: Array,
    bs: Array,
    y: Array,
) -> None:
    rows, size = h0.shape
    steps, ny = y.shape[1:]
    one = size + u.shape[2]
    dt = h0.dtype.type(step_size)
    a = np.empty((rows, w1.shape[1]), y.dtype)
    change = np.empty((rows, w3.shape[1]), y.dtype)
    copy(xs[0], h0)
    for t in range(steps):
        x, x_next = xs[t % len(xs)], xs[(t + 1) % len(xs)]
        copy(y[:, t], x[:, :ny])
        if t == steps - 1:
            break
        copy(x[:, size:], u[:, t])
        x[:, one] = 1
        b = bs[t % len(bs)]
        matmul(a, x, w1, False)
        tanh_of(a.reshape(-1))
        _layer(b, a, x[:, one:], w2)
        tanh_of(b.reshape(-1))
        _layer(change, b, x[:, one:], w3)
        for i in range(rows):
            for j in range(size):
                x_next[i, j] = x[i, j] + dt * change[i, j]


@part
def _layer(out: Array, values: Array, ones: Array, w: Array) -> None:
    matmul(out, ones, w[-1:], False)
    matmul(out, values[:, : len(w) - 1], w[:-1], True)


@kernel
def _backward(
    step_size: float,
    dy: Array,
    xs: Array,
    bs: Array,
    as_: Array,
    das: Array,
    dbs: Array,
    dcs: Array,
    first: Array,
    w1: Array,
    w2: Array,
    w3: Array,
    dw1: Array,
    dw2: Array,
    db2: Array,
    dw3: Array,
    db3: Array,
    dh: Array,
    du: Array,
) -> None:
    rows, size = dh.shape
    steps, one = dy.shape[1], size + du.shape[2]
    dt = dy.dtype.type(step_size)
    dx = np.empty((rows, w1.shape[1]), dy.dtype)
    for t in range(steps - 1, -1, -1):
        _add(dh, dy[:, t])
        if t == 0:
            break
        s = t - 1
        step = s % len(das)
        a, da, db, dc = as_[step], das[step], dbs[step], dcs[step]
        for i in range(rows):
            for j in range(size):
                dc[i, j] = dt * dh[i, j]
                db3[j] += dc[i, j]
        matmul(db, dc[:, :size], w3, False)
        tanh_back(bs[s].reshape(-1), db.reshape(-1))
        matmul(da, db[:, : len(w2)], w2, False)
        matmul(a, xs[s], first, False)
        tanh_of(a.reshape(-1))
        tanh_back(a.reshape(-1), da.reshape(-1))
        matmul(dx, da[:, : len(w1)], w1, False)
        _add(dh, dx[:, :size])
        copy(du[:, s], dx[:, size:one])
        if step == 0:
            stop = min(s + len(das), steps - 1)
            n = (stop - s) * rows
            x, b, dc = _flat(xs[s:stop], n), _flat(bs[s:stop], n), _flat(dcs, n)
            a, da, db = _flat(as_, n), _flat(das, n), _flat(dbs, n)
            matmul(dw1, x.T, da, True)
            matmul(dw2, db[:, : len(w2)].T, a, True)
            matmul(db2, x[:, one:].T, db, True)
            matmul(dw3, dc[:, :size].T, b, True)


@part
def _add(out: Array, values: Array) -> None:
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[i, j] += values[i, j]


@part
def _flat(x: Array, n: int) -> Array:
    return x.reshape(-1, x.shape[2])[:n]
