"""Estimate the initial state of a linear model from a history and the states in training.

The innovations form has no other unknown: for a given initial state its prediction errors follow
from the outputs, and they are white. Their sum of squares, with a prior of the state, makes the
most probable state a linear least-squares problem; the state at the end of the history is then what
the Kalman filter with this prior finds. The step-by-step form (`forecasters.stepping_linear`) uses
the same functions, which therefore can be traced.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from splitband.runtime.arrays import Array

FACTORS = (1e-4, 1e-2, 1.0, 1e2, 1e4, 1e6)
"""Candidate factors of the prior covariance of an initial state. By eye."""
SURPRISING = 8.0
"""Rise of twice the log-likelihood that a factor other than the usual one must bring. By eye."""
EXACT = 1e-5
"""Smallest standard deviation of an error, as a share of the output's in training: with smaller
ones the normal equations would lose the state to rounding."""
_DECAYED = 1e-12
"""Responses to the initial state that are smaller than this share of the largest are dropped."""


def most_probable(information: Array, towards: Array, usual: Array) -> Array:
    """Return the most probable state, in standard deviations of the prior, `(n,)`.

    The prior has the covariance of the states in training times a factor: the `usual` one, or the
    most likely one where the history is surprising (empirical Bayes).

    Parameters
    ----------
    information : Sum of squares of the responses to each state, in units of the noise, `(n, n)`.
    towards : Their products with the prediction errors, `(n,)`.
    usual : The usual factor: 0 for a state that is known, 1 for one that is drawn from the prior.
    """
    n = towards.shape[0]
    factors = np.concatenate([usual[None], np.array(FACTORS)])
    count = len(FACTORS) + 1
    unit = np.broadcast_to(np.eye(n)[None], (count, n, n))
    square = unit + factors[:, None, None] * information[None]
    left: Any = np.concatenate(
        [square, np.broadcast_to(towards[None, :, None], (count, n, 1))], axis=2
    )
    # Gauss and Jordan's elimination; as the prior adds the unit matrix, no pivot is below 1.
    size = np.zeros(count)
    for j in range(n):
        pivot = np.maximum(left[:, j, j], 1.0)
        size = size + np.log(pivot)
        row = left[:, j] / pivot[:, None]
        rest = left - left[:, :, j][:, :, None] * row[:, None, :]
        others = (np.arange(n) != j)[None, :, None]
        left = np.where(others, rest, np.broadcast_to(row[:, None, :], (count, n, n + 1)))
    found = left[:, :, n] * factors[:, None]
    unlikely = size - (found * towards[None]).sum(axis=1)
    least = np.min(unlikely[1:], axis=0)
    first = np.arange(count) == 0
    taken = np.where(
        least + SURPRISING > unlikely[0], first, (unlikely <= least) & np.logical_not(first)
    )
    weights = np.where(taken, 1.0, 0.0)
    taken_state: Array = (weights[:, None] * found).sum(axis=0) / weights.sum()
    return taken_state


def responses(a: Array, c: Array, root: Array, time: int) -> Array:
    """Return the responses of the outputs to each column of `root`, `(time, ny, columns)`.

    They end early where they have died out.
    """
    rows, power = c[None], a
    while len(rows) < time:
        later = rows @ power
        size = abs(later @ root).max(initial=0.0)
        rows, power = np.concatenate([rows, later]), power @ power
        if not np.isfinite(size) or size < _DECAYED * abs(rows[0] @ root).max(initial=0.0):
            break
    return np.asarray(rows[:time] @ root)
