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
from dis import get_instructions
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import njit, types
from numba.core import ir
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.untyped_passes import IRProcessing
from numba.extending import overload, register_jitable
from numba.np.unsafe.ndarray import to_fixed_tuple

from splitband.kernels.common import kernel
from splitband.kernels.terms import evaluate, gathered, put
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

Rhs = Callable[..., Any]

MOST_STEPS = 10_000
"""Most steps between two samples, rejected ones included. Bounds the time."""
STEP = 1e-6
"""Step of the differences of a right-hand side, as a share of a state or a range. Rounding."""
SHORTEST = 1e-12
"""Shortest step, as a share of the interval between two samples. Rounding."""
WORTH_SAYING = 30_000
"""Steps in Python after which it is said that an equation could not be compiled. By eye."""
_OPTIONS: Any = {"error_model": "numpy", "boundscheck": True}
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
_NO_TERMS = np.empty(0), np.empty(0), np.empty((0, 6), dtype=np.int64)


@register_jitable
def solve(  # noqa: PLR0912, PLR0915  one loop, for Numba
    rhs: Any,
    gather: Any,
    p: Array,
    terms: tuple[Array, Array, Any],
    initial: Array,
    time: Array,
    inputs: tuple[Array, bool],
    steps: tuple[Array, float],
    moves: tuple[bool, Array, Any],
    tolerances: tuple[float, float],
) -> tuple[Array, Array, float, Array]:
    """Return the states at the times `time`, the steps, the next step size, and derivatives.

    The states are `(time, nx)`, NaN from the first missed tolerance or non-finite state on. Steps
    are given by their ends, as shares of the interval between two samples. The derivatives,
    `(time, nx, n)`, are those by the wanted parameters, by the initial state, and by the weights of
    the terms, one after another; they go through the stages of each step exactly.

    Parameters
    ----------
    rhs, gather : `rhs(t, x, u, p, w, out)` and `gather(x, u, layout, z)`, which write dx/dt, and
        the quantities of unknown terms, to their last arguments.
    p : Parameters, `(np,)`.
    terms : Unknown terms, as `simulators.unknown.packed` returns them.
    initial : `(nx,)`, at the first time.
    time : `(time,)`, in s.
    inputs : `(time, nu)`, and whether to hold them between samples, else linear interpolation.
    steps : Steps to take, empty to choose them; and the size in s of the first trial step, 0 for
        the first interval.
    moves : Whether to differentiate; steps of the differences by the wanted parameters, and the
        places of these in `p`.
    tolerances : Relative and absolute tolerance of a step.
    """
    u, held = inputs
    schedule, size = steps
    rtol, atol = tolerances
    theta, scaling, layout = terms
    nx, nu, no = initial.shape[0], u.shape[1], layout[:, 2].sum()
    (wanted, by_parameter, places), weights = moves, len(theta)
    count = len(places)
    z, w, nothing = np.empty(layout[:, 0].sum()), np.empty(no), np.empty((0, 0))
    states = np.full((time.shape[0], nx), np.nan)
    ends, taken = np.empty(max(len(schedule), 2 * time.shape[0])), 0
    k, stage, now, p = np.empty((7, nx)), np.empty(nx), np.empty(nu), p.copy()
    x = initial.copy()
    states[0] = x
    # Of the right-hand side of each stage: by the state, by the parameters, and by w, and of w.
    by_x, by_p, by_w = np.empty((6, nx, nx)), np.empty((6, nx, count)), np.empty((6, nx, no))
    by_theta, by_z = np.empty((6, no, weights)), np.empty((no, len(z)))
    through, sizes = np.empty((6, nx, nx)), np.full(nx, atol / rtol)
    beside, moved = np.empty(len(z)), np.empty(nx)
    total = count + nx + weights if wanted else 0
    derivatives = np.full((time.shape[0] if wanted else 0, nx, total), np.nan)
    whole, before, dx = np.empty((nx, nx)), np.empty((nx, total)), np.zeros((nx, total))
    if wanted:
        for j in range(nx):
            dx[j, count + j] = 1.0
        derivatives[0] = dx
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
                return states, ends[:taken], size, derivatives
            h = (end - begin) * width
            for s in range(stages, 7):
                for j in range(nx):
                    stage[j] = x[j]
                    for r in range(s):
                        stage[j] += h * WEIGHTS[s, r] * k[r, j]
                if s == 6 and len(schedule) and end == 1.0:
                    break  # its slope is for the error and the next step
                share = begin + NODES[s] * (end - begin)
                t = time[n] + share * width
                for j in range(nu):
                    now[j] = u[n, j] if held else u[n, j] + share * (u[n + 1, j] - u[n, j])
                if no:
                    gather(stage, now, layout, z)
                    if wanted and s < 6:
                        evaluate(theta, scaling, layout, z, w, by_z, by_theta[s])
                    else:
                        evaluate(theta, scaling, layout, z, w, nothing, nothing)
                rhs(t, stage, now, p, w, k[s])
                if not wanted or s == 6:
                    continue
                for o in range(no):
                    kept, step = w[o], STEP * max(abs(w[o]), 1.0)
                    w[o] = kept + step
                    rhs(t, stage, now, p, w, moved)
                    w[o] = kept
                    for j in range(nx):
                        by_w[s, j, o] = (moved[j] - k[s, j]) / step
                for i in range(count):
                    kept, step = p[places[i]], by_parameter[i]
                    p[places[i]] = kept + step
                    rhs(t, stage, now, p, w, moved)
                    p[places[i]] = kept
                    for j in range(nx):
                        by_p[s, j, i] = (moved[j] - k[s, j]) / step
                for i in range(nx):
                    sizes[i] = max(sizes[i], abs(stage[i]), abs(h * k[s, i]))
                    kept, step = stage[i], STEP * sizes[i]
                    stage[i] = kept + step
                    rhs(t, stage, now, p, w, moved)
                    for j in range(nx):
                        by_x[s, j, i] = (moved[j] - k[s, j]) / step
                    if no:
                        gather(stage, now, layout, beside)
                        for q in range(len(z)):
                            along = (beside[q] - z[q]) / step
                            if along != 0.0:
                                for j in range(nx):
                                    for o in range(no):
                                        by_x[s, j, i] += by_w[s, j, o] * by_z[o, q] * along
                    stage[i] = kept
            stages = 1
            if not len(schedule):
                error = 0.0
                for j in range(nx):  # the last stage is the new state
                    difference = 0.0
                    for r in range(7):
                        difference += h * _ERRORS[r] * k[r, j]
                    error += (difference / (atol + rtol * max(abs(x[j]), abs(stage[j])))) ** 2
                error = np.sqrt(error / nx)
                factor = 0.2 if np.isnan(error) else min(max(0.9 * error**-0.2, 0.2), 10.0)
                # A step to the next sample may be shorter than the tolerances allow.
                size = max(size, h * factor) if error <= 1.0 and end == 1.0 else h * factor
                if not error <= 1.0:
                    continue
            if taken == len(ends):
                ends = np.concatenate((ends, np.empty(len(ends))))
            ends[taken] = end
            taken += 1
            begin = end
            x[:] = stage
            k[0] = k[6]
            if wanted:
                stages = 0
                carry(h, through, whole, by_x, by_p, by_w, by_theta, before, dx)
        if not np.isfinite(x).all():
            break
        states[n + 1] = x
        if wanted:
            derivatives[n + 1] = dx
    return states, ends[:taken], size, derivatives


