"""Compile the rollout of a three-layer perceptron's Euler steps, forward and backward.

With x = [h, u, 1] and the biases as last columns of the weights (paper, supplement, "MLP
training"),

    a = tanh(W_1 x),  b = tanh(W_2 [a, 1]),  h' = h + dt W_3 [b, 1],

and y is the first entries of h.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from splitband.kernels.common import (
    Array,
    Arrays,
    add,
    copy,
    kernel,
    part,
    tanh_back,
    tanh_of,
)
from splitband.kernels.matmul import matmul
from splitband.kernels.rollouts import (
    Kernel,
    Shapes,
    gradient_steps,
    pad,
    padded,
    run,
    split_rows,
)


def euler_rollout(
    h0: Tensor,
    steps: int,
    ny: int,
    step_size: float,
    u: Tensor | None,
    *weights: Tensor,
) -> Tensor:
    """Simulate from a given state (paper, Eq. 8, rollout).

    Differentiable once, with respect to every tensor.

    Returns the samples R..R+steps-1, shape `(batch, steps, ny)`.

    Parameters
    ----------
    h0 : The state h_R of the first sample `(batch, S)`, float32 or float64.
    steps : Number of samples to simulate.
    ny : Number of outputs, the first entries of the state.
    step_size : dt.
    u : Known inputs `(batch, steps - 1, nu)` or longer, from time R on, or None.
    weights : By layer `(M, S + nu)` and `(M,)`, `(N, M)` and `(N,)`, `(S, N)` and `(S,)`.
    """
    batch, last = len(h0), max(steps - 1, 0)
    u = h0.new_empty(batch, last, 0) if u is None else u
    sizes = batch, steps, ny, u.shape[-1], last
    return run(_EulerMLP(*sizes, _forward, _backward, step_size), (h0, u), weights)


@dataclass(frozen=True)
class _EulerMLP(Kernel):
    """Keep x and b of all steps; the narrow first layer is cheap, so a is computed again."""

    step_size: float

    def pack(self, *weights: Array) -> Arrays:
        """Pack the layers as W' over the bias, to multiply from the right, and dt."""
        layers = zip(weights[::2], weights[1::2], strict=True)
        return *(_packed(w, bias) for w, bias in layers), self._step_size(weights)

    def pack_back(self, *weights: Array) -> Arrays:
        padded_weights = (pad(w) for w in weights[::2])
        return _packed(*weights[:2]), *padded_weights, self._step_size(weights)

    def split(self, packed: Arrays) -> list[slice]:
        work = sum(w.size for w in packed[:-1])
        return split_rows(self.batch, float(self.batch) * self.steps * work)

    def kept(self, packed: Arrays, rows: int, keep: bool) -> Shapes:
        w1, w2, *_ = packed
        slots = max(self.last, 1) if keep else 1
        return (slots + 1, rows, len(w1)), (slots, rows, w2.shape[1])

    def scratch(self, packed: Arrays, rows: int) -> Shapes:
        _, _, w2, w3, _ = packed
        widths = w2.shape[1], w2.shape[1], w3.shape[1], padded(len(w3))
        return [(gradient_steps(rows), rows, width) for width in widths]

    def sums(self, packed: Arrays) -> Shapes:
        first, _, w2, w3, _ = packed
        return first.shape, w2.shape, (1, w3.shape[1]), w3.shape, (len(w3),)

    def unpack(self, *sums: Array) -> Iterable[Array]:
        dw1, dw2, db2, dw3, db3 = sums
        return dw1[:-1].T, dw1[-1], dw2, db2[0], dw3, db3

    def _step_size(self, weights: Arrays) -> Array:
        return np.array([self.step_size], weights[0].dtype)


def _packed(w: Array, bias: Array) -> Array:
    return pad(np.concatenate([w.T, bias[None]]))


@kernel
def _forward(inputs: Arrays, weights: Arrays, buffers: Arrays, y: Array) -> None:
    h0, u = inputs
    w1, w2, w3, step_size = weights
    xs, bs = buffers
    rows, size = h0.shape
    steps, ny = y.shape[1:]
    one = size + u.shape[2]
    dt = step_size[0]
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
    wanted: bool, dy: Array, weights: Arrays, buffers: Arrays, sums: Arrays, gradients: Arrays
) -> None:
    first, w1, w2, w3, step_size = weights
    xs, bs, as_, das, dbs, dcs = buffers
    dw1, dw2, db2, dw3, db3 = sums
    dh, du = gradients
    rows, size = dh.shape
    steps, one = dy.shape[1], size + du.shape[2]
    dt = step_size[0]
    dx = np.empty((rows, w1.shape[1]), dy.dtype)
    for t in range(steps - 1, -1, -1):
        add(dh, dy[:, t])
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
        add(dh, dx[:, :size])
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
def _flat(x: Array, n: int) -> Array:
    return x.reshape(-1, x.shape[2])[:n]
