"""Roll out a state-space network for one row of a batch, with its quantities as lanes.

Row t + 1 of `xs` is z_t = [x_t, 1, u_t], padded; row 0 holds u_{-1}. A free run does not depend on
the outputs: the state equation goes step by step, and the outputs of a chunk of samples are
products of matrices. See `state_space` for the formulas.
"""

from __future__ import annotations

import numpy as np

from splitband.kernels.common import PAD, Array, Arrays, copy, kernel, part, tanh_back, tanh_of
from splitband.kernels.matmul import matmul

CHUNK = 64
"""Samples with outputs, and gradients of weights, in one product."""


@part
def _wide(w: Array) -> Array:
    """Return a copy with rows padded with zeros."""
    out = np.zeros((w.shape[0], -(-w.shape[1] // PAD) * PAD), w.dtype)
    copy(out, w)
    return out


@kernel
def forward(inputs: Arrays, weights: Arrays, buffers: Arrays, y: Array) -> None:
    """Warm up and simulate; `buffers` store all steps if they have room."""
    x0, y_warmup, u = inputs
    wz, wf, ws, wg, gain = weights
    xs, fs, gs, es = buffers
    warmup, ny = y_warmup.shape[1:]
    (size, hidden), nu, width = wf.shape, u.shape[2], wz.shape[1]
    last = warmup + y.shape[1] - 1
    keep = len(fs) > last
    units_of_z, x_of_z = _wide(wz[:hidden].T), _wide(wz[hidden:].T)
    x_of_units, x_of_e = _wide(wf.T), _wide(gain.T)
    of_x, of_u = _wide(ws[:hidden, nu:].T), _wide(ws[:hidden, :nu].T)
    y_of_x, y_of_u, y_of_units = _wide(ws[hidden:, nu:].T), _wide(ws[hidden:, :nu].T), _wide(wg.T)
    outputs = np.empty((CHUNK, y_of_x.shape[1]), y.dtype)
    copy(xs[:1, size + 1 :], u[:, 0])
    copy(xs[1:2], x0)
    for begin in range(0, last + 1, CHUNK):
        end, base = min(begin + CHUNK, last + 1), begin if keep else 0
        for t in range(begin, min(end, last)):
            i = base + t - begin
            now, f = xs[i + 1 : i + 2], fs[i : i + 1]
            now[0, size] = 1
            copy(now[:, size + 1 :], u[:, t])
            if t < warmup:
                _units(gs[i : i + 1], xs, i, size + 1, of_x, of_u)
                _outputs(outputs[:1], gs[i : i + 1], xs, i, size + 1, y_of_x, y_of_u, y_of_units)
                for j in range(ny):
                    es[t, j] = y_warmup[0, t, j] - outputs[0, j]
            matmul(f, now[:, :width], units_of_z, False)
            tanh_of(f.reshape(-1))
            x = xs[i + 2 : i + 3, : x_of_z.shape[1]]
            matmul(x, now[:, :width], x_of_z, False)
            matmul(x, f[:, :hidden], x_of_units, True)
            if t < warmup:
                matmul(x, es[t : t + 1, :ny], x_of_e, True)
        if end == last + 1:
            xs[base + end - begin, size] = 1
        first = max(begin, warmup)
        if first < end:
            i, n = base + first - begin, end - first
            _units(gs[i : i + n], xs, i, size + 1, of_x, of_u)
            _outputs(outputs[:n], gs[i : i + n], xs, i, size + 1, y_of_x, y_of_u, y_of_units)
            copy(y[0, first - warmup :], outputs[:n, :ny])
        if not keep:
            xs[0] = xs[CHUNK]
            xs[1] = xs[CHUNK + 1]


@part
def _units(g: Array, xs: Array, i: int, ones: int, of_x: Array, of_u: Array) -> None:
    """Write the units of g of the samples from slot i on."""
    matmul(g, xs[i + 1 : i + 1 + len(g), :ones], of_x, False)
    matmul(g, xs[i : i + len(g), ones : ones + len(of_u)], of_u, True)
    tanh_of(g.reshape(-1))


@part
def _outputs(
    out: Array, g: Array, xs: Array, i: int, ones: int, of_x: Array, of_u: Array, of_units: Array
) -> None:
    matmul(out, xs[i + 1 : i + 1 + len(g), :ones], of_x, False)
    matmul(out, xs[i : i + len(g), ones : ones + len(of_u)], of_u, True)
    matmul(out, g[:, : len(of_units)], of_units, True)


@kernel
def backward(  # noqa: PLR0915
    wanted: bool, dy: Array, weights: Arrays, buffers: Arrays, sums: Arrays, gradients: Arrays
) -> None:
    """Add the gradients of the weights, and write or add those of the inputs."""
    wz, wf, ws, wg, gain = weights
    dwz, dwf, dws, dwg, dgain = sums
    dx0, dy_warmup, du = gradients
    xs, fs, gs, es = buffers
    warmup, ny = dy_warmup.shape[1:]
    (size, hidden), nu, width = wf.shape, du.shape[2], wz.shape[1]
    last = warmup + dy.shape[1] - 1
    dtype, wide = dy.dtype, xs.shape[1]
    units_of_x, units_of_y, e_of_x = _wide(wf), _wide(wg), _wide(gain)
    z_of_units, z_of_x = _wide(wz[:hidden]), _wide(wz[hidden:])
    s_of_units, s_of_y = _wide(ws[:hidden]), _wide(ws[hidden:])
    # Sums have the columns of `xs`. Sums for s are computed twice: u_{t-1} is in the row before.
    sum_z, sum_x = np.zeros((hidden, wide), dtype), np.zeros((size, wide), dtype)
    sum_f, sum_g = np.zeros_like(units_of_x), np.zeros_like(units_of_y)
    sum_e = np.zeros_like(e_of_x)
    of_units, of_y = np.zeros((2, hidden, wide), dtype), np.zeros((2, ny, wide), dtype)
    df, dg = np.empty((CHUNK, fs.shape[1]), dtype), np.empty((CHUNK, fs.shape[1]), dtype)
    dx, dseen = np.zeros((CHUNK, size), dtype), np.empty((CHUNK, es.shape[1]), dtype)
    ds, dz = np.empty((CHUNK, wide), dtype), np.zeros((1, wide), dtype)
    now = np.zeros((1, size), dtype)
    for chunk in range(last // CHUNK, -1, -1):
        begin, end = chunk * CHUNK, min((chunk + 1) * CHUNK, last + 1)
        first = max(begin, warmup)
        if first < end:
            a, b = first - begin, end - begin
            copy(dseen[a:b], dy[0, first - warmup : end - warmup])
            _through(ds[a:b], dg[a:b], dseen[a:b], gs[first:end], units_of_y, s_of_units, s_of_y)
        for t in range(end - 1, begin - 1, -1):
            i = t - begin
            e = i + 1
            copy(dx[i:e], now)
            if t < last:
                matmul(df[i:e], now, units_of_x, False)
                tanh_back(fs[t], df[i])
                matmul(dz, df[i:e, :hidden], z_of_units, False)
                matmul(dz, now, z_of_x, True)
            if t < warmup:
                matmul(dseen[i:e], now, e_of_x, False)
                copy(dy_warmup[:, t], dseen[i:e, :ny])
                dseen[i] *= -1
                g = gs[t : t + 1]
                _through(ds[i:e], dg[i:e], dseen[i:e], g, units_of_y, s_of_units, s_of_y)
            for j in range(size):
                now[0, j] = dz[0, j] + ds[i, nu + j]
            if wanted:
                for j in range(nu):
                    du[0, max(t - 1, 0), j] += ds[i, j]
                    if t < last:
                        du[0, t, j] += dz[0, size + 1 + j]
        n = end - begin
        for k in range(2):
            x = xs[begin + 1 - k : end + 1 - k]
            matmul(of_units[k], dg[:n, :hidden].T, x, True)
            matmul(of_y[k], dseen[:n, :ny].T, x, True)
        matmul(sum_g, dseen[:n, :ny].T, gs[begin:end], True)
        n = min(end, last) - begin
        matmul(sum_z, df[:n, :hidden].T, xs[begin + 1 : begin + 1 + n], True)
        matmul(sum_x, dx[:n].T, xs[begin + 1 : begin + 1 + n], True)
        matmul(sum_f, dx[:n].T, fs[begin : begin + n], True)
        n = min(end, warmup) - begin
        if n > 0:
            matmul(sum_e, dx[:n].T, es[begin : begin + n], True)
    copy(dwz[:hidden], sum_z[:, :width])
    copy(dwz[hidden:], sum_x[:, :width])
    copy(dwf, sum_f[:, :hidden])
    copy(dwg, sum_g[:, :hidden])
    copy(dgain, sum_e[:, :ny])
    copy(dws[:hidden, nu:], of_units[0, :, : size + 1])
    copy(dws[hidden:, nu:], of_y[0, :, : size + 1])
    copy(dws[:hidden, :nu], of_units[1, :, size + 1 : width])
    copy(dws[hidden:, :nu], of_y[1, :, size + 1 : width])
    copy(dx0, now)


@part
def _through(
    ds: Array, dg: Array, dseen: Array, g: Array, of_y: Array, s_of_units: Array, s_of_y: Array
) -> None:
    """Propagate gradients of outputs to the units of g and to s."""
    matmul(dg, dseen[:, : len(of_y)], of_y, False)
    for i in range(len(g)):
        tanh_back(g[i], dg[i])
    matmul(ds, dg[:, : len(s_of_units)], s_of_units, False)
    matmul(ds, dseen[:, : len(s_of_y)], s_of_y, True)