@register_jitable(forceinline=True)
def carry(  # noqa: PLR0912  for Numba
    h: float,
    through: Array,
    whole: Array,
    by_x: Array,
    by_p: Array,
    by_w: Array,
    by_theta: Array,
    before: Array,
    after: Array,
) -> None:
    """Carry the derivatives of a state over a step of size `h`.

    `through` is what the slopes of the stages do to the new state, which is followed from the last
    stage back to the first one: so the weights are met once a step, not in all combinations of
    stages.
    """
    nx, count, no = by_p.shape[1], by_p.shape[2], by_w.shape[2]
    first, total = count + nx, after.shape[1]
    for j in range(nx):
        for i in range(nx):
            whole[j, i] = 1.0 if i == j else 0.0
        for d in range(total):
            before[j, d] = after[j, d]
            after[j, d] = 0.0
    for s in range(5, -1, -1):
        for j in range(nx):
            for i in range(nx):
                slope = WEIGHTS[6, s] if i == j else 0.0
                for r in range(s + 1, 6):
                    for m in range(nx):
                        slope += WEIGHTS[r, s] * through[r, j, m] * by_x[r, m, i]
                through[s, j, i] = h * slope
            for m in range(nx):
                for i in range(nx):
                    whole[j, i] += through[s, j, m] * by_x[s, m, i]
                for i in range(count):
                    after[j, i] += through[s, j, m] * by_p[s, m, i]
            for o in range(no):
                slope = 0.0
                for m in range(nx):
                    slope += through[s, j, m] * by_w[s, m, o]
                for d in range(total - first):
                    after[j, first + d] += slope * by_theta[s, o, d]
    for j in range(nx):
        for i in range(nx):
            for d in range(total):
                after[j, d] += whole[j, i] * before[i, d]


