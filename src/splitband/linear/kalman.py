"""Fit and run the Kalman filter of a linear system: its simulation, gain and initial state.

With the gain K the system is x' = A x + B u + K e, y = C x + D u + offset + e, where e is white.
For a given initial state the prediction errors follow from the outputs. Their sum of squares, with
a prior of the state, makes the most probable state a linear least-squares problem; the state at the
end of the history is then the state of the Kalman filter with this prior. The step-by-step form
(`forecasters.linear`) traces the same function.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import current

_FACTORS = (0.0, *np.geomspace(1e-4, 1.0, 9))
"""Candidate process noise, as shares of the states' standard deviations in the record. Bounds the
time."""
_FREE = 24
"""Largest gain, in entries, that is refined. Bounds the time."""
MAX_OBSERVER_POLE = 1 - 1e-9
"""Largest absolute value of an observer's pole. Rounding."""
_PRIOR_FACTORS = (1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6)
"""Candidate factors of the prior covariance of an initial state. Bounds the time."""
_SURPRISING = 8.0
"""Least gain in twice the log-likelihood of a factor other than the usual one. Checked by
halving and doubling."""
EXACT = 1e-5
"""Smallest standard deviation of an error, as a share of the output's in training: with smaller
ones the normal equations would lose the state to rounding."""
_DECAYED = 1e-12
"""Smallest response to the initial state, as a share of the largest. Rounding."""
_LEAST = 1e-12
"""Least mean square of a direction of the states, as a share of the largest. Rounding."""


