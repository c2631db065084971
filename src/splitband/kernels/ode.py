"""Solve ordinary differential equations on the time grid of a record, compiled where it can be.

Dormand and Prince's method of order 5 (J. Comp. Appl. Math. 6, 1980), with the step size control of
Hairer, Nørsett and Wanner (Solving Ordinary Differential Equations I, Sec. II.4). A step ends at
each sample, where inputs may have a kink. Steps are chosen once and taken again for neighbouring
parameters and states, so that finite differences see a smooth function.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from functools import cache, partial
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload

from splitband.runtime.arrays import Array

Rhs = Callable[..., Any]

MOST_STEPS = 10_000
"""Most steps between two samples, rejected ones included. Bounds the time."""
SHORTEST = 1e-12
"""Shortest step, as a share of the interval between two samples. Rounding."""
WORTH_COMPILING = 30_000
"""Steps after which an equation is compiled: they take about as long as compiling."""
_OPTIONS: Any = {"error_model": "numpy"}
NODES = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
WEIGHTS = np.zeros((7, 7))
WEIGHTS[1, :1] = 1 / 5
WEIGHTS[2, :2] = 3 / 40, 9 / 40
WEIGHTS[3, :3] = 44 / 45, -56 / 15, 32 / 9
WEIGHTS[4, :4] = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
WEIGHTS[5, :5] = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
WEIGHTS[6, :6] = 35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
"""Weights of the stages, whose nodes are `NODES`; the last stage is the step."""
_ERRORS = np.array(
    [71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40]
)  # of order 5 less order 4


def solve(  # noqa: PLR0912  one loop, for Numba
    rhs: Rhs,
    p: Any,
    initial: Array,
    time: Array,
    inputs: tuple[Array, bool],
    steps: tuple[Array, float],
    tolerances: tuple[float, float],
) -> tuple[Array, Array, float]:
    """Return the states at the times `time`, the steps that were taken, and the size of the next.

    The states are `(time, nx)`, NaN from where the tolerances cannot be reached or a state is not
    finite. A step is given by its end, as a share of the interval between two samples: 1 ends it.

    Parameters
    ----------
    rhs : `rhs(t, x, u, p) -> dx/dt`, as a list, a tuple or an array.
    p : What it gets as `p`.
    initial : `(nx,)`, at the first time.
    time : `(time,)`, in s.
    inputs : `(time, nu)`, and whether they are held between samples; otherwise they run along
        straight lines.
    steps : Steps to take, empty to choose them; and the size in s of the first one that is tried, 0
        for the first interval.
    tolerances : Relative and absolute tolerance of a step.
    """
    u, held = inputs
    given, size = steps
    rtol, atol = tolerances
    nx, nu = initial.shape[0], u.shape[1]
    states = np.full((time.shape[0], nx), np.nan)
    ends, taken = np.empty(max(len(given), 2 * time.shape[0])), 0
    k, stage, now = np.empty((7, nx)), np.empty(nx), np.empty(nu)
    x = initial.copy()
    states[0] = x
    for n in range(time.shape[0] - 1):
        width = time[n + 1] - time[n]
        size = size if size > 0 else width
        begin, known, tried = 0.0, 0, 0  # `known`: whether k[0] holds the slope at `begin`
        while begin < 1.0:
            if len(given):
                end = given[taken] if taken < len(given) else begin
            else:
                end = begin + size / width
                end = 1.0 if end > 1.0 - SHORTEST else end
            tried += 1
            if not end - begin > SHORTEST or tried > MOST_STEPS:
                return states, ends[:taken], size
            h = (end - begin) * width
            for s in range(known, 7):
                for j in range(nx):
                    stage[j] = x[j]
                    for r in range(s):
                        stage[j] += h * WEIGHTS[s, r] * k[r, j]
                share = begin + NODES[s] * (end - begin)
                for j in range(nu):
                    now[j] = u[n, j] if held else u[n, j] + share * (u[n + 1, j] - u[n, j])
                slope = rhs(time[n] + share * width, stage, now, p)
                for j in range(nx):
                    k[s, j] = slope[j]
            known = 1
            error = 0.0
            for j in range(nx):  # the last stage is the new state
                each = 0.0
                for r in range(7):
                    each += h * _ERRORS[r] * k[r, j]
                error += (each / (atol + rtol * max(abs(x[j]), abs(stage[j])))) ** 2
            error = np.sqrt(error / nx)
            if not len(given):
                factor = 0.2 if np.isnan(error) else min(max(0.9 * error**-0.2, 0.2), 10.0)
                # One that ends at a sample may have been shorter than it could be.
                size = max(size, h * factor) if error <= 1.0 and end == 1.0 else h * factor
            if len(given) or error <= 1.0:
                if taken == len(ends):
                    ends = np.concatenate((ends, np.empty(len(ends))))
                ends[taken] = end
                taken += 1
                begin = end
                x[:] = stage
                k[0] = k[6]
        if not np.isfinite(x).all():
            break
        states[n + 1] = x
    return states, ends[:taken], size


@overload(np.clip, strict=False)
def _clip(a: Any, a_min: Any, a_max: Any) -> Any:
    """Return `np.clip` of a number, as of a hard saturation: Numba has that of arrays alone."""
    numbers = all(isinstance(each, types.Number) for each in (a, a_min, a_max))
    return (lambda a, a_min, a_max: np.minimum(np.maximum(a, a_min), a_max)) if numbers else None


_compiled = njit(**_OPTIONS)(solve)


class Solver:
    """Solve an equation; after many steps it is compiled with Numba, if possible.

    Parameters
    ----------
    rhs : A function of the first `arguments` of (t, x, u, p), see `solve`.
    arguments : Their number, 2 to 4.
    """

    def __init__(self, rhs: Rhs, arguments: int) -> None:
        self.rhs, self.arguments = rhs, arguments
        self.python: Rhs = partial(solve, _prefixed(rhs, arguments))
        self.solve: Rhs = self.python
        self.taken, self.tried = 0, False
        self.kept: list[Any] = []

    def __call__(
        self,
        p: Any,
        initial: Array,
        time: Array,
        inputs: tuple[Array, bool],
        steps: tuple[Array, float],
        tolerances: tuple[float, float],
    ) -> tuple[Array, Array, float]:
        """Return what `solve` returns."""
        with np.errstate(all="ignore"):
            if self.solve is not self.python and self.kept != referred(self.rhs):
                self.solve, self.taken, self.tried = self.python, 0, False
            if self.taken > WORTH_COMPILING and not self.tried:
                probe = p, initial, time[:3], (inputs[0][:3], inputs[1]), (np.empty(0), 0.0)
                self._compile(*probe, tolerances)
            found: tuple[Array, Array, float] = self.solve(
                p, initial, time, inputs, steps, tolerances
            )
        self.taken += len(found[1])
        return found

    def _compile(self, *probe: Any) -> None:
        """Use compiled code if it agrees on a short simulation: it does not check indices."""
        self.tried, self.kept = True, referred(self.rhs)
        expected = self.python(*probe)[0]
        try:
            fast = wrapped = njit(**_OPTIONS)(getattr(self.rhs, "py_func", self.rhs))
            if self.arguments <= 3:
                wrapped = njit(**_OPTIONS)(_prefixed(fast, self.arguments))
            compiled = partial(_compiled, wrapped)
            found = compiled(*probe)[0]
        except Exception as error:  # code that Numba does not support
            said = [line for line in str(error).splitlines() if not line.startswith("Failed in")]
            reason = next(iter(said), "") or type(error).__name__
        else:
            if np.allclose(found, expected, rtol=1e-6, equal_nan=True):
                self.solve = compiled
                return
            reason = "compiled, it gives other numbers"
        name = getattr(self.rhs, "__name__", type(self.rhs).__name__)
        warnings.warn(
            f"the equation {name} is solved in Python, many times "
            f"slower than compiled: Numba cannot compile it ({reason.strip(' .:')}); write it with "
            'numbers, p.k in place of p["k"], and other functions of NumPy or math',
            stacklevel=2,
        )


@cache
def solver(rhs: Rhs, arguments: int) -> Solver:
    """Return the solver of an equation, one for all that solve it."""
    return Solver(rhs, arguments)


def referred(function: Any) -> list[Any]:
    """Return the values that the names in a function stand for now, which compiled code keeps.

    Attributes of modules are among them. What an object does that is no function is not known.
    """
    function = getattr(function, "py_func", function)
    if not isinstance(function, FunctionType):
        return []
    codes, names = [function.__code__], set[str]()
    for code in codes:  # to which those of functions in it are added
        names |= {*code.co_names}
        codes += [const for const in code.co_consts if isinstance(const, CodeType)]
    spaces, found = [function.__globals__], list[Any]()
    for space in spaces:
        values = [space[name] for name in sorted(names & space.keys())]
        inner = [vars(value) for value in values if isinstance(value, ModuleType)]
        spaces += [each for each in inner if not any(each is other for other in spaces)]
        found += [value for value in values if not isinstance(value, ModuleType)]
    cells = (cell.cell_contents for cell in function.__closure__ or ())
    return [_content(value) for value in [*found, *cells]]


def _content(value: Any) -> Any:
    """Return what tells a value from others, also from itself after a change in place."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return repr(value)


def _prefixed(rhs: Rhs, arguments: int) -> Rhs:
    """Return `rhs(t, x, u, p)` of a function of the first of these arguments."""
    if arguments == 2:
        return lambda t, x, _u, _p: rhs(t, x)
    if arguments == 3:
        return lambda t, x, u, _p: rhs(t, x, u)
    return rhs