@overload(np.clip, strict=False)
def _clip(a: Any, a_min: Any, a_max: Any) -> Any:
    """Return `np.clip` of a number, such as a hard saturation: Numba clips arrays only."""
    numbers = all(isinstance(argument, types.Number) for argument in (a, a_min, a_max))
    return (lambda a, a_min, a_max: np.minimum(np.maximum(a, a_min), a_max)) if numbers else None


_T: Any = types
_ROW, _ROWS, _CUBE, _PLACES = _T.f8[::1], _T.f8[:, ::1], _T.f8[:, :, ::1], _T.i8[::1]
_LAYOUT = _T.i8[:, ::1]
_RHS = _T.void(_T.f8, _ROW, _ROW, _ROW, _ROW, _ROW)
_GATHER = _T.i8(_ROW, _ROW, _LAYOUT, _ROW)
_EQUATION = (
    _T.FunctionType(_RHS),
    _T.FunctionType(_GATHER),
    _ROW,
    _T.Tuple((_ROW, _ROW, _LAYOUT)),
    _ROW,
    _ROW,
    _T.Tuple((_ROWS, _T.boolean)),
)
"""Types of the arguments that the kernels share. Functions are passed as pointers,
so that the kernels are compiled once for all equations."""
_MOVES = _T.Tuple((_T.boolean, _ROW, _PLACES))
_SOLVE = _T.Tuple((_ROWS, _ROW, _T.f8, _CUBE))(
    *_EQUATION, _T.Tuple((_ROW, _T.f8)), _MOVES, _T.UniTuple(_T.f8, 2)
)
_UNMOVED: Any = False, np.empty(0), np.empty(0, dtype=np.int64)


@cache
def compiled() -> Any:
    """Return `solve` for any equation, compiled, from the disk if it is there."""
    made: Any = kernel(solve, fastmath=False)
    made.compile(_SOLVE)
    made.disable_compile()
    return made


