"""The rollout of a state-space network in innovations form, forward and backward, compiled.

With z_n = [x_n, 1, u_n], s_n = [u_{n-1}, x_n, 1], and u_0 in place of u_{-1},

    x_{n+1} = [A a B] z_n + W_f tanh(F z_n) + K e_n,    y_n = [D C c] s_n + W_g tanh(G s_n),

where e_n is the measured sample minus y_n in the warm-up, and zero after it.

Networks of this kind have a few states and a few dozen units, fewer than a vector has lanes. So the
rows of a batch are the lanes: each quantity is an array (quantities, rows). All z and s are views
of one stream of such quantities, ..., u_{n-1}, x_n, 1, u_n, x_{n+1}, 1, ...
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from splitband.kernels.common import (
    Array,
    add,
    array,
    check,
    kernel,
    padded,
    part,
    run_rows,
    split_rows,
    tanh,
    zeros,
)
from splitband.kernels.matmul import add_products, matmul

_GATHER = 16  # steps whose gradients are kept until they are multiplied with what they belong to
_MOST_LANES = 128  # rows of a job: so many that its steps stay in the cache


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
        run_rows(_backward, jobs)
        return dx0, dy_warmup, du, None, *_unpack(dx0.shape[1], *add(sums))


def _simulate(
    x0: Tensor, y_warmup: Tensor, u: Tensor, steps: int, weights: tuple[Tensor, ...], keep: bool
) -> tuple[Tensor, list[slice], list[Tensor]]:
    """The samples, the rows of each job, and for each what `_parts` finds in it."""
    packed = _pack(*(array(w) for w in weights))
    batch, warmup, ny = y_warmup.shape
    last, width, hidden = warmup + steps - 1, packed[0].shape[1], packed[1].shape[1]
    split = _split(batch, float(batch) * last * sum(w.numel() for w in packed))
    y = y_warmup.new_empty(batch, steps, ny)
    x0, y_warmup, u = x0.contiguous(), y_warmup.contiguous(), u.contiguous()
    slots = last if keep else 1
    quantities = (slots + 1) * (width + 2 * hidden) + warmup * ny
    lanes = [padded(rows.stop - rows.start) for rows in split]
    # One allocation: see `common.buffers`.
    whole = y.new_empty(quantities * sum(lanes))
    kept = [
        part.view(quantities, n)
        for part, n in zip(whole.split([quantities * n for n in lanes]), lanes, strict=True)
    ]
    jobs = [
        (keep, x0[rows], y_warmup[rows], u[rows], *packed, saved, y[rows])
        for rows, saved in zip(split, kept, strict=True)
    ]
    run_rows(_forward, jobs)
    return y, split, kept


def _split(batch: int, work: float) -> list[slice]:
    """The rows of each job: for the threads that the work is worth, and for the cache."""
    n = max(len(split_rows(batch, work)), -(-batch // _MOST_LANES))
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
    """[F; A a B], W_f, [G; D C c], W_g, K, with the columns of z and of s."""
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
    """The gradients in the order and shapes of the weights."""
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


@part
def _parts(kept: Array, width: int, hidden: int, warm: int) -> tuple[Array, Array, Array, Array]:
    """The stream, the units of f and of g, and the errors of the warm-up."""
    slots, lanes = (len(kept) - warm) // (width + 2 * hidden), kept.shape[1]
    a, b = slots * width, slots * (width + hidden)
    c = b + slots * hidden
    fs, gs = kept[a:b].reshape(slots, hidden, lanes), kept[b:c].reshape(slots, hidden, lanes)
    return kept[:a], fs, gs, kept[c:]


@kernel
def _forward(
    keep: bool,
    x0: Array,
    y_warmup: Array,
    u: Array,
    wz: Array,
    wf: Array,
    ws: Array,
    wg: Array,
    gain: Array,
    kept: Array,
    y: Array,
) -> None:
    warmup, ny = y_warmup.shape[1:]
    (size, hidden), nu, width, lanes = wf.shape, u.shape[2], wz.shape[1], kept.shape[1]
    last = warmup + y.shape[1] - 1
    stream, fs, gs, es = _parts(kept, width, hidden, warmup * ny)
    seen = np.empty((ny, lanes), y.dtype)
    _to_lanes(stream[:nu], u[:, 0])
    _to_lanes(stream[nu : nu + size], x0)
    stream[nu + size] = 1
    for t in range(last + 1):
        at = t * width if keep else 0
        slot = t if keep else 0
        s, g = stream[at : at + width], gs[slot]
        matmul(g, ws[:hidden], s, False)
        _tanh_of(g.reshape(-1))
        matmul(seen, ws[hidden:], s, False)
        matmul(seen, wg, g, True)
        if t < warmup:
            e = es[t * ny : (t + 1) * ny]
            _to_lanes(e, y_warmup[:, t])
            e -= seen
        else:
            _to_rows(y[:, t - warmup], seen)
        if t == last:
            break
        following = stream[at + width : at + 2 * width]
        _to_lanes(following[:nu], u[:, t])
        z, f = stream[at + nu : at + nu + width], fs[slot]
        x = following[nu : nu + size]
        matmul(f, wz[:hidden], z, False)
        _tanh_of(f.reshape(-1))
        matmul(x, wz[hidden:], z, False)
        matmul(x, wf, f, True)
        if t < warmup:
            matmul(x, gain, es[t * ny : (t + 1) * ny], True)
        following[nu + size] = 1
        if not keep:
            s[:] = following


@kernel
def _backward(
    wanted: bool,
    dy: Array,
    kept: Array,
    wz: Array,
    wf: Array,
    ws: Array,
    wg: Array,
    gain: Array,
    dwz: Array,
    dwf: Array,
    dws: Array,
    dwg: Array,
    dgain: Array,
    dx0: Array,
    dy_warmup: Array,
    du: Array,
) -> None:
    rows, warmup, ny = dy_warmup.shape
    (size, hidden), nu, width, lanes = wf.shape, du.shape[2], wz.shape[1], kept.shape[1]
    last = warmup + dy.shape[1] - 1
    stream, fs, gs, es = _parts(kept, width, hidden, warmup * ny)
    ss = stream.reshape(last + 1, width, lanes)
    zs = stream[nu : nu + last * width].reshape(last, width, lanes)
    # Of each step: the gradients of the units and of what they are added to.
    dfs = np.empty((_GATHER, hidden + size, lanes), dy.dtype)
    dgs = np.empty((_GATHER, hidden + ny, lanes), dy.dtype)
    dx, dw = np.zeros((size, lanes), dy.dtype), np.empty((nu, lanes), dy.dtype)
    for t in range(last, -1, -1):
        step = t % _GATHER
        df, dg = dfs[step], dgs[step]
        if t < last:
            df[hidden:] = dx
            matmul(df[:hidden], wf.T, dx, False)
            _tanh_back(fs[t].reshape(-1), df[:hidden].reshape(-1))
        seen = dg[hidden:]
        if t >= warmup:
            _to_lanes(seen, dy[:, t - warmup])
            seen[:, rows:] = 0
        else:
            matmul(seen, gain.T, dx, False)
            _to_rows(dy_warmup[:, t], seen)
            seen *= -1
        matmul(dg[:hidden], wg.T, seen, False)
        _tanh_back(gs[t].reshape(-1), dg[:hidden].reshape(-1))
        matmul(dx, ws[:, nu : nu + size].T, dg, False)
        if t < last:
            matmul(dx, wz[:, :size].T, df, True)
        if wanted and last:
            matmul(dw, ws[:, :nu].T, dg, False)
            _add_rows(du[:, max(t - 1, 0)], dw)
            if t < last:
                matmul(dw, wz[:, size + 1 :].T, df, False)
                _add_rows(du[:, t], dw)
        if step == 0:
            stop = min(t + _GATHER, last + 1)
            dg_now = dgs[: stop - t]
            add_products(dws, dg_now, ss[t:stop])
            add_products(dwg, dg_now[:, hidden:], gs[t:stop])
            stop = min(stop, last)
            df_now = dfs[: stop - t]
            add_products(dwz, df_now, zs[t:stop])
            add_products(dwf, df_now[:, hidden:], fs[t:stop])
            stop = min(stop, warmup)
            if t < stop:
                e = es[t * ny : stop * ny].reshape(stop - t, ny, lanes)
                add_products(dgain, dfs[: stop - t, hidden:], e)
    _add_rows(dx0, dx)


@part
def _to_lanes(out: Array, values: Array) -> None:
    """Lanes that are left over follow the last row, so that nothing overflows in them alone."""
    rows = len(values)
    for i in range(out.shape[1]):
        for j in range(out.shape[0]):
            out[j, i] = values[min(i, rows - 1), j]


@part
def _to_rows(out: Array, values: Array) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = values[j, i]


@part
def _add_rows(out: Array, values: Array) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] += values[j, i]


@part
def _tanh_of(x: Array) -> None:
    for i in range(x.size):
        x[i] = tanh(x[i])


@part
def _tanh_back(a: Array, da: Array) -> None:
    one = a.dtype.type(1)
    for i in range(a.size):
        da[i] *= one - a[i] * a[i]