def states(a: Array, forced: Array, first: Array) -> Array:
    """Return x_0, x_1, ... of x_{t+1} = A x_t + f_t, `(time, states)`, for f `(time, states)`.

    The record is cut into blocks of about the square root of its length. All blocks advance side by
    side from a state of zero; a second pass adds the blocks' initial states.
    """
    time, n = forced.shape
    length = max(int(np.sqrt(time)), 1)
    count = -(-time // length)
    rows = np.zeros((count, length, n))
    rows.reshape(-1, n)[:time] = forced
    with np.errstate(over="ignore", invalid="ignore"):
        ends = np.zeros((count, n))
        for i in range(length):
            ends = ends @ a.T + rows[:, i]
        power, begins = np.linalg.matrix_power(a, length), np.empty((count, n))
        x = first
        for i, end in enumerate(ends):
            begins[i] = x
            x = power @ x + end
        x = begins
        for i in range(length):  # the states in place of the forces, which take as much memory
            rows[:, i], x = x, x @ a.T + rows[:, i]
    return rows.reshape(-1, n)[:time]


def kalman_gain(a: Array, c: Array, q: Array, r: Array) -> Array:
    """Return the stationary gain for noise of covariance q of the state and r of the output."""
    with np.errstate(all="ignore"):
        p = scipy.linalg.solve_discrete_are(a.T, c.T, q, r)
    return np.asarray(a @ p @ c.T @ np.linalg.pinv(c @ p @ c.T + r))


def root_of(covariance: Array) -> Array:
    """Return a square root R of a covariance R R', `(n, n)`."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))


def whitening(visited: Array) -> tuple[Array, Array]:
    """Return T, with T x white of mean square 1 for the `visited` states x, and its inverse."""
    unit = np.eye(visited.shape[1])
    if not np.isfinite(visited).all():
        return unit, unit
    power, axes = np.linalg.eigh(visited.T @ visited / len(visited))
    size = np.sqrt(np.maximum(power, _LEAST * max(power.max(initial=0.0), 1e-300)))
    return axes.T / size[:, None], axes * size


@np.errstate(all="ignore")
def covariance(
    a: Array, c: Array, gain: Array, errors: Sequence[Array], measured: Sequence[Array]
) -> Array:
    """Return the covariance of prediction errors `(ny, ny)`; arguments as of `fitted_gain`."""
    left = []
    for e, s in zip(errors, measured, strict=True):
        x = states(a - gain @ c, e @ gain.T, np.zeros(len(a)))
        left.append((e - x @ c.T) * s)
    e, present = np.concatenate(left), np.concatenate(measured)
    products, counts = e.T @ e, np.maximum(present.sum(axis=0), 1)
    if (present == present[:, :1]).all():
        return np.asarray(products / counts)
    # With gaps, correlations are of different samples: remove negative variances.
    deviation, power = np.sqrt(np.diag(products) / counts), (e**2).T @ present
    root = root_of(products / np.sqrt(np.maximum(power * power.T, 1e-300)))
    return np.asarray(deviation[:, None] * (root @ root.T) * deviation)


def fitted_gain(
    a: Array, c: Array, spread: Array, errors: Sequence[Array], measured: Sequence[Array]
) -> Array:
    """Return the gain K `(states, ny)` with the best predictions, for the errors of a simulation.

    Gains of a Riccati equation, with process noise in proportion to `spread`, the states'
    covariance in the records, are the start; a small gain is then refined. By record, `errors` are
    0 in gaps, and `measured` is 1 elsewhere, `(time, ny)`.
    """

    def cost(gain: Array) -> float:
        observer = a - gain @ c
        if len(a) and abs(np.linalg.eigvals(observer)).max() > MAX_OBSERVER_POLE and gain.any():
            return np.inf
        power = np.diag(covariance(a, c, gain, errors, measured))
        return float(np.log(np.maximum(power, 1e-24)).sum()) if np.isfinite(power).all() else np.inf

    together = np.concatenate(errors)
    r = together.T @ together / len(together) + 1e-18 * np.eye(len(c))
    gains = [np.zeros((len(a), len(c)))]
    for factor in _FACTORS[1 :: 1 if len(a) <= 12 else 3]:
        try:
            gains.append(kalman_gain(a, c, factor**2 * spread + 1e-18 * np.eye(len(a)), r))
        except (np.linalg.LinAlgError, ValueError):
            continue
    stable = len(a) == 0 or abs(np.linalg.eigvals(a)).max() <= 1
    best = min(gains if stable else gains[1:] or gains, key=cost)
    if best.any() and best.size <= _FREE and not current().over:
        scale = float(abs(best).max())
        shape, start = best.shape, best.ravel() / scale

        def bounded(x: Array) -> float:
            return min(cost(scale * x.reshape(shape)), 1e6)

        minimum: Any = scipy.optimize.minimize(
            bounded, start, method="L-BFGS-B", options={"maxiter": 15}
        )
        best = np.asarray(scale * minimum.x.reshape(shape))
    return best


def most_probable(information: Array, towards: Array, usual: Array) -> Array:
    """Return the most probable state, in standard deviations of the prior, `(n,)`.

    The prior has the covariance of the states in training times a factor: the `usual` one (0 for a
    known state, 1 for one drawn from the prior), or the most likely one after a surprising history
    (empirical Bayes). `information` `(n, n)` and `towards` `(n,)` are products of the responses to
    the states, with one another and with the prediction errors.
    """
    n = towards.shape[0]
    factors = np.concatenate([usual[None], np.array(_PRIOR_FACTORS)])
    count = len(_PRIOR_FACTORS) + 1
    unit = np.broadcast_to(np.eye(n)[None], (count, n, n))
    square = unit + factors[:, None, None] * information[None]
    left: Any = np.concatenate(
        [square, np.broadcast_to(towards[None, :, None], (count, n, 1))], axis=2
    )
    # Gauss-Jordan elimination; as the prior adds the unit matrix, no pivot is below 1.
    size = np.zeros(count)
    for j in range(n):
        pivot = np.maximum(left[:, j, j], 1.0)
        size = size + np.log(pivot)
        row = left[:, j] / pivot[:, None]
        rest = left - left[:, :, j][:, :, None] * row[:, None, :]
        others = (np.arange(n) != j)[None, :, None]
        left = np.where(others, rest, np.broadcast_to(row[:, None, :], (count, n, n + 1)))
    candidates = left[:, :, n] * factors[:, None]
    unlikely = size - (candidates * towards[None]).sum(axis=1)
    least = np.min(unlikely[1:], axis=0)
    first = np.arange(count) == 0
    taken = np.where(
        least + _SURPRISING > unlikely[0], first, (unlikely <= least) & np.logical_not(first)
    )
    weights = np.where(taken, 1.0, 0.0)
    taken_state: Array = (weights[:, None] * candidates).sum(axis=0) / weights.sum()
    return taken_state


def responses(a: Array, c: Array, root: Array, time: int) -> Array:
    """Return the outputs' responses to columns of `root`, `(time, ny, columns)`, until decayed."""
    rows, power = c[None], a
    while len(rows) < time:
        later = rows @ power
        size = abs(later @ root).max(initial=0.0)
        rows, power = np.concatenate([rows, later]), power @ power
        if not np.isfinite(size) or size < _DECAYED * abs(rows[0] @ root).max(initial=0.0):
            break
    return np.asarray(rows[:time] @ root)
