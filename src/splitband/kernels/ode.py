"""Solve ordinary differential equations on the time grid of a record, compiled where possible.

Dormand and Prince's method of order 5 (J. Comp. Appl. Math. 6, 1980), with the step size control of
Hairer, Nørsett and Wanner (Solving Ordinary Differential Equations I, Sec. II.4). Steps end at
samples, where inputs may have a kink. Neighbouring parameters and states repeat the chosen steps,
so that finite differences are taken of a smooth function.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Sequence
from functools import cache, partial
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload

from splitband.kernels.terms import with_terms
from splitband.runtime.arrays import Array

Rhs = Callable[..., Any]

MOST_STEPS = 10_000
"""Most steps between two samples, rejected ones included. Bounds the time."""
SHORTEST = 1e-12
"""Shortest step, as a share of the interval between two samples. Rounding."""
WORTH_COMPILING = 30_000
"""Steps after which an equation is compiled, for about the time of compiling it."""
_OPTIONS: Any = {"error_model": "numpy"}
NODES = np.array([0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1, 1])
"""Nodes of Dormand and Prince's stages."""
WEIGHTS = np.zeros((7, 7))
WEIGHTS[1, :1] = 1 / 5
WEIGHTS[2, :2] = 3 / 40, 9 / 40
WEIGHTS[3, :3] = 44 / 45, -56 / 15, 32 / 9
WEIGHTS[4, :4] = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
WEIGHTS[5, :5] = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
WEIGHTS[6, :6] = 35 / 384, 0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
"""Weights of the stages at `NODES`; the last stage is the step."""
_ERRORS = np.array([71 / 57600, 0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])
"""Weights of order 5 less those of order 4."""


def solve(  # noqa: PLR0912  one loop, for Numba
    rhs: Rhs,
    p: Any,
    initial: Array,
    time: Array,
    inputs: tuple[Array, bool],
    steps: tuple[Array, float],
    tolerances: tuple[float, float],
) -> tuple[Array, Array, float]:
    """Return the states at the times `time`, the steps taken, and the size of the next step.

    The states are `(time, nx)`, NaN from the first missed tolerance or non-finite state on. Steps
    are given by their ends, as shares of the interval between two samples.

    Parameters
    ----------
    rhs : `rhs(t, x, u, p) -> dx/dt`, as a list, a tuple or an array.
    p : Parameters, passed on to `rhs`.
    initial : `(nx,)`, at the first time.
    time : `(time,)`, in s.
    inputs : `(time, nu)`, and whether to hold them between samples, else linear interpolation.
    steps : Steps to take, empty to choose them; and the size in s of the first trial step, 0 for
        the first interval.
    tolerances : Relative and absolute tolerance of a step.
    """
    u, held = inputs
    schedule, size = steps
    rtol, atol = tolerances
    nx, nu = initial.shape[0], u.shape[1]
    states = np.full((time.shape[0], nx), np.nan)
    ends, taken = np.empty(max(len(schedule), 2 * time.shape[0])), 0
    k, stage, now = np.empty((7, nx)), np.empty(nx), np.empty(nu)
    x = initial.copy()
    states[0] = x
    for n in range(time.shape[0] - 1):
        width = time[n + 1] - time[n]
        size = size if size > 0 else width
        begin, stages, tried = 0.0, 0, 0  # `stages`: 1 if k[0] holds the slope at `begin`, else 0
        while begin < 1.0:
            if len(schedule):
                end = schedule[taken] if taken < len(schedule) else begin
            else:
                end = begin + size / width
                end = 1.0 if end > 1.0 - SHORTEST else end
            tried += 1
            if not end - begin > SHORTEST or tried > MOST_STEPS:
                return states, ends[:taken], size
            h = (end - begin) * width
            for s in range(stages, 7):
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
            stages = 1
            error = 0.0
            for j in range(nx):  # the last stage is the new state
                difference = 0.0
                for r in range(7):
                    difference += h * _ERRORS[r] * k[r, j]
                error += (difference / (atol + rtol * max(abs(x[j]), abs(stage[j])))) ** 2
            error = np.sqrt(error / nx)
            if not len(schedule):
                factor = 0.2 if np.isnan(error) else min(max(0.9 * error**-0.2, 0.2), 10.0)
                # A step to the next sample may be shorter than the tolerances allow.
                size = max(size, h * factor) if error <= 1.0 and end == 1.0 else h * factor
            if len(schedule) or error <= 1.0:
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
    """Return `np.clip` of a number, such as a hard saturation: Numba clips arrays only."""
    numbers = all(isinstance(argument, types.Number) for argument in (a, a_min, a_max))
    return (lambda a, a_min, a_max: np.minimum(np.maximum(a, a_min), a_max)) if numbers else None


