"""Realise a linear output-error model in state space.

The polynomials of each channel become a block in observer canonical form. The states are
decorrelated and scaled to a standard deviation of 1 in the record, so that they neither saturate
the units of a network nor leave them idle. See T. Kailath, Linear Systems, 1980, Ch. 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from splitband.baselines.linear import OutputError
from splitband.runtime.arrays import Array

_FASTEST, _SLOWEST = 0.5, 0.95
"""Range of the poles of additional states that the output does not depend on. By eye."""
_RANK = 1e-6
"""Variances below this share of the largest one are raised to it before scaling. By eye."""
_RIDGE = 1e-6
"""Ridge penalty of the state estimator, as a share of the regressors' mean square. By eye."""


class Realisation(NamedTuple):
    """Hold x_{n+1} = A x_n + B u_n, y_n = C x_n + D u_n + offset, and its simulated states.

    The inputs u_n are in the record's units.

    Attributes
    ----------
    a, b, c, d, offset : `(states, states)`, `(states, nu)`, `(ny, states)`, `(ny, nu)`, `(ny,)`.
    states : State trajectory in each record, `(time, states)`.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    offset: Array
    states: tuple[Array, ...]


def realised(
    model: OutputError, inputs: Sequence[Array], states: int, rng: np.random.Generator
) -> Realisation:
    """Return a state-space model with `states` states, and its states in the records.

    If the polynomials have more poles, the least important states are removed (balanced
    truncation). If they have fewer, states are added that the output does not depend on.

    Parameters
    ----------
    model : A model without delays.
    inputs : Inputs of each training record, `(time, nu)`.
    states : Number of states.
    rng : Draws the input matrix of additional states.
    """
    a, b, c, d = model.without_delays()
    first = np.concatenate([channel.c for channel in model.channels])
    if len(a) > states:
        into, out = _reduction(a, b, c, states)
        a, b, c, first = into @ a @ out, into @ b, c @ out, into @ first
    more = states - len(a)
    poles = np.linspace(_FASTEST, _SLOWEST, more)
    a = scipy.linalg.block_diag(a, np.diag(poles))
    drawn = rng.standard_normal((more, b.shape[1])) * np.sqrt(1 - poles**2)[:, None]
    b, c = np.concatenate([b, drawn]), np.hstack([c, np.zeros((len(c), more))])
    first = np.append(first, np.zeros(more))
    scaled = [(u - model.mean) / model.scale for u in inputs]
    starts = [first, *[np.zeros(states)] * (len(inputs) - 1)]
    runs = [_simulated(a, b, x, u) for x, u in zip(starts, scaled, strict=True)]
    together = np.concatenate(runs)
    variance, axes = np.linalg.eigh(together.T @ together / len(together))
    size = np.sqrt(np.maximum(variance, _RANK * max(variance[-1], np.finfo(float).tiny)))
    into, out = axes.T / size[:, None], axes * size
    a, b, c = into @ a @ out, into @ b / model.scale, c @ out
    d = d / model.scale
    offset = np.array([channel.offset for channel in model.channels]) - d @ model.mean
    # The means of the inputs shift the states by constants; the output's offset compensates.
    still = np.linalg.solve(np.eye(states) - a, b @ model.mean)
    offset = offset - c @ still
    return Realisation(a, b, c, d, offset, tuple(run @ into.T + still for run in runs))


def state_estimator(
    runs: Sequence[tuple[Array, Array]], states: Sequence[Array], samples: int
) -> tuple[Array, Array]:
    """Fit a linear map from a window of `y` and `u` to the state at its first sample.

    Returns the matrix and the constant of the map, by ridge regression over all windows of the
    records without gaps.

    Parameters
    ----------
    runs : `y` `(time, ny)`, NaN in gaps, and the network's inputs `(time, nu)`, of each record.
    states : States in each record, `(time, states)`.
    samples : Samples of a window; its values are ordered sample by sample, y before u.
    """
    seen, wanted = [], []
    for (y, u), x in zip(runs, states, strict=True):
        if len(y) >= samples:
            both = np.hstack([y, u])
            views = np.lib.stride_tricks.sliding_window_view(both, samples, axis=0)
            seen.append(views.transpose(0, 2, 1).reshape(len(views), -1))
            wanted.append(x[: len(views)])
    rows, target = np.concatenate(seen), np.concatenate(wanted)
    whole = ~np.isnan(rows).any(axis=1)
    rows, target = rows[whole], target[whole]
    if not len(rows):
        width = samples * (runs[0][0].shape[1] + runs[0][1].shape[1])
        return np.zeros((states[0].shape[1], width)), np.zeros(states[0].shape[1])
    middle, mean = rows.mean(axis=0), target.mean(axis=0)
    rows, target = rows - middle, target - mean
    square = rows.T @ rows
    square += _RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    weight = np.linalg.solve(square, rows.T @ target).T
    return weight, mean - weight @ middle


def _simulated(a: Array, b: Array, x: Array, u: Array) -> Array:
    """Simulate the states from the initial state `x`, `(time, states)`."""
    forced, found = u @ b.T, np.empty((len(u), len(a)))
    for n in range(len(u)):
        found[n] = x
        x = a @ x + forced[n]
    return found


def _reduction(a: Array, b: Array, c: Array, states: int) -> tuple[Array, Array]:
    """Return maps to the most important states and back (balanced truncation; Moore, 1981)."""
    reach = scipy.linalg.solve_discrete_lyapunov(a, b @ b.T)
    seen = scipy.linalg.solve_discrete_lyapunov(a.T, c.T @ c)
    roots = []
    for gramian in (reach, seen):
        values, vectors = np.linalg.eigh(gramian)
        roots.append(vectors * np.sqrt(np.maximum(values, 0)))
    outer, size, inner = np.linalg.svd(roots[1].T @ roots[0])
    scale = 1 / np.sqrt(np.maximum(size[:states], _RANK * size[0]))
    into = scale[:, None] * (roots[1] @ outer[:, :states]).T
    return into, (roots[0] @ inner[:states].T) * scale
