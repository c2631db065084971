"""Differentiate a state-space network's rollout by each of its parameters, compiled.

The derivatives of the state go along with the state, sample by sample, in float64. For networks of
this size it takes less time than a dozen gradients of a sum over the samples.
"""

from __future__ import annotations

import numpy as np

from splitband.kernels.common import Array, Arrays, kernel, part


@kernel
def jacobian(row: Arrays, weights: Arrays, slopes: Array) -> None:
    """Write the derivatives of one row's free run, `(steps, ny, parameters)`.

    Parameters
    ----------
    row : Samples and inputs of which the first state is an affine map, `(encoded,)`, the first
        state, the measured samples `(R, ny)`, and known inputs `(R + steps - 1, nu)` or longer.
    weights : As for `state_space.state_space_rollout`.
    slopes : The result. Its columns are K, the matrix and the constant of the map to the first
        state, and then the weights, each as it is stored.
    """
    encoded, first, y, u = row
    weight_f, bias_f, weight_g, bias_g, weight_x, bias_x, weight_y, bias_y, gain = weights
    (size, ny), (hidden, columns), width = gain.shape, weight_f.shape, weight_x.shape[1]
    at_first = size * ny
    at_constant = at_first + size * len(encoded)
    at_f = at_constant + size
    at_g = at_f + hidden * (columns + 1)
    at_x = at_g + hidden * (columns + 1)
    at_y = at_x + size * (width + 1)
    warmup, (steps, _, count) = len(y), slopes.shape
    x, following, z = first.copy(), np.empty(size), np.empty(columns)
    f, g, predicted = np.empty(hidden), np.empty(hidden), np.empty(ny)
    dx, dfollowing, dy = np.zeros((size, count)), np.zeros((size, count)), np.zeros((ny, count))
    for i in range(size):
        dx[i, at_constant + i] = 1
        for j in range(len(encoded)):
            dx[i, at_first + i * len(encoded) + j] = encoded[j]
    last = warmup + steps - 1
    for t in range(last + 1):
        _side_by_side(z, x, u[max(t - 1, 0)])
        _units(g, weight_g, bias_g, z)
        dout = dy if t < warmup else slopes[t - warmup]
        _differentiate(dout, dx, weight_y, weight_g, g, z, at_y, at_g)
        if t == last:
            break
        if t < warmup:
            _outputs(predicted, weight_y, bias_y, z, g)
        _side_by_side(z, x, u[t])
        _units(f, weight_f, bias_f, z)
        _outputs(following, weight_x, bias_x, z, f)
        _differentiate(dfollowing, dx, weight_x, weight_f, f, z, at_x, at_f)
        if t < warmup:
            for i in range(size):
                for j in range(ny):
                    error = y[t, j] - predicted[j]
                    following[i] += gain[i, j] * error
                    for p in range(count):
                        dfollowing[i, p] -= gain[i, j] * dy[j, p]
                    dfollowing[i, i * ny + j] += error
        x, following = following, x
        dx, dfollowing = dfollowing, dx


@part
def _side_by_side(z: Array, x: Array, u: Array) -> None:
    for i in range(len(z)):
        z[i] = x[i] if i < len(x) else u[i - len(x)]


@part
def _units(units: Array, weight: Array, bias: Array, z: Array) -> None:
    for k in range(len(units)):
        value = bias[k]
        for j in range(len(z)):
            value += weight[k, j] * z[j]
        units[k] = np.tanh(value)


@part
def _outputs(out: Array, weight: Array, bias: Array, z: Array, units: Array) -> None:
    for i in range(len(out)):
        value = bias[i]
        for j in range(len(z)):
            value += weight[i, j] * z[j]
        for k in range(len(units)):
            value += weight[i, len(z) + k] * units[k]
        out[i] = value


@part
def _differentiate(
    out: Array, dx: Array, weight: Array, inner: Array, units: Array, z: Array, at: int, at_in: int
) -> None:
    """Write the derivatives of `_outputs`: by way of the state, and by its own weights.

    `inner` are the weights of the units; `at` and `at_in` are the columns of both weights, each
    followed by its constants.
    """
    (size, count), columns, hidden, width = dx.shape, len(z), len(units), weight.shape[1]
    for i in range(len(out)):
        out[i] = 0
        for j in range(size):
            slope = weight[i, j]
            for k in range(hidden):
                slope += weight[i, columns + k] * (1 - units[k] ** 2) * inner[k, j]
            for p in range(count):
                out[i, p] += slope * dx[j, p]
        own = at + i * width
        for j in range(columns):
            out[i, own + j] += z[j]
        for k in range(hidden):
            out[i, own + columns + k] += units[k]
            slope = weight[i, columns + k] * (1 - units[k] ** 2)
            for j in range(columns):
                out[i, at_in + k * columns + j] += slope * z[j]
            out[i, at_in + hidden * columns + k] += slope
        out[i, at + len(out) * width + i] += 1