class Solver:
    """The solver of an equation, compiled with Numba if possible.

    From the first call on: compiled code rounds otherwise, so a result would depend on what else
    its process had solved before.

    Parameters
    ----------
    rhs : A function of the first `arguments` of (t, x, u, p, w).
    arguments : The number of arguments of `rhs`, 2 to 5.
    of : The functions of the quantities of unknown terms.
    """

    def __init__(self, rhs: Rhs, arguments: int, of: Sequence[Rhs | None] = ()) -> None:
        self.rhs, self.arguments, self.of = rhs, arguments, of
        self.compiled: dict[Any, Any] = {}
        self.taken, self.tried, self.reason = 0, False, ""
        self.kept: list[Any] = []

    def __call__(
        self,
        p: Any,
        initial: Array,
        time: Array,
        inputs: tuple[Array, bool],
        steps: tuple[Array, float],
        tolerances: tuple[float, float],
        moves: Any = _UNMOVED,
    ) -> tuple[Array, Array, float, Array]:
        """Return the result of `solve`; `p` are named parameters, or these and unknown terms."""
        # Arrays of a record cannot be written to, which is another type for Numba.
        time, u = (np.require(each, float, ("C", "W")) for each in (time, inputs[0]))
        given: Any = initial, time, (u, inputs[1]), steps, moves, tolerances
        named, terms = p if self.arguments == 5 else (p, _NO_TERMS)
        p, kind = np.array(named, dtype=float), type(named)
        with np.errstate(all="ignore"):
            if self.tried and self.kept != self._referred():
                self.compiled, self.tried = {}, False
            if not self.tried:
                self._compile(kind, p, terms, given)
            if (fast := self.compiled.get(kind)) is None and self.compiled:
                fast = self.compiled[kind] = self._functions(kind, len(p), fast=True)
            function: Any = solve if fast is None else compiled()
            solution: tuple[Array, Array, float, Array] = function(
                *(fast or self._functions(kind, len(p))), p, terms, *given
            )
        if self.reason:
            self._count(len(solution[1]) * (5 if moves[0] else 1))
        return solution

    def derivatives(
        self,
        p: Any,
        initial: Array,
        time: Array,
        inputs: tuple[Array, bool],
        widths: tuple[Array, Any],
        tolerances: tuple[float, float],
    ) -> tuple[Array, Array, Array, Array]:
        """Return the states of `solve`, their derivatives, and a run beside them.

        The run beside them, by the same steps, has parameters, initial state and weights that are
        moved by `steps`; it is returned less the states. An equation that jumps has other
        derivatives than its right-hand side, and this run tells.

        Parameters
        ----------
        p, initial, time, inputs, tolerances : As for a call.
        widths : Ranges of the wanted parameters, with the sign of steps within them, and the
            places of these parameters in `p`.
        """
        moves = True, STEP * widths[0], widths[1]
        x, ends, _, dx = self(p, initial, time, inputs, (np.empty(0), 0.0), tolerances, moves)
        sizes = np.nanmax(np.abs(x), axis=0)
        sizes = np.where(sizes > 0.0, sizes, 1.0)
        count, states = len(widths[1]), len(widths[1]) + len(initial)
        most = np.nanmax(np.abs(dx), axis=0)
        most = np.maximum((most / sizes[:, None]).max(axis=0), 1e-300)
        steps = STEP / most * np.where(np.arange(len(most)) % 2, 1.0, -1.0)
        steps[:count] = np.sign(widths[0]) * np.minimum(np.abs(steps[:count]), np.abs(moves[1]))
        steps[states:] = np.clip(steps[states:], -STEP, STEP)
        named, terms = p if self.arguments == 5 else (p, _NO_TERMS)
        values = np.array(named, dtype=float)
        values[widths[1]] += steps[:count]
        beside = type(named)(*values) if count else named
        if self.arguments == 5:
            beside = beside, (terms[0] + steps[states:], *terms[1:])
        begin = initial + steps[count:states]
        apart, *_ = self(beside, begin, time, inputs, (ends, 0.0), tolerances)
        return x, dx, steps, apart - x

    def _functions(self, kind: Any, count: int, fast: bool = False) -> tuple[Any, Any]:
        """Return `rhs` and `gather` of the kernels for a class of named parameters."""
        if not fast:
            checked = _checked(_with_five(self.rhs, self.arguments))
            return _flat(checked, kind, count, _numbers), gathered(self.of)
        made: Any = njit(pipeline_class=_WithTuples, **_OPTIONS)
        rhs = made(getattr(self.rhs, "py_func", self.rhs))
        named = rhs if self.arguments == 5 else made(_with_five(rhs, self.arguments))
        flat = _flat(named, kind, count, to_fixed_tuple)
        return njit(_RHS, **_OPTIONS)(flat), _pointer(gathered(self.of, made))

    def _compile(self, kind: Any, p: Array, terms: Any, given: Any) -> None:
        """Use compiled code if it agrees on a short simulation."""
        initial, time, (u, held), *_, tolerances = given
        few = time[:3], (u[:3], held), (np.empty(0), 0.0), _UNMOVED
        probe: Any = (p, terms, initial, *few, tolerances)
        expected = solve(*self._functions(kind, len(p)), *probe)[0]
        self.tried, self.kept, self.reason = True, self._referred(), ""
        try:
            fast = self._functions(kind, len(p), fast=True)
            states = compiled()(*fast, *probe)[0]
        except Exception as error:  # code without support in Numba
            lines = [line for line in str(error).splitlines() if not line.startswith("Failed in")]
            self.reason = next(iter(lines), "") or type(error).__name__
        else:
            if np.allclose(states, expected, rtol=1e-6, equal_nan=True):
                self.compiled[kind] = fast
            else:
                self.reason = "compiled, it gives other numbers"

    def _count(self, steps: int) -> None:
        """Count steps that are taken in Python, and say so once they are many."""
        few, self.taken = self.taken <= WORTH_SAYING, self.taken + steps
        if few and self.taken > WORTH_SAYING:
            name = getattr(self.rhs, "__name__", type(self.rhs).__name__)
            warnings.warn(
                f"the equation {name} is solved in Python, many times slower than compiled: Numba "
                f"cannot compile it ({self.reason.strip(' .:')}); write it with numbers, p.k in "
                'place of p["k"], and other functions of NumPy or math',
                stacklevel=3,
            )

    def _referred(self) -> list[Any]:
        """Return the present values of the names in all functions."""
        return [referred(function) for function in (self.rhs, *self.of)]


@cache
def solver(rhs: Rhs, arguments: int, of: tuple[Rhs | None, ...] = (), outputs: int = 0) -> Solver:
    """Return the common solver of an equation whose terms have so many outputs.

    Each number of outputs has its own, as a solver tries an equation in Python but once.
    """
    return Solver(rhs, arguments, of)


