"""Roll out a state-space network with the rows of a batch as lanes of vectors.

Quantities are arrays (quantities, rows). All z and s are views of one stream of quantities, ...,
u_{n-1}, x_n, 1, u_n, x_{n+1}, 1, ... See `state_space` for the formulas.
"""

from __future__ import annotations

import numpy as np

from splitband.kernels.common import Array, Arrays, kernel, part, tanh_back, tanh_of
from splitband.kernels.matmul import add_products, matmul

_GRADIENT_STEPS = 16
"""Steps with gradients in one product."""


@kernel
def forward(inputs: Arrays, weights: Arrays, buffers: Arrays, y: Array) -> None:
    """Warm up and simulate; `buffers` store all steps if they have room."""
    x0, y_warmup, u = inputs
    wz, wf, ws, wg, gain = weights
    stream, fs, gs, es = buffers
    warmup, ny = y_warmup.shape[1:]
    (size, hidden), nu, width, lanes = wf.shape, u.shape[2], wz.shape[1], stream.shape[1]
    last = warmup + y.shape[1] - 1
    keep = len(fs) > last
    outputs = np.empty((ny, lanes), y.dtype)
    _to_lanes(stream[:nu], u[:, 0])
    _to_lanes(stream[nu : nu + size], x0)
    stream[nu + size] = 1
    for t in range(last + 1):
        at = t * width if keep else 0
        slot = t if keep else 0
        s, g = stream[at : at + width], gs[slot]
        matmul(g, ws[:hidden], s, False)
        tanh_of(g.reshape(-1))
        matmul(outputs, ws[hidden:], s, False)
        matmul(outputs, wg, g, True)
        if t < warmup:
            e = es[t * ny : (t + 1) * ny]
            _to_lanes(e, y_warmup[:, t])
            e -= outputs
        else:
            _to_rows(y[:, t - warmup], outputs)
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
def backward(  # noqa: PLR0915
    wanted: bool, dy: Array, weights: Arrays, buffers: Arrays, sums: Arrays, gradients: Arrays
) -> None:
    """Add the gradients of the weights, and write or add those of the inputs."""
    wz, wf, ws, wg, gain = weights
    dwz, dwf, dws, dwg, dgain = sums
    dx0, dy_warmup, du = gradients
    stream, fs, gs, es = buffers
    rows, warmup, ny = dy_warmup.shape
    (size, hidden), nu, width, lanes = wf.shape, du.shape[2], wz.shape[1], stream.shape[1]
    last = warmup + dy.shape[1] - 1
    ss = stream.reshape(last + 1, width, lanes)
    zs = stream[nu : nu + last * width].reshape(last, width, lanes)
    # By step: gradients of the units, then of the state or the outputs.
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
        doutputs = dg[hidden:]
        if t >= warmup:
            _to_lanes(doutputs, dy[:, t - warmup])
            doutputs[:, rows:] = 0
        else:
            matmul(doutputs, gain.T, dx, False)
            _to_rows(dy_warmup[:, t], doutputs)
            doutputs *= -1
        matmul(dg[:hidden], wg.T, doutputs, False)
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
    """Copy rows to lanes; the remaining lanes repeat the last row, to avoid overflow."""
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
