"""Minimise sums of squares between bounds, and estimate a state by one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError

BAD = 1e3
"""Residual of a failed run, and upper limit of others, in deviations of a channel. By eye."""
_ENOUGH = 1e-9
"""Gain of a step that ends a minimisation, as a share of the squared error. Rounding."""
Evaluate = Callable[[Array, bool], tuple[float, Array, Array]]
"""Returns half the sum of squares at some unknowns and, if asked for, its gradient and the normal
matrix J'J."""


def minimise(
    evaluate: Evaluate, begin: Array, low: Any, high: Any, rounds: int, alike: slice = slice(0)
) -> tuple[Array, float]:
    """Minimise a sum of squares between bounds by Levenberg and Marquardt's method.

    The damping is that of Nielsen (1999), in the largest size of each derivative so far; unknowns
    that are `alike`, as the weights of a network, have a common size: with sizes of their own, four
    times as many steps did not lead as far. Unknowns that a step would take beyond a bound go to
    it, and the step is solved again for the others. At a deadline the best ones so far are
    returned.
    """
    at = np.clip(begin, low, high)
    cost, gradient, normal = evaluate(at, True)
    damping, growth, scale = 1e-3, 2.0, np.zeros(len(at))
    try:
        for _ in range(rounds if len(at) else 0):
            scale = np.maximum(scale, np.diag(normal))
            scale[alike] = np.mean(scale[alike]) if alike.stop else 0.0
            floor = 1e-12 * scale.max(initial=1e-300)
            step = _bounded_step(
                normal + np.diag(damping * np.maximum(scale, floor)), gradient, at, low, high
            )
            expected = -float(step @ (gradient + 0.5 * normal @ step))
            if not expected > _ENOUGH * cost:
                break
            new = evaluate(at + step, False)[0]
            share = (cost - new) / expected
            if not share > 1e-4:
                damping, growth = damping * growth, 2 * growth
                continue
            at, before = at + step, cost
            cost, gradient, normal = evaluate(at, True)
            damping, growth = damping * max(1 / 3, 1 - (2 * share - 1) ** 3), 2.0
            if before - cost < _ENOUGH * cost:
                break
    except DeadlineError:
        pass
    return at, cost


def _bounded_step(matrix: Array, gradient: Array, at: Array, low: Any, high: Any) -> Array:
    """Return the step to the minimum of a quadratic function, within the bounds."""
    free, step = np.ones(len(at), dtype=bool), np.zeros(len(at))
    while free.any():
        right = gradient[free] + matrix[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(matrix[np.ix_(free, free)], right)
        within = np.clip(at + step, low, high)
        beyond = free & (within != at + step)
        if not beyond.any():
            break
        step[beyond] = (within - at)[beyond]
        free &= ~beyond
    return step


def likely_state(  # noqa: PLR0913
    run: Callable[[Array, bool], tuple[Array, Array]],
    measured: Array,
    unit: Array,
    mean: Array,
    spread: Array,
    begin: Array,
    rounds: int,
    limit: float,
) -> tuple[Array, float]:
    """Return the state of the least errors and distance from its prior, and half their squares.

    Parameters
    ----------
    run : Returns the channels from a state on, `(time, ny)`, and if asked for their derivatives.
    measured, unit : Samples, `(time, ny)`, NaN in gaps, and the unit of errors, `(ny,)`.
    mean, spread : Of the prior, `(nx,)`.
    begin, rounds : State at the beginning, and the largest number of steps.
    limit : Largest size of a residual.
    """

    def residuals(z: Array, slopes: bool) -> tuple[Array, Array]:
        y, slope = run(mean + spread * z, slopes)
        left = limited((y - np.nan_to_num(measured)) / unit, limit)
        left = np.where(np.isnan(measured), 0.0, left)
        every = np.concatenate([left.ravel(), z])
        if not slopes:
            return every, left
        good = (np.abs(left) < limit) & ~np.isnan(measured)
        rows = np.where(good[..., None], slope * spread / unit[:, None], 0.0)
        return every, np.vstack([finite(rows.reshape(left.size, -1)), np.eye(len(z))])

    at, cost = minimise(squared(residuals), (begin - mean) / spread, -np.inf, np.inf, rounds)
    return mean + spread * at, cost


def squared(residuals: Callable[[Array, bool], tuple[Array, Array]]) -> Evaluate:
    """Return the function for `minimise` of one that returns residuals and their derivatives."""

    def evaluate(z: Array, slopes: bool) -> tuple[float, Array, Array]:
        left, block = residuals(z, slopes)
        cost = 0.5 * float(left @ left)
        return (cost, block.T @ left, block.T @ block) if slopes else (cost, z, block)

    return evaluate


def finite(values: Array) -> Array:
    """Return values with 0 for those that are not finite."""
    return np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)


def limited(residuals: Array, limit: float = BAD) -> Array:
    """Return residuals between limits; non-finite ones are at the upper one."""
    return np.where(np.isfinite(residuals), np.clip(residuals, -limit, limit), limit)
