"""Simulate linear systems and observers fast, without a loop over all samples."""

from __future__ import annotations

import numpy as np
import scipy

from splitband.runtime.arrays import Array

_LEAST = 1e-12
"""Least mean square of a direction of the states, as a share of the largest, which is scaled to 1:
with less of it there is rounding."""


def states(a: Array, forced: Array, first: Array) -> Array:
    """Return x_0, x_1, ... of x_{t+1} = A x_t + f_t, `(time, states)`.

    The record is cut into blocks of about the square root of its length. All blocks advance side by
    side from a state of zero; a second pass adds the states at their beginnings.

    Parameters
    ----------
    a : `(states, states)`.
    forced : f, `(time, states)`.
    first : x_0, `(states,)`.
    """
    time, n = forced.shape
    length = max(int(np.sqrt(time)), 1)
    count = -(-time // length)
    padded = np.zeros((count * length, n))
    padded[:time] = forced
    rows = np.ascontiguousarray(padded.reshape(count, length, n).transpose(1, 0, 2))
    with np.errstate(over="ignore", invalid="ignore"):
        ends = np.zeros((count, n))
        for row in rows:
            ends = ends @ a.T + row
        power, begins = np.linalg.matrix_power(a, length), np.empty((count, n))
        x = first
        for i, end in enumerate(ends):
            begins[i] = x
            x = power @ x + end
        found, x = np.empty_like(rows), begins
        for i, row in enumerate(rows):
            found[i] = x
            x = x @ a.T + row
    return np.ascontiguousarray(found.transpose(1, 0, 2)).reshape(-1, n)[:time]


def kalman_gain(a: Array, c: Array, q: Array, r: Array) -> Array:
    """Return the stationary gain K of the filter x' = A x + K e, by the Riccati equation.

    `q` `(states, states)` and `r` `(ny, ny)` are the covariances of the noise of state and output.
    Raises LinAlgError where there is no stationary filter.
    """
    with np.errstate(all="ignore"):
        p = scipy.linalg.solve_discrete_are(a.T, c.T, q, r)
    return np.asarray(a @ p @ c.T @ np.linalg.pinv(c @ p @ c.T + r))


def root_of(covariance: Array) -> Array:
    """Return a square root R of a covariance R R', `(n, n)`."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))


def whitening(visited: Array) -> tuple[Array, Array]:
    """Return T and its inverse, for which the states T x are uncorrelated, of mean square 1.

    `visited`: states in the records, `(time, states)`; where an unstable model leaves the range of
    numbers, T is the unit matrix.
    """
    unit = np.eye(visited.shape[1])
    if not np.isfinite(visited).all():
        return unit, unit
    power, axes = np.linalg.eigh(visited.T @ visited / len(visited))
    size = np.sqrt(np.maximum(power, _LEAST * max(power.max(initial=0.0), 1e-300)))
    return axes.T / size[:, None], axes * size
