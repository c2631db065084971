"""Roll out a state-space network with the rows of a batch as lanes of vectors.

Each quantity is an array (quantities, rows). All z and s are views of one stream of such
quantities, ..., u_{n-1}, x_n, 1, u_n, x_{n+1}, 1, ... See `state_space` for the formulas.
"""

from __future__ import annotations

import numpy as np

from splitband.kernels.common import Array, kernel, part, tanh
from splitband.kernels.matmul import add_products, matmul

_GRADIENT_STEPS = 16
"""Steps whose gradients are kept until they are multiplied with what they belong to."""


def size_of_kept(slots: int, width: int, hidden: int, warm: int) -> int:
    """Return how many quantities `forward` keeps of so many steps, and `warm` errors."""
    return (slots + 1) * (width + 2 * hidden) + warm


@part
def _parts(kept: Array, width: int, hidden: int, warm: int) -> tuple[Array, Array, Array, Array]:
    """Return the stream, the units of f and of g, and the errors of the warm-up."""
    slots, lanes = (len(kept) - warm) // (width + 2 * hidden), kept.shape[1]
    a, b = slots * width, slots * (width + hidden)
    c = b + slots * hidden
    fs, gs = kept[a:b].reshape(slots, hidden, lanes), kept[b:c].reshape(slots, hidden, lanes)
    return kept[:a], fs, gs, kept[c:]


@kernel
def forward(
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
    """Follow the warm-up and simulate; with `keep`, what `backward` needs is kept."""
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
        tanh_of(g.reshape(-1))
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
        tanh_of(f.reshape(-1))
        matmul(x, wz[hidden:], z, False)
        matmul(x, wf, f, True)
        if t < warmup:
            matmul(x, gain, es[t * ny : (t + 1) * ny], True)
        following[nu + size] = 1
        if not keep:
            s[:] = following


@kernel
def backward(
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
    """Add the gradients of the weights, and write or add the others."""
    rows, warmup, ny = dy_warmup.shape
    (size, hidden), nu, width, lanes = wf.shape, du.shape[2], wz.shape[1], kept.shape[1]
    last = warmup + dy.shape[1] - 1
    stream, fs, gs, es = _parts(kept, width, hidden, warmup * ny)
    ss = stream.reshape(last + 1, width, lanes)
    zs = stream[nu : nu + last * width].reshape(last, width, lanes)
    # Of each step: the gradients of the units and of what they are added to.
    dfs = np.empty((_GRADIENT_STEPS, hidden + size, lanes), dy.dtype)
    dgs = np.empty((_GRADIENT_STEPS, hidden + ny, lanes), dy.dtype)
    dx, dw = np.zeros((size, lanes), dy.dtype), np.empty((nu, lanes), dy.dtype)
    for t in range(last, -1, -1):
        step = t % _GRADIENT_STEPS
        df, dg = dfs[step], dgs[step]
        if t < last:
            df[hidden:] = dx
            matmul(df[:hidden], wf.T, dx, False)
            tanh_back(fs[t].reshape(-1), df[:hidden].reshape(-1))
        seen = dg[hidden:]
        if t >= warmup:
            _to_lanes(seen, dy[:, t - warmup])
            seen[:, rows:] = 0
        else:
            matmul(seen, gain.T, dx, False)
            _to_rows(dy_warmup[:, t], seen)
            seen *= -1
        matmul(dg[:hidden], wg.T, seen, False)
        tanh_back(gs[t].reshape(-1), dg[:hidden].reshape(-1))
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
            stop = min(t + _GRADIENT_STEPS, last + 1)
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
    """Copy rows to lanes; left-over lanes follow the last row, so that none overflows alone."""
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
def tanh_of(x: Array) -> None:
    """Write tanh(x) to x."""
    for i in range(x.size):
        x[i] = tanh(x[i])


@part
def tanh_back(a: Array, da: Array) -> None:
    """Bring the gradient of a = tanh(x) to x, in place."""
    one = a.dtype.type(1)
    for i in range(a.size):
        da[i] *= one - a[i] * a[i]
