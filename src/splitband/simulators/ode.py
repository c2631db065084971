"""Use an ordinary differential equation as a simulator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array
from splitband.simulators.digests import code_digest
from splitband.simulators.function import UserCode
from splitband.simulators.parameters import INITIAL, Given, Point, Response, parameters_class
from splitband.simulators.starting import Start, check_places, check_start, count_arguments

PRECISE = 1e-6, 1e-8
"""Largest relative and absolute tolerance for standard errors. With 1e-4 they came out up to 270
times too small."""
WORTH_COMPILING = 30_000
"""Steps after which the equation is compiled: they take about as long as compiling. By eye."""


@dataclass(frozen=True, eq=False, repr=False)
class Ode(UserCode):
    """Solve an ordinary differential equation, whose parameters may be fitted to a record.

    Attributes
    ----------
    rhs : `rhs(t, x, u, p) -> dx/dt`, or without the last or the last two arguments. x and u are
        arrays of the states and the inputs at time t in s, p holds the parameters by name (`p.k`).
        After many steps it is compiled with Numba, if possible.
    x0 : x at the record's first sample.
    observe : `observe(x)` or `observe(x, u, p)` maps the states `(time, nx)` to the measured
        channels, `(time,)` or `(time, ny)`; by default the first states, as many as the record has
        channels.
    parameters : By name a number, or a range `(low, high)` in which it is fitted; p holds them in
        this order. `x0_1`, `x0_2`, ... replace the elements of `x0`.
    held : Whether inputs are held until the next sample. By default they are interpolated.
    method : SciPy's name of the method. Only RK45 (Dormand-Prince) can be compiled.
    tolerances : Relative and absolute tolerance.
    key : Identifier of `rhs` and `observe` in the cache, as for `Function`.
    start : t at a record's first sample in s, or "record" for its time stamp.

    Examples
    --------
    >>> def cooling(t, x, u, p):
    ...     return [-p.rate * (x[0] - u[0])]
    >>> tank = sb.Ode(cooling, x0=[60.0], parameters={"rate": (0.01, 1.0)})
    >>> outside = np.full((200, 1), 20.0)
    >>> measured = 20 + 40 * np.exp(-0.1 * 0.5 * np.arange(200))
    >>> fitted = sb.identify(tank, sb.Record(measured, 0.5, u=outside))
    >>> round(fitted.values["rate"], 6)
    0.1
    """

    rhs: Callable[..., Any]
    x0: npt.ArrayLike
    observe: Callable[..., npt.ArrayLike] | None = None
    parameters: Given | None = None
    held: bool = False
    method: Literal["RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"] = "RK45"
    tolerances: tuple[float, float] = (1e-8, 1e-10)
    key: str | None = None
    start: Start = 0.0

    def __post_init__(self) -> None:
        """Check the initial values, and that every one among the parameters names a state."""
        check_start(self.start)
        check_places(self.rhs, "t", "x", "u", "p")
        check_places(self.observe, "x", "u", "p")
        try:
            x0 = np.atleast_1d(np.asarray(self.x0, float))
        except (TypeError, ValueError):
            x0 = np.empty((0, 0))
        if x0.ndim != 1 or not x0.size or not np.isfinite(x0).all():
            raise ValueError(
                f"x0 must be a finite number for each state, got {self.x0!r}; a state with a range "
                f'is a parameter: parameters={{"{INITIAL}1": (low, high)}}'
            )
        wrong = [name for name in self.known.given if name.startswith(INITIAL)
                 and name not in self._states]  # fmt: skip
        if wrong:
            raise ValueError(
                f"initial values must be out of {', '.join(self._states)}, as x0 says, "
                f"got {wrong[0]}"
            )

    @property
    def states(self) -> int:
        """Return the number of states."""
        return len(self._states)

    @property
    def difference(self) -> float:
        """Return the finite-difference step; it is smaller for RK45, which reuses its steps."""
        return 1e-6 if self.method == "RK45" else 1e-4

    @property
    def adjustable(self) -> bool:
        """Return whether it has parameters or needs inputs, and so a `GreyBox` to run it."""
        return bool(self.known.given) or self.driven

    @property
    def driven(self) -> bool:
        """Return whether it takes a record's inputs."""
        observes = self.observe is not None and count_arguments(self.observe) > 1
        return count_arguments(self.rhs) > 2 or observes

    @property
    def needs_inputs(self) -> bool:
        """Return whether it takes inputs for no other reason than parameters after them."""
        return count_arguments(self.rhs) == 3 or count_arguments(self.observe) == 2

    @property
    def code(self) -> list[Any]:
        """Return the user's functions."""
        return [self.rhs, self.observe]

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Self:
        """Return the equation with as many of its first states observed as there are channels.

        Raises ValueError for an equation of fewer states.
        """
        if self.observe is not None:
            return self
        if len(columns) > self.states:
            raise ValueError(
                f"observe must map the {self.states} state(s) of the equation to the record's "
                f"{len(columns)} channels, {', '.join(columns)}: by default the first states are "
                "observed"
            )
        # Kept, as it also holds compiled code.
        kept: dict[int, Self] = vars(self).setdefault("_matched", {})
        if len(columns) not in kept:
            made = self._with(observe=partial(_first_states, len(columns)))
            opened = vars(made).get("_opened_by")
            again: Any = None if opened is None else partial(_matched_again, opened, [*columns])
            kept[len(columns)] = made.opened_by(again)
        return kept[len(columns)]

    def precise(self) -> Self:
        """Return a copy with tolerances that also make its derivatives accurate.

        With few steps, a solution within its tolerance may still depend on a parameter far more
        strongly than the exact solution does, for example where a tank reaches its rim.
        """
        return self._with(tolerances=tuple(map(min, self.tolerances, PRECISE)))

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Solve at the times `time` in s, with the inputs `(time, nu)`.

        A parameter with a range takes the middle of it. Raises RuntimeError if SciPy's solver
        fails.
        """
        if self.driven:
            y, _ = self.respond(time, u, [(self.known.middle(), None)])[0]
            return y
        values, time = self.known.middle(), np.asarray(time, float)
        # It takes neither inputs nor parameters here.
        x = self._scipy(lambda t, x: self._plain(t, x, (), ()), time, self.initial(values))
        return self._observed(x, np.empty((len(time), 0)), values)

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """Return the responses at several points; RK45 takes the steps of the first one for all.

        Parameters
        ----------
        time, u : `(time,)` in s, and the inputs `(time, nu)`.
        points : Parameters and initial state; None is the state at the record's first sample.
        """
        steps = np.zeros(max(len(time) - 1, 0), dtype=np.int64)
        return [self._response(values, self.initial(values) if state is None else state,
                               time, u, steps) for values, state in points]  # fmt: skip

    @property
    def advances(self) -> bool:
        """Return whether successive calls of `advance` equal one long solution, up to rounding."""
        return self.method == "RK45"

    def advance(
        self, values: Mapping[str, float], state: Array, time: Array, u: Array | None, taken: int
    ) -> tuple[Array, Array, int]:
        """Return channels and states at `time`, and the solver steps of the last interval.

        Parameters
        ----------
        values : Values of the parameters.
        state : State at the first of at least two times, `(nx,)`.
        time, u : See `respond`.
        taken : Solver steps of the interval before; 0 if there is none.
        """
        steps = np.zeros(len(time) - 1, dtype=np.int64)
        steps[0] = -taken
        y, x = self._response(values, state, time, u, steps)
        return y, x, int(steps[-1])

    def _response(
        self,
        values: Mapping[str, float],
        state: npt.ArrayLike,
        time: Array,
        u: Array | None,
        steps: npt.NDArray[np.int64],
    ) -> Response:
        inputs = np.empty((len(time), 0)) if u is None else np.ascontiguousarray(u, dtype=float)
        x = self._solved(values, np.array(state, dtype=float), time, inputs, steps)
        return self._observed(x, inputs, values), x

    def fingerprint(self) -> str | None:
        """Return the cache key: the key, the parameters and the solver's settings."""
        if self.key is None:
            return None
        x0 = np.asarray(self.x0, float).tolist()
        return f"{self.key} {x0} {self.known} {self._precision}"

    def digest(self) -> str:
        """Return an identifier of code and settings, without the values of parameters."""
        code = self.key or code_digest(self.rhs, self.observe)
        x0 = np.atleast_1d(np.asarray(self.x0, float)).tolist()
        fixed = {n: x for n, x in zip(self._states, x0, strict=True) if n not in self.known.given}
        return f"{code} {fixed} {self._precision} {self.held}"

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields, without compiled code, for other processes."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @property
    def _precision(self) -> str:
        begins = f" from {self.start}" if self.start else ""
        return f"{self.method} {self.tolerances}{begins}"

    @cached_property
    def _states(self) -> list[str]:
        return [f"{INITIAL}{i + 1}" for i in range(len(np.atleast_1d(np.asarray(self.x0, float))))]

    @cached_property
    def _named(self) -> Any:
        names = [name for name in self.known.given if not name.startswith(INITIAL)]
        return parameters_class(tuple(names))

    def _p(self, values: Mapping[str, float]) -> Any:
        return self._named(*(float(values[name]) for name in self._named._fields))

    def initial(self, values: Mapping[str, float]) -> Array:
        """Return the state at the record's first sample."""
        x0 = np.atleast_1d(np.array(self.x0, dtype=float))
        return np.array([values.get(name, x) for name, x in zip(self._states, x0, strict=True)])

    def _plain(self, t: float, x: Array, u: Any, p: Any) -> Any:
        return self.rhs(*(t, x, u, p)[: count_arguments(self.rhs) or 2])

    def _faster(self, *probe: Any) -> Callable[..., Array]:
        """Return the compiled solver, or the plain one if Numba cannot compile the equation.

        Both must agree on a short simulation, `probe`: compiled code does not check, for instance,
        indices of the states.
        """
        p, initial, time, inputs, tolerances = probe
        usual, fast = (_solver(self.rhs, compiled) for compiled in (False, True))
        steps = np.zeros((2, len(time) - 1), dtype=np.int64)
        expected = usual(p, initial, time, inputs, (steps[0], *tolerances))
        try:
            found = fast(p, initial, time, inputs, (steps[1], *tolerances))
        except Exception:  # code that Numba does not support
            return usual
        return fast if np.allclose(found, expected, rtol=1e-6, equal_nan=True) else usual

    def _solved(
        self,
        values: Mapping[str, float],
        initial: Array,
        time: Array,
        u: Array,
        steps: npt.NDArray[np.int64],
    ) -> Array:
        p, time = self._p(values), np.ascontiguousarray(time, dtype=float)
        if self.method != "RK45":
            return self._scipy(lambda t, x: self._plain(t, x, self._between(t, time, u), p),
                               time, initial)  # fmt: skip
        kept = vars(self)
        solve = kept.get("_solve") or _solver(self.rhs, False)
        if "_solve" not in kept and kept.get("_taken", 0) > WORTH_COMPILING:
            inputs = u[:3], self.held
            solve = kept["_solve"] = self._faster(p, initial, time[:3], inputs, self.tolerances)
        solved: Array = solve(p, initial, time, (u, self.held), (steps, *self.tolerances))
        kept["_taken"] = kept.get("_taken", 0) + int(steps.sum())
        return solved

    def _between(self, t: float, time: Array, u: Array) -> Array:
        """Return the inputs at time `t`, held or interpolated."""
        place = np.clip((t - time[0]) / (time[1] - time[0]), 0, len(time) - 1)
        n = min(int(place), len(time) - 2)
        return u[n] if self.held else u[n] + (place - n) * (u[n + 1] - u[n])

    def _scipy(self, rhs: Callable[..., Any], time: Array, initial: Array) -> Array:
        rtol, atol = self.tolerances
        longest = float(time[1] - time[0]) if self.driven else np.inf
        # Its steps are lost in the rounding of large times: it counts from 0.
        begin, times = float(time[0]), time - time[0]
        solution = scipy.integrate.solve_ivp(
            lambda t, x: rhs(begin + t, x), (0.0, times[-1]), initial, method=self.method,
            t_eval=times, rtol=rtol, atol=atol, max_step=longest,
        )  # fmt: skip
        if not solution.success:
            at = begin + float(solution.t[-1]) if len(solution.t) else begin
            raise RuntimeError(f"the solver stopped at t = {at:g} s: {solution.message}")
        return np.asarray(solution.y.T)

    def _observed(self, x: Array, u: Array, values: Mapping[str, float]) -> Array:
        if self.observe is None:
            return x[:, :1]
        arguments = (x, u, self._p(values))
        y = np.asarray(self.observe(*arguments[: count_arguments(self.observe) or 1]), dtype=float)
        return y[:, None] if y.ndim == 1 else y


def _matched_again(opened: Callable[[Given], Ode], columns: list[str], given: Given) -> Ode:
    """Return an equation of a user's file, opened in another process, with its states observed."""
    return opened(given).matched(columns, ())


def _first_states(count: int, x: Array) -> Array:
    """Return the first states, `(time, count)`."""
    return x[:, :count]


def _solver(rhs: Callable[..., Any], compiled: bool) -> Callable[..., Array]:
    from splitband.kernels.ode import solver  # noqa: PLC0415  which loads numba

    return solver(rhs, count_arguments(rhs), compiled)