def _flat(rhs: Rhs, kind: Any, count: int, numbers: Any) -> Rhs:
    """Return `rhs(t, x, u, p, w, out)` with an array of parameters, from one with named ones."""
    if not count:

        def without(t: float, x: Array, u: Array, p: Array, w: Array, out: Array) -> None:
            slope = rhs(t, x, u, (), w)
            if len(slope) != len(out):
                raise InputError("rhs must return a number for each state")
            put(slope, out, 0)

        return without

    def flat(t: float, x: Array, u: Array, p: Array, w: Array, out: Array) -> None:
        slope = rhs(t, x, u, kind(*numbers(p, count)), w)
        if len(slope) != len(out):
            raise InputError("rhs must return a number for each state")
        put(slope, out, 0)

    return flat


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call, unused-ignore]
class _ListsAsTuples(FunctionPass):
    """Return literal lists as tuples, which need no memory; in Numba's own form of a function."""

    _name = "lists_as_tuples"

    def __init__(self) -> None:  # abstract in the base class
        super().__init__()  # type: ignore[no-untyped-call, unused-ignore]

    def run_pass(self, state: Any) -> bool:
        """Return whether the function has changed."""
        changed = False
        for block in state.func_ir.blocks.values():
            made: dict[Any, Any] = {e.target.name: e.value for e in block.find_insts(ir.Assign)}
            end: Any = made.get(getattr(getattr(block.terminator, "value", None), "name", None))
            value: Any = made.get(end.value.name) if getattr(end, "op", "") == "cast" else None
            if getattr(value, "op", "") == "build_list" and end.value.is_temp:
                value.op = "build_tuple"
                changed = True
        return changed


class _WithTuples(CompilerBase):
    """Numba's compiler, for functions of a user that return a list."""

    def define_pipelines(self) -> list[Any]:
        """Return the passes."""
        builder: Any = DefaultPassBuilder
        passes = builder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_ListsAsTuples, IRProcessing)
        passes.finalize()
        return [passes]


def _checked(rhs: Rhs) -> Rhs:
    """Return a function that raises ValueError unless `rhs` returns numbers."""

    def checked(*arguments: Any) -> list[float]:
        values = rhs(*arguments)
        try:
            return [float(value) for value in values]
        except (TypeError, ValueError) as error:
            message = f"rhs must return a number for each state, got {values!r:.60}"
            raise InputError(message) from error

    return checked


def _numbers(p: Array, _count: int) -> list[float]:
    return p.tolist()


def _pointer(gather: Any) -> Any:
    """Return a compiled `gather` with the signature of the kernels."""
    return njit(_GATHER, **_OPTIONS)(gather.py_func)


def _with_five(rhs: Rhs, arguments: int) -> Rhs:
    """Return `rhs(t, x, u, p, w)` for a function of the first 2 to 5 of these arguments."""
    if arguments == 2:
        return lambda t, x, _u, _p, _w: rhs(t, x)
    if arguments == 3:
        return lambda t, x, u, _p, _w: rhs(t, x, u)
    if arguments == 4:
        return lambda t, x, u, p, _w: rhs(t, x, u, p)
    return rhs


def referred(function: Any) -> list[Any]:
    """Return the present values of the names in a function, constants in compiled code.

    Attributes of modules are included, the code of callable objects is not.
    """
    function = getattr(function, "py_func", function)
    if not isinstance(function, FunctionType):
        return []
    codes, names, own = [function.__code__], set[str](), set[str]()
    for code in codes:  # grows by the inner functions of `code`
        names |= {*code.co_names}
        # `names` has attributes, too: a global `k` is none of `p.k`.
        own |= _globals_in(code)
        codes += [const for const in code.co_consts if isinstance(const, CodeType)]
    spaces, objects = [function.__globals__], list[Any]()
    for space in spaces:
        wanted = own if space is function.__globals__ else names
        values = [space[name] for name in sorted(wanted & space.keys())]
        inner = [vars(value) for value in values if isinstance(value, ModuleType)]
        spaces += [new for new in inner if not any(new is other for other in spaces)]
        objects += [value for value in values if not isinstance(value, ModuleType)]
    cells = (cell.cell_contents for cell in function.__closure__ or ())
    return [_content(value) for value in [*objects, *cells]]


@cache
def _globals_in(code: CodeType) -> frozenset[str]:
    """Return the global names that a code reads."""
    found = (each.argval for each in get_instructions(code) if each.opname == "LOAD_GLOBAL")
    return frozenset(found)


def _content(value: Any) -> Any:
    """Return a fingerprint of a value, which a change in place changes, too."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
        return repr(value)
