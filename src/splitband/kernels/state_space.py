"""Roll out a state-space network in innovations form, forward and backward, compiled.

With z_n = [x_n, 1, u_n], s_n = [u_{n-1}, x_n, 1], and u_0 in place of u_{-1},

    x_{n+1} = [A a B] z_n + W_f tanh(F z_n) + K e_n,    y_n = [D C c] s_n + W_g tanh(G s_n),

where e_n is the measured sample minus y_n in the warm-up, and zero after it.

Networks of this kind have a few states and a few dozen units, often fewer than a vector has lanes.
So the rows of a batch are the lanes (`state_space_lanes`). A few rows would leave most lanes empty:
they are taken one after the other (`state_space_rows`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from splitband.kernels import state_space_lanes, state_space_rows
from splitband.kernels.common import (
    PAD,
    Array,
    add,
    array,
    check,
    padded,
    run_rows,
    split_rows,
    zeros,
)

_MOST_LANES = 128
"""Rows of a job: so many that its steps stay in the cache."""
_FEW = 4
"""Rows that take less time one after the other."""


def state_space_rollout(
    x0: Tensor,
    y_warmup: Tensor,
    steps: int,
    u: Tensor | None,
    weight_f: Tensor,
    bias_f: Tensor,
    weight_g: Tensor,
    bias_g: Tensor,
    weight_x: Tensor,
    bias_x: Tensor,
    weight_y: Tensor,
    bias_y: Tensor,
    gain: Tensor,
) -> Tensor:
    """Follow the measured samples as an observer, then simulate.

    Differentiable once, with respect to every tensor. Without gradients the memory does not grow
    with the steps, apart from the result.

    Parameters
    ----------
    x0 : The state at the first sample `(batch, S)`, float32 or float64.
    y_warmup : Measured samples `(batch, R, ny)`.
    steps : How many samples to simulate.
    u : Known inputs `(batch, R + steps - 1, nu)` or longer, or None.
    weight_f, bias_f, weight_g, bias_g : The units, `(H, S + nu)` and `(H,)` each, H >= 0.
    weight_x, bias_x : [A, B, W_f] `(S, S + nu + H)` and a `(S,)`.
    weight_y, bias_y : [C, D, W_g] `(ny, S + nu + H)` and c `(ny,)`.
    gain : K `(S, ny)`.

    Returns
    -------
    Tensor
        The samples R..R+steps-1, shape `(batch, steps, ny)`.
    """
    batch, warmup, ny = y_warmup.shape
    size, hidden, last = x0.shape[-1], len(bias_f), max(warmup + steps - 1, 0)
    u = y_warmup.new_empty(batch, last, 0) if u is None else u
    seen = size + u.shape[-1]
    check(
        x0,
        x0=(x0, (batch, size)),
        y_warmup=(y_warmup, (batch, warmup, ny)),
        u=(u, (batch, max(last, *u.shape[1:2]), u.shape[-1])),
        weight_f=(weight_f, (hidden, seen)),
        bias_f=(bias_f, (hidden,)),
        weight_g=(weight_g, (hidden, seen)),
        bias_g=(bias_g, (hidden,)),
        weight_x=(weight_x, (size, seen + hidden)),
        bias_x=(bias_x, (size,)),
        weight_y=(weight_y, (ny, seen + hidden)),
        bias_y=(bias_y, (ny,)),
        gain=(gain, (size, ny)),
    )
    weights = (weight_f, bias_f, weight_g, bias_g, weight_x, bias_x, weight_y, bias_y, gain)
    if not steps:
        return y_warmup.new_empty(batch, 0, ny)
    if torch.is_grad_enabled() and any(t.requires_grad for t in (x0, y_warmup, u, *weights)):
        y: Tensor = _Rollout.apply(x0, y_warmup, u, steps, *weights)  # type: ignore[no-untyped-call]
        return y
    return _simulate(x0, y_warmup, u, steps, weights, keep=False)[0]


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, x0: Tensor, y_warmup: Tensor, u: Tensor, steps: int, *weights: Tensor
    ) -> Tensor:
        y, ctx.rows, kept = _simulate(x0, y_warmup, u, steps, weights, keep=True)
        ctx.save_for_backward(*weights, *kept)
        ctx.shapes = x0.shape, y_warmup.shape, u.shape
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, dy: Tensor) -> tuple[Tensor | None, ...]:
        weights, kept = ctx.saved_tensors[:9], ctx.saved_tensors[9:]
        packed = _pack(*(array(w) for w in weights))
        dy = dy.contiguous()
        dx0, dy_warmup, du = (zeros(dy, *shape) for shape in ctx.shapes)
        wanted = ctx.needs_input_grad[1] or ctx.needs_input_grad[2]
        sums = [[zeros(dy, *w.shape) for w in packed] for _ in ctx.rows]
        jobs = [
            (wanted, dy[rows], saved, *packed, *of_job, dx0[rows], dy_warmup[rows], du[rows])
            for rows, saved, of_job in zip(ctx.rows, kept, sums, strict=True)
        ]
        few = len(dy) < _FEW
        run_rows(state_space_rows.backward if few else state_space_lanes.backward, jobs)
        return dx0, dy_warmup, du, None, *_unpack(dx0.shape[1], *add(sums))


def _simulate(
    x0: Tensor, y_warmup: Tensor, u: Tensor, steps: int, weights: tuple[Tensor, ...], keep: bool
) -> tuple[Tensor, list[slice], list[Tensor]]:
    """Return the samples, the rows of each job, and for each what the way back needs."""
    packed = _pack(*(array(w) for w in weights))
    batch, warmup, ny = y_warmup.shape
    last, width, hidden = warmup + steps - 1, packed[0].shape[1], packed[1].shape[1]
    few = batch < _FEW
    split = _split(batch, few, float(batch) * last * sum(w.numel() for w in packed))
    y = y_warmup.new_empty(batch, steps, ny)
    x0, y_warmup, u = x0.contiguous(), y_warmup.contiguous(), u.contiguous()
    if few:
        lanes = [PAD for _ in split]
        slots = last + 1 if keep else state_space_rows.CHUNK
        n = state_space_rows.size_of_kept(slots, width, hidden, warmup, ny)
    else:
        lanes = [padded(rows.stop - rows.start) for rows in split]
        slots = last if keep else 1
        n = state_space_lanes.size_of_kept(slots, width, hidden, warmup * ny)
    # One allocation: see `common.buffers`.
    whole = y.new_empty(n * sum(lanes))
    parts = zip(whole.split([n * count for count in lanes]), lanes, strict=True)
    kept = [part.view(n, count) for part, count in parts]
    jobs = [
        (keep, x0[rows], y_warmup[rows], u[rows], *packed, saved, y[rows])
        for rows, saved in zip(split, kept, strict=True)
    ]
    run_rows(state_space_rows.forward if few else state_space_lanes.forward, jobs)
    return y, split, kept


def _split(batch: int, few: bool, work: float) -> list[slice]:
    """Return the rows of each job: one, or as many as suit the threads and the cache."""
    n = batch if few else max(len(split_rows(batch, work)), -(-batch // _MOST_LANES))
    return [slice(batch * i // n, batch * (i + 1) // n) for i in range(n)]


def _pack(
    weight_f: Array,
    bias_f: Array,
    weight_g: Array,
    bias_g: Array,
    weight_x: Array,
    bias_x: Array,
    weight_y: Array,
    bias_y: Array,
    gain: Array,
) -> tuple[Tensor, ...]:
    """Return [F; A a B], W_f, [G; D C c], W_g, K, with the columns of z and of s."""
    size, seen = gain.shape[0], weight_f.shape[1]
    f = np.concatenate([weight_f, weight_x[:, :seen]])
    g = np.concatenate([weight_g, weight_y[:, :seen]])
    of_f = np.concatenate([bias_f, bias_x])[:, None]
    of_g = np.concatenate([bias_g, bias_y])[:, None]
    z = np.concatenate([f[:, :size], of_f, f[:, size:]], axis=1)
    s = np.concatenate([g[:, size:], g[:, :size], of_g], axis=1)
    packed = z, weight_x[:, seen:], s, weight_y[:, seen:], gain
    return tuple(torch.from_numpy(np.ascontiguousarray(w)) for w in packed)


def _unpack(size: int, dz: Array, dwx: Array, ds: Array, dwy: Array, dgain: Array) -> list[Tensor]:
    """Return the gradients in the order and shapes of the weights."""
    hidden, nu = dwx.shape[1], dz.shape[1] - size - 1
    f = np.concatenate([dz[:, :size], dz[:, size + 1 :]], axis=1)
    g = np.concatenate([ds[:, nu:-1], ds[:, :nu]], axis=1)
    of_f, of_g = dz[:, size], ds[:, -1]
    grads = (
        *(f[:hidden], of_f[:hidden], g[:hidden], of_g[:hidden]),
        *(np.concatenate([f[hidden:], dwx], axis=1), of_f[hidden:]),
        *(np.concatenate([g[hidden:], dwy], axis=1), of_g[hidden:]),
        dgain,
    )
    return [torch.from_numpy(np.ascontiguousarray(grad)) for grad in grads]
