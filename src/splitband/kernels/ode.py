"""Solve ordinary differential equations on the time grid of a record, compiled where it can be.

Dormand and Prince's method of order 5 (J. Comp. Appl. Math. 6, 1980) with equal steps between two
samples, where inputs may have a kink. How many steps an interval takes is found once and used again
for neighbouring parameters and states, so that finite differences see a smooth function.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from splitband.runtime.arrays import Array

Rhs = Callable[..., Any]

MOST_STEPS = 512
"""Steps between two samples; beyond that an interval is taken as it is, as at a discontinuity."""
_OPTIONS: Any = {"error_model": "numpy"}
_NODES = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
_WEIGHTS = np.zeros((7, 7))
_WEIGHTS[1, :1] = 1 / 5
_WEIGHTS[2, :2] = 3 / 40, 9 / 40
_WEIGHTS[3, :3] = 44 / 45, -56 / 15, 32 / 9
_WEIGHTS[4, :4] = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
_WEIGHTS[5, :5] = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
_WEIGHTS[6, :6] = 35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
_ERRORS = np.array(
    [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40]
)  # of order 5 less order 4


def solve(  # noqa: PLR0912  one loop, for Numba
    rhs: Rhs,
    p: Any,
    initial: Array,
    time: Array,
    inputs: tuple[Array, bool],
    control: tuple[NDArray[np.int64], float, float],
) -> Array:
    """Return the states at the times `time`, `(time, nx)`; NaN from where they are not finite.

    Parameters
    ----------
    rhs : `rhs(t, x, u, p) -> dx/dt`, as a list, a tuple or an array.
    p : What it gets as `p`.
    initial : `(nx,)`, at the first time.
    time : `(time,)`, in s.
    inputs : `(time, nu)`, and whether they are held between samples; otherwise they run along
        straight lines.
    control : Steps of each interval, `(time - 1,)`, where 0 is found and filled in, and in the
        first place less than 0 says how many the interval before has taken; the relative and the
        absolute tolerance of an interval.
    """
    u, held = inputs
    steps, rtol, atol = control
    nx, nu = initial.shape[0], u.shape[1]
    states = np.full((time.shape[0], nx), np.nan)
    k = np.empty((7, nx))
    x, stage, begin = initial.copy(), np.empty(nx), np.empty(nx)
    now = np.empty(nu)
    states[0] = x
    count = max(1, -steps[0]) if len(steps) else 1
    for n in range(time.shape[0] - 1):
        width = time[n + 1] - time[n]
        given = steps[n] > 0
        count = steps[n] if given else max(1, count // 2)
        begin[:] = x
        while True:
            x[:] = begin
            worst = 0.0
            h = width / count
            for i in range(count):
                for s in range(7):
                    for j in range(nx):
                        stage[j] = x[j]
                        for r in range(s):
                            stage[j] += h * _WEIGHTS[s, r] * k[r, j]
                    share = (i + _NODES[s]) / count
                    for j in range(nu):
                        now[j] = u[n, j] if held else u[n, j] + share * (u[n + 1, j] - u[n, j])
                    slope = rhs(time[n] + share * width, stage, now, p)
                    for j in range(nx):
                        k[s, j] = slope[j]
                for j in range(nx):  # the last stage is the new state
                    error = 0.0
                    for r in range(7):
                        error += h * _ERRORS[r] * k[r, j]
                    error = abs(error)
                    allowed = atol + rtol * max(abs(x[j]), abs(stage[j]))
                    if not error <= worst * allowed:
                        worst = error / allowed
                    x[j] = stage[j]
            if given or count >= MOST_STEPS or worst <= 1.0:
                break
            larger = count * min(8.0, 1.1 * worst**0.2) if np.isfinite(worst) else 8.0 * count
            count = min(MOST_STEPS, max(count + 1, int(np.ceil(larger))))
        steps[n] = count
        if not np.isfinite(x).all():
            break
        states[n + 1] = x
    return states


_plain = solve
_compiled = njit(**_OPTIONS)(solve)


@cache
def solver(rhs: Rhs, arguments: int, compiled: bool) -> Rhs:
    """Return `solve` for a function of the first `arguments` of (t, x, u, p).

    Where it is to be compiled, that is done when it is first called.
    """
    if not compiled:
        return partial(_plain, _prefixed(rhs, arguments))
    fast = njit(**_OPTIONS)(rhs)
    wrapped = fast if arguments > 3 else njit(**_OPTIONS)(_prefixed(fast, arguments))
    return partial(_compiled, wrapped)


def _prefixed(rhs: Rhs, arguments: int) -> Rhs:
    """Return `rhs(t, x, u, p)` of a function of the first of these arguments."""
    if arguments == 2:
        return lambda t, x, _u, _p: rhs(t, x)
    if arguments == 3:
        return lambda t, x, u, _p: rhs(t, x, u)
    return rhs
