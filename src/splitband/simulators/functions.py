"""Use Python functions as simulators: of time, or the right-hand side of an ODE."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from inspect import Signature
from typing import Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.base import Hold, Start, check_hold, check_start
from splitband.simulators.parameters import (
    INITIAL,
    Adjustable,
    Given,
    Point,
    Response,
    parameters_class,
)
from splitband.simulators.unknown import Trained, Unknown, packed
from splitband.simulators.user_code import arguments, check_arguments, count_arguments

JUMPS = 0.1
"""Relative error of derivatives that do not go through the steps of an equation, as it jumps. By
eye."""
COARSE = 1e-5
"""Least relative tolerance in a search. Bounds the time."""
PRECISE = 1e-6, 1e-8
"""Largest relative and absolute tolerance for standard errors: with 1e-4 errors were up to 270
times too small."""


class UserCode(Adjustable):
    """The base of dataclasses with user code.

    Functions from a user's file cannot be pickled: other processes open the simulator once more, by
    a function of the parameters that `opened_by` sets, and change it as it was changed here.
    """

    survives = True  # apart from crashes of compiled code
    _opened: tuple[Callable[[Given], Any], Any] | None = None
    _set_apart: ClassVar[tuple[str, ...]] = ()
    """Prefixes of parameters that are no arguments of the functions."""

    @property
    @abstractmethod
    def _functions(self) -> Sequence[tuple[Any, Sequence[str]]]:
        """Return pairs of a user's function, or None, and the names of its arguments."""

    @property
    def code(self) -> list[Any]:  # type: ignore[override]
        """Return the user's functions."""
        return [function for function, _ in self._functions]

    @property
    def driven(self) -> bool:  # type: ignore[override]
        """Return whether a function takes a record's inputs."""
        return any(count_arguments(f) > names.index("u") for f, names in self._functions)

    @property
    def needs_inputs(self) -> bool:
        """Return whether a function takes inputs, but no parameters after them."""
        return any(count_arguments(f) == names.index("p") for f, names in self._functions)

    def _check(self) -> None:
        """Raise ValueError for a wrong start, arguments in another order, unused parameters."""
        check_start(self.start)
        for function, names in self._functions:
            check_arguments(function, *names)
        unused = [name for name in self.known.given if not name.startswith(self._set_apart)]
        taken = [count_arguments(f) > names.index("p") for f, names in self._functions]
        if unused and not any(taken):
            function, names = self._functions[0]
            name = getattr(function, "__name__", "") or type(function).__name__
            bare = [p.replace(annotation=p.empty) for p in arguments(function).values()]
            raise InputError(
                "parameters must be used by the function, or be left out: "
                f"{name}{Signature(bare)} must be {name}({', '.join(names)}), with "
                f"p.{unused[0]} in it"
            )

    def _with(self, **changes: Any) -> Self:
        """Return a copy with changed fields, recreated in other processes with them."""
        made = replace(self, **changes)  # type: ignore[type-var]
        vars(made)["_opened"] = self._opened
        return made

    def opened_by(self, function: Callable[[Given], UserCode]) -> Self:
        """Set the function of the parameters for other processes; return the simulator."""
        vars(self)["_opened"] = function, self
        return self

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Return the reduction for other processes: what has changed since it was opened."""
        if self._opened is None:
            return super().__reduce_ex__(protocol)
        function, first = self._opened
        terms = [_changes(*pair) for pair in zip(self.terms, first.terms, strict=True)]
        parameters = dict(self.parameters or {})
        return _reopened, (function, parameters, _changes(self, first), terms)


@dataclass(frozen=True, eq=False, repr=False)
class Function(UserCode):
    """A Python function of time, possibly with parameters to fit to a record.

    Attributes
    ----------
    function : `function(time, u, p) -> (time,) or (time, ny)`, or without the last or the last two
        arguments: times in s `(time,)`, inputs `(time, nu)`, and parameters by name (`p.k`).
    parameters : By name a number, or a range `(low, high)` to fit; p has them in this order.
        Parameters with names in `x0_` are fitted by record.
    start : Time of a record's first sample in s, by default 0, or "record" for its time stamp. A
        function of time alone needs it if the record's clock does not begin at 0.
    """

    function: Callable[..., npt.ArrayLike]
    parameters: Given | None = None
    start: Start | None = None

    def __post_init__(self) -> None:
        """Check the start and the order of the arguments."""
        self._check()

    @property
    def _functions(self) -> Sequence[tuple[Any, Sequence[str]]]:
        return [(self.function, ("time", "u", "p"))]

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s, with the inputs `(time, nu)`.

        A parameter with a range takes the middle.
        """
        return self._called(time, u, self.known.middle())

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """Return the responses, without states, see `Adjustable`."""
        responses = []
        for values, _ in points:
            y = _channels(self._called(time, u, values))
            responses.append((y, np.empty((len(time), 0))))
        return responses

    def _called(self, time: Array, u: Array | None, values: Mapping[str, float]) -> npt.ArrayLike:
        u = np.empty((len(time), 0)) if u is None else u
        p = parameters_class(tuple(self.known.given))(*(values[n] for n in self.known.given))
        return self.function(*(time, u, p)[: count_arguments(self.function) or 1])


