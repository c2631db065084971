"""Bring a linear model to the number of states of a network, and estimate states from windows.

The states are decorrelated and scaled to a standard deviation of 1 in the record, so that they
neither saturate the units of a network nor leave them idle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from splitband.baselines.linear import LinearModel
from splitband.baselines.systems import states as simulated
from splitband.baselines.systems import whitening
from splitband.runtime.arrays import Array

_FASTEST, _SLOWEST = 0.5, 0.95
"""Range of the poles of additional states that the output does not depend on. By eye."""
_RIDGE = 1e-6
"""Ridge penalty of the state estimator, as a share of the regressors' mean square. By eye."""


class Realisation(NamedTuple):
    """Hold x_{n+1} = A x_n + B u_n + drift, y_n = C x_n + D u_n + offset, and its states.

    The inputs u_n are in the record's units.

    Attributes
    ----------
    a, b, c, d : `(states, states)`, `(states, nu)`, `(ny, states)` and `(ny, nu)`.
    drift, offset : `(states,)` and `(ny,)`.
    states : State trajectory in each record, `(time, states)`.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    drift: Array
    offset: Array
    states: tuple[Array, ...]


def realised(
    model: LinearModel, inputs: Sequence[Array], states: int, rng: np.random.Generator
) -> Realisation:
    """Return a state-space model with `states` states, and its states in the records.

    If the model has fewer, states are added that the output does not depend on.

    Parameters
    ----------
    model : A model without delays, of at most `states` poles.
    inputs : Inputs of each training record, `(time, nu)`.
    states : Number of states.
    rng : Draws the input matrix of additional states.
    """
    more = states - model.order
    poles = np.linspace(_FASTEST, _SLOWEST, more)
    a = scipy.linalg.block_diag(model.a, np.diag(poles))
    drawn = rng.standard_normal((more, model.nu)) * np.sqrt(1 - poles**2)[:, None]
    size = np.concatenate(inputs).std(axis=0)
    b = np.concatenate([model.b, drawn / np.where(size > 0, size, 1.0)])
    c = np.hstack([model.c, np.zeros((model.ny, more))])
    drift = np.append(model.drift, np.zeros(more)) - b @ model.mean
    first = np.append(model.first, np.zeros(more))
    middle = np.append(model.centre, np.zeros(more))
    starts = [first, *[middle] * (len(inputs) - 1)]
    runs = [simulated(a, u @ b.T + drift, x) for x, u in zip(starts, inputs, strict=True)]
    into, out = whitening(np.concatenate(runs))
    offset = model.offset - model.d @ model.mean
    return Realisation(into @ a @ out, into @ b, c @ out, model.d, into @ drift, offset,
                       tuple(run @ into.T for run in runs))  # fmt: skip


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