_compiled = njit(**_OPTIONS)(solve)


class Solver:
    """The solver of an equation, compiled with Numba after many steps, if possible.

    Parameters
    ----------
    rhs : A function of the first `arguments` of (t, x, u, p), see `solve`; of five with (t, x, u,
        p, w) and unknown terms, see `kernels.terms.with_terms`.
    arguments : The number of arguments of `rhs`, 2 to 5.
    of : The functions of the quantities of unknown terms.
    """

    def __init__(self, rhs: Rhs, arguments: int, of: Sequence[Rhs | None] = ()) -> None:
        self.rhs, self.arguments, self.of = rhs, arguments, of
        self.python: Rhs = partial(solve, _prefixed(rhs, arguments, of))
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
        """Return the result of `solve`."""
        with np.errstate(all="ignore"):
            if self.solve is not self.python and self.kept != self._referred():
                self.solve, self.taken, self.tried = self.python, 0, False
            if self.taken > WORTH_COMPILING and not self.tried:
                probe = p, initial, time[:3], (inputs[0][:3], inputs[1]), (np.empty(0), 0.0)
                self._compile(*probe, tolerances)
            solution: tuple[Array, Array, float] = self.solve(
                p, initial, time, inputs, steps, tolerances
            )
        self.taken += len(solution[1])
        return solution

    def _compile(self, *probe: Any) -> None:
        """Use compiled code, without checks of indices, if it agrees on a short simulation."""
        self.tried, self.kept = True, self._referred()
        expected = self.python(*probe)[0]
        try:
            compiled = partial(_compiled, compiled_rhs(self.rhs, self.arguments, self.of))
            states = compiled(*probe)[0]
        except Exception as error:  # code without support in Numba
            lines = [line for line in str(error).splitlines() if not line.startswith("Failed in")]
            reason = next(iter(lines), "") or type(error).__name__
        else:
            if np.allclose(states, expected, rtol=1e-6, equal_nan=True):
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

    def _referred(self) -> list[Any]:
        """Return the present values of the names in all functions."""
        return [referred(function) for function in (self.rhs, *self.of)]


@cache
def solver(rhs: Rhs, arguments: int, of: tuple[Rhs | None, ...] = ()) -> Solver:
    """Return the common solver of an equation."""
    return Solver(rhs, arguments, of)


def compiled_rhs(rhs: Rhs, arguments: int, of: Sequence[Rhs | None] = ()) -> Rhs:
    """Return `rhs(t, x, u, p)`, compiled when it is called; arguments as of `Solver`."""

    def compiled(function: Rhs) -> Rhs:
        made: Rhs = njit(**_OPTIONS)(getattr(function, "py_func", function))
        return made

    if arguments == 5:
        return with_terms(rhs, of, compiled)
    fast = compiled(rhs)
    return fast if arguments == 4 else compiled(_prefixed(fast, arguments))


def referred(function: Any) -> list[Any]:
    """Return the present values of the names in a function, constants in compiled code.

    Attributes of modules are included, the code of callable objects is not.
    """
    function = getattr(function, "py_func", function)
    if not isinstance(function, FunctionType):
        return []
    codes, names = [function.__code__], set[str]()
    for code in codes:  # grows by the inner functions of `code`
        names |= {*code.co_names}
        codes += [const for const in code.co_consts if isinstance(const, CodeType)]
    spaces, objects = [function.__globals__], list[Any]()
    for space in spaces:
        values = [space[name] for name in sorted(names & space.keys())]
        inner = [vars(value) for value in values if isinstance(value, ModuleType)]
        spaces += [new for new in inner if not any(new is other for other in spaces)]
        objects += [value for value in values if not isinstance(value, ModuleType)]
    cells = (cell.cell_contents for cell in function.__closure__ or ())
    return [_content(value) for value in [*objects, *cells]]


def _content(value: Any) -> Any:
    """Return a fingerprint of a value, which a change in place changes, too."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return repr(value)


def _prefixed(rhs: Rhs, arguments: int, of: Sequence[Rhs | None] = ()) -> Rhs:
    """Return `rhs(t, x, u, p)` for a function of 2 to 5 arguments, see `Solver`."""
    if arguments == 5:
        return with_terms(rhs, of)
    if arguments == 2:
        return lambda t, x, _u, _p: rhs(t, x)
    if arguments == 3:
        return lambda t, x, u, _p: rhs(t, x, u)
    return rhs