@dataclass(frozen=True, eq=False, repr=False)
class Ode(UserCode):
    """An ordinary differential equation, possibly with parameters to fit to a record.

    Attributes
    ----------
    rhs : `rhs(t, x, u, p) -> dx/dt`, or without the last or the last two arguments. x and u are
        arrays of the states and the inputs at time t in s, p has the parameters by name (`p.k`).
        With unknown terms it is `rhs(t, x, u, p, w)`. After many steps the equation is compiled
        with Numba, if possible.
    x0 : x at the record's first sample.
    observe : `observe(x)` or `observe(x, u, p)` maps the states `(time, nx)` to the measured
        channels, `(time,)` or `(time, ny)`; by default the channels are the first states.
    parameters : By name a number, or a range `(low, high)` to fit; p has them in this order.
        `x0_1`, `x0_2`, ... replace the elements of `x0`.
    hold : "zoh" holds inputs until the next sample (zero-order hold), as a D/A converter does;
        "linear" interpolates.
    method : "RK45", the method of Dormand and Prince, compiled if possible; or another one of
        `scipy.integrate.solve_ivp`, such as "Radau" and "BDF" for stiff equations.
    tolerances : Relative and absolute tolerance of a step.
    start : t at a record's first sample in s, or "record" for its time stamp.
    unknown : Unknown terms, one or several, which are trained with the parameters; w has the
        outputs of all of them, in their order.

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

    _set_apart = (INITIAL,)
    difference = 1e-4  # of a whole response
    rhs: Callable[..., Any]
    x0: npt.ArrayLike
    observe: Callable[..., npt.ArrayLike] | None = None
    parameters: Given | None = None
    hold: Hold = "linear"
    method: Literal["RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"] = "RK45"
    tolerances: tuple[float, float] = (1e-8, 1e-10)
    start: Start = 0.0
    unknown: Unknown | Sequence[Unknown] | None = None

    def __post_init__(self) -> None:
        """Check the initial values, and those among the parameters."""
        if not all(isinstance(term, Unknown) for term in self.terms):
            raise InputError(
                f"unknown must be an Unknown or several, sb.Unknown(...), got {self.unknown!r}"
            )
        if (count_arguments(self.rhs) == 5) != bool(self.terms):
            raise InputError(
                "rhs must take the outputs w of unknown terms as its fifth argument, rhs(t, x, u, "
                "p, w), if there are any, and only then: write it so, without a default, or leave "
                "unknown out"
                if self.terms
                else "unknown must say of what the fifth argument of rhs(t, x, u, p, w) is the "
                "output, such as sb.Unknown(of), or that argument be left out"
            )
        self._check()
        check_hold(self.hold)
        try:
            x0 = np.atleast_1d(np.asarray(self.x0, float))
        except (TypeError, ValueError):
            x0 = np.empty((0, 0))
        if x0.ndim != 1 or not x0.size or not np.isfinite(x0).all():
            raise InputError(
                f"x0 must be a finite number for each state, got {self.x0!r}; a state with a range "
                f'is a parameter: parameters={{"{INITIAL}1": (low, high)}}'
            )
        initial = [name for name in self.known.given if name.startswith(INITIAL)]
        if wrong := [name for name in initial if name not in self._states]:
            raise InputError(
                f"initial values must be out of {', '.join(self._states)}, as x0 says, "
                f"got {wrong[0]}"
            )

    @property
    def states(self) -> int:  # type: ignore[override]
        """Return the number of states."""
        return len(self._states)

    def unfinished(self, time: float) -> str:
        """Return the message for states that are NaN from `time` in s on."""
        return (
            f"the solver, {self.method}, stopped before t = {time:g} s, where it cannot reach its "
            'tolerances: for a stiff equation there are method="Radau" and '
            '"BDF", for one that jumps to and fro larger tolerances'
        )

    @property
    def _functions(self) -> Sequence[tuple[Any, Sequence[str]]]:
        last = ("w",) if self.terms else ()
        return [(self.rhs, ("t", "x", "u", "p", *last)), (self.observe, ("x", "u", "p"))]

    @property
    def terms(self) -> tuple[Unknown, ...]:  # type: ignore[override]
        """Return the unknown terms; named quantities are found by `matched`."""
        given = () if self.unknown is None else self.unknown
        return (given,) if isinstance(given, Unknown) else tuple(given)

    @property
    def resolved_terms(self) -> tuple[Unknown, ...]:
        """Return the unknown terms, without a record's names for the quantities."""
        return tuple(term.resolved(self.states, (), ()) for term in self.terms)

    @property
    def named_terms(self) -> tuple[Unknown, ...]:
        """Return the unknown terms, before training, if their quantities have names."""
        terms = tuple(replace(term, trained=None) for term in self.terms)
        return () if any(callable(term.of) for term in terms) else terms

    def without_terms(self) -> Self:
        """Return a copy with unknown terms that stay as before training."""
        terms = tuple(term.without() for term in self.terms)
        return self._with(unknown=terms) if terms else self

    def taught(self, trained: Sequence[Trained]) -> Self:
        """Return a copy whose terms have these states, in their order; itself for none.

        Raises ValueError for another number of terms.
        """
        if not trained:
            return self
        if len(trained) != len(self.terms):
            raise InputError(
                f"unknown must have {len(trained)} term(s), as in training, got {len(self.terms)}"
            )
        pairs = zip(self.terms, trained, strict=True)
        terms = tuple(replace(term, trained=state) for term, state in pairs)
        return self._with(unknown=terms)

    @property
    def weights(self) -> Array:
        """Return the weights of the unknown terms, one after another."""
        return packed(self.resolved_terms)[0]

    def weighted(self, weights: Array) -> Self:
        """Return a copy with these weights of the unknown terms."""
        if not len(weights):
            return self
        terms, begin = [], 0
        for term in self.terms:
            state = term.trained
            if state is not None:
                end = begin + len(state.weights)
                state, begin = replace(state, weights=weights[begin:end]), end
            terms.append(replace(term, trained=state))
        return self._with(unknown=tuple(terms))

    def outputs(self, x: Any, u: Any) -> Any:
        """Return w, `(outputs,)`, for states `(nx,)` and inputs `(nu,)`, in traceable code."""
        return np.concatenate([term.at(x, u) for term in self.resolved_terms])

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Self:
        """Return the equation for a record: quantities of unknown terms may be named by it.

        By default the first states are observed, one per channel.

        Raises ValueError for an equation of fewer states, and for names that are not there.
        """
        if self.observe is None and len(columns) > self.states:
            raise InputError(
                f"observe must map the {self.states} state(s) of the equation to the record's "
                f"{len(columns)} channels, {', '.join(columns)}: by default the first states are "
                "observed"
            )
        changes: dict[str, Any] = {}
        if self.observe is None:
            changes["observe"] = partial(_first_states, len(columns))
        if self.terms:
            named = () if self.observe else columns
            resolved = (term.resolved(self.states, named, inputs) for term in self.terms)
            changes["unknown"] = tuple(resolved)
        return self._with(**changes) if changes else self

    def coarse(self) -> Self:
        """Return a copy with fewer steps; derivatives along them are exact at any tolerance."""
        return self._with(tolerances=(max(self.tolerances[0], COARSE), self.tolerances[1]))

    def precise(self) -> Self:
        """Return a copy with tolerances for accurate derivatives.

        With few steps, a solution within its tolerance may still depend on a parameter far more
        strongly than the exact solution does, for example when a tank reaches its rim.
        """
        return self._with(tolerances=tuple(map(min, self.tolerances, PRECISE)))

    def otherwise(self) -> Any:
        """Return a copy with the other `hold`; None without inputs."""
        other: Hold = "linear" if self.hold == "zoh" else "zoh"
        return self._with(hold=other) if self.driven else None

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Solve at the times `time` in s, with the inputs `(time, nu)`.

        A parameter with a range takes the middle. Raises RuntimeError for an unsolvable equation,
        and ValueError for one with unknown terms that are not trained.
        """
        if any(term.free for term in self.terms):
            raise InputError(
                "unknown terms must be trained before a simulation, as sb.GreyBox(ode).fit(record) "
                "does (--method grey-box), or be left out, ode.without_terms()"
            )
        (y, x), *_ = self.respond(time, u, [(self.known.middle(), None)])
        if not np.isfinite(x).all():
            bad = int(np.argmin(np.isfinite(x).all(axis=1)))
            raise RuntimeError(self.unfinished(float(time[bad])))
        return y

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """Return the responses at several points; RK45 repeats the steps of the first one.

        Parameters
        ----------
        time, u : `(time,)` in s, and the inputs `(time, nu)`.
        points : Parameters and initial state; None for the state at the record's first sample.
        """
        steps, responses = np.empty(0), []
        for values, state in points:
            y, x, steps, _ = self._response(values, state, time, u, (steps, 0.0))
            responses.append((y, x))
        return responses

    @property
    def advances(self) -> bool:  # type: ignore[override]
        """Return whether successive calls of `advance` equal one long solution, up to rounding."""
        return self.method == "RK45"

    def advance(
        self, values: Mapping[str, float], state: Array, time: Array, u: Array | None, size: float
    ) -> tuple[Array, Array, float]:
        """Return channels and states at `time`, and `size` for the next call.

        Parameters
        ----------
        values : Values of the parameters.
        state : State at the first time, `(nx,)`.
        time, u : See `respond`.
        size : First step size in s; 0 at the beginning.
        """
        y, x, _, size = self._response(values, state, time, u, (np.empty(0), size))
        return y, x, size

    def stepped(
        self, values: Mapping[str, float], state: Any, time: Array, u: Array | None, count: int
    ) -> tuple[Array, Array]:
        """Return channels and states by `count` equal steps from one time to the next.

        Arguments as of `advance`; the method must be RK45.
        """
        ends = np.tile(np.arange(1.0, count + 1) / count, len(time) - 1)
        y, x, *_ = self._response(values, state, time, u, (ends, 0.0))
        return y, x

    def _response(
        self,
        values: Mapping[str, float],
        state: npt.ArrayLike | None,
        time: Array,
        u: Array | None,
        steps: tuple[Array, float],
    ) -> tuple[Array, Array, Array, float]:
        """Return channels, states, the solver's steps, and the size of the next step."""
        time = np.ascontiguousarray(time, dtype=float)
        u = np.empty((len(time), 0)) if u is None else np.ascontiguousarray(u, dtype=float)
        begin = np.array(self.initial(values) if state is None else state, dtype=float)
        if self.method == "RK45":
            (solve, p), inputs = self._solver(values), (u, self.hold == "zoh")
            x, taken, size, _ = solve(p, begin, time, inputs, steps, self.tolerances)
        else:
            x, taken, size = self._scipy(values, begin, time, u), np.empty(0), 0.0
        return self._observed(x, u, values), x, taken, size

    def derivatives(
        self, time: Array, u: Array | None, point: Point, names: Sequence[str]
    ) -> tuple[Array, Array, Array, Array]:
        """Return channels and states at a point, and their derivatives, see `Adjustable`.

        Those of RK45 go through its steps; the channels are differentiated along them.
        """
        if self.method != "RK45":
            return super().derivatives(time, u, point, names)
        values, state = point
        time = np.ascontiguousarray(time, dtype=float)
        inputs = np.empty((len(time), 0)) if u is None else np.ascontiguousarray(u, dtype=float)
        solve, p = self._solver(values)
        widths = np.array([self.known.step(name, values[name], 1.0) for name in names])
        fields = self.p(values)._fields
        places = np.array([fields.index(name) for name in names], dtype=np.int64)
        begin, held = np.array(state, dtype=float), (inputs, self.hold == "zoh")
        x, dx, steps, apart = solve.derivatives(
            p, begin, time, held, (widths, places), self.tolerances
        )
        left = apart - dx @ steps
        if not (np.linalg.norm(left, axis=0) <= JUMPS * np.linalg.norm(apart, axis=0)).all():
            return super().derivatives(time, u, point, names)
        y = self._observed(x, inputs, values)
        if isinstance(self.observe, partial) and self.observe.func is _first_states:
            return y, x, dx[:, : y.shape[1]], dx
        dy = np.empty((*y.shape, dx.shape[-1]))
        for i, step in enumerate(steps):
            at = {**values, names[i]: values[names[i]] + step} if i < len(names) else values
            dy[..., i] = (self._observed(x + step * dx[..., i], inputs, at) - y) / step
        return y, x, dy, dx

    def _solver(self, values: Mapping[str, float]) -> tuple[Any, Any]:
        """Return the solver of RK45, and its argument for parameters and unknown terms."""
        from splitband.kernels.ode import solver  # noqa: PLC0415  numba is slow to load

        terms, p = self.resolved_terms, self.p(values)
        of = tuple(term.of for term in terms)
        arguments = count_arguments(self.rhs) or 2
        outputs = sum(term.outputs for term in terms)
        return solver(self.rhs, arguments, of, outputs), (p, packed(terms)) if of else p

    @property
    def _states(self) -> list[str]:
        return [f"{INITIAL}{i + 1}" for i in range(np.size(self.x0))]

    @property
    def _fixed(self) -> dict[str, float]:
        x0 = np.atleast_1d(np.asarray(self.x0, float)).tolist()
        return dict(zip(self._states, x0, strict=True))

    def p(self, values: Mapping[str, float]) -> Any:
        """Return the argument p of the functions, for values of all parameters."""
        names = tuple(name for name in self.known.given if not name.startswith(INITIAL))
        return parameters_class(names)(*(float(values[name]) for name in names))

    def initial(self, values: Mapping[str, float]) -> Array:
        """Return the state at the record's first sample."""
        return np.array([values.get(name, x) for name, x in self._fixed.items()], dtype=float)

    def _scipy(self, values: Mapping[str, float], initial: Array, time: Array, u: Array) -> Array:
        """Return the states at the times by SciPy's solver, `(time, nx)`."""
        p, count = self.p(values), count_arguments(self.rhs) or 2
        begin, step = float(time[0]), float(time[1] - time[0])

        def slope(t: float, x: Array) -> Any:
            place = np.clip(t / step, 0, len(time) - 1)
            n = min(int(place), len(time) - 2)
            inputs = u[n] if self.hold == "zoh" else u[n] + (place - n) * (u[n + 1] - u[n])
            last = (self.outputs(x, inputs),) if self.terms else ()
            return self.rhs(*(begin + t, x, inputs, p, *last)[:count])

        # Time counts from 0: small steps would be lost in the rounding of large times.
        rtol, atol = self.tolerances
        how: Any = {"rtol": rtol, "atol": atol, "max_step": step if self.driven else np.inf}
        span, times = (0.0, time[-1] - begin), time - begin
        solution = scipy.integrate.solve_ivp(slope, span, initial, self.method, times, **how)
        x = np.full((len(time), len(initial)), np.nan)
        x[: len(solution.t)] = solution.y.T
        return x

    def _observed(self, x: Array, u: Array, values: Mapping[str, float]) -> Array:
        if self.observe is None:
            return x[:, :1]
        arguments = (x, u, self.p(values))
        return _channels(self.observe(*arguments[: count_arguments(self.observe) or 1]))


def _channels(values: Any) -> Array:
    """Return what a user's function returned, `(time, ny)`; ValueError for other than numbers."""
    try:
        y = np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"a simulator must return numbers, got {values!r:.60}") from error
    return y[:, None] if y.ndim == 1 else y


def _changes(now: Any, first: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are others than in `first`; parameters go apart."""
    names = {each.name for each in fields(now)} - {"parameters", "unknown"}
    now, first = vars(now), vars(first)
    return {name: now[name] for name in sorted(names) if now[name] is not first[name]}


def _reopened(
    function: Callable[[Given], Any], parameters: Given, changes: Any, of_terms: Sequence[Any]
) -> Any:
    """Return a simulator of a user's file in another process, changed as the first one was."""
    opened = function(parameters)
    pairs = zip(opened.terms, of_terms, strict=True)
    terms = tuple(replace(term, **changed) for term, changed in pairs)
    return opened._with(**changes, **({"unknown": terms} if terms else {}))


def _first_states(count: int, x: Array) -> Array:
    """Return the first states, `(time, count)`."""
    return x[:, :count]
