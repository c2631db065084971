"""Forecast by a simulator with fitted parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Unpack, final

import numpy as np

from splitband.data import Record
from splitband.forecasters.base import Forecaster, Training
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.simulation import check_level, part_of_given_output
from splitband.forecasters.stepping import (
    NotSteppedError,
    Part,
    Recursion,
    State,
    recursion_of_part,
)
from splitband.metrics import rmse
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import cond
from splitband.simulators.base import Absent, matched, origin
from splitband.simulators.fixed_steps import FixedSteps, enough_steps
from splitband.simulators.functions import Ode
from splitband.simulators.identification import Effort, check_runs, identify
from splitband.simulators.parameters import Adjustable, Estimate, Response
from splitband.simulators.shooting import Adjusted, Experiment

STARTS = 0.5, 2 / 3, 5 / 6
"""Origins of the forecasts that choose the `memory`, as shares of the training record. By eye."""
SHORTEST, GROWTH = 20, 4
"""Samples of the shortest `memory` that is tried, and the factor from one to the next. By eye."""
MAX_ERROR_SHARE = 0.9
"""A memory is used if its error is below this share of that of the simulation from the start.
By eye."""


@final
class GreyBox(Forecaster):
    """Fit the parameters of a simulator to the training samples, and run it.

    Parameters
    ----------
    simulator : With ranges for its parameters, such as `Ode` and `Fmu`; None where a comparison
        provides it.
    starts, seconds : Number of starting points and time limit of the fit.
    name : By default "grey-box".

    Attributes
    ----------
    estimate : The values, their uncertainty, and the parameters that the record does not determine.
    adjusted : The simulator with these values.
    memory : Number of samples at the end of a history from which the initial state of a forecast is
        estimated; 0 for all.

    Examples
    --------
    >>> def cooling(t, x, u, p):
    ...     return [-p.rate * (x[0] - 20)]
    >>> tank = sb.Ode(cooling, [60.0], parameters={"rate": (0.01, 1.0)})
    >>> record = sb.Record(20 + 40 * np.exp(-0.1 * 0.5 * np.arange(60)), 0.5)
    >>> sb.GreyBox(tank).fit(record[:40]).predict(20).y[-1].round(2)
    array([22.09])
    """

    def __init__(
        self,
        simulator: Adjustable | None = None,
        starts: int = Effort.starts,
        seconds: float | None = None,
        name: str | None = None,
    ) -> None:
        self.simulator: Any = simulator
        self.starts, self.seconds = starts, seconds
        self._name = name
        self.estimate = Estimate()
        self.adjusted: Adjusted | None = None
        self.memory = 0
        self.u: Array | None = None
        self.y: Array | None = None
        """Inputs and samples of the training record, by which a history of another run is told."""

    @property
    def name(self) -> str:
        """Return the given name, or "grey-box"."""
        return self._name or "grey-box"

    slow_part = "fitted simulator"
    forgets = True
    state_types: ClassVar[Mapping[str, Any]] = {
        "estimate": Estimate,
        "adjusted": Adjusted,
        "memory": int,
        "u": Array | None,
        "y": Array,
    }

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the estimate, and all values in use, fixed ones included."""
        if self.adjusted is None:
            return {}
        found = {**self.estimate.as_json(), "used": dict(self.adjusted.values)}
        hold = None if self.u is None or self.simulator is None else self.simulator.hold
        return found if hold is None else {**found, "hold": hold}

    def check(self, *records: Record) -> None:
        """Raise ValueError for unsuitable records, and where it has no simulator."""
        super().check(*records)
        if not isinstance(self.simulator, Adjustable | Absent):
            raise InputError(
                f"{self.name} needs a simulator with parameters to fit (--simulator and "
                "--parameters), such as sb.Ode, sb.Function and sb.Fmu"
            )
        self.simulator.require()
        check_level(records[0], self.name)
        check_runs(self.simulator, records[0])

    refits = False
    fits_simulator = True

    def saved_options(self) -> dict[str, Any]:
        """Return the options as they are saved, with a description in place of the simulator."""
        return {**self.get_params(), "simulator": self.simulator.description(fitted=True)}

    def complete(self) -> None:
        """Check the fitted simulator and the samples as well; see `Forecaster.complete`."""
        super().complete()
        record, adjusted = self.require_fitted().record, self._adjusted()
        check_shape("noise", adjusted.noise, record.ny)
        check_shape("outputs", adjusted.outputs, len(adjusted.states), record.ny)
        check_shape("y", self.y, None, record.ny)
        if self.u is not None:
            check_shape("u", self.u, None, record.nu)

    def in_words(self) -> str:
        """Return a description; a simulator whose parameters are all given is not fitted.

        What was fitted may run on a simulator that is opened with the fitted values.
        """
        given = isinstance(self.simulator, Adjustable) and not self.simulator.known.free
        fitted = not given if self.adjusted is None else self.estimate.values
        return "simulator with fitted parameters" if fitted else "simulator as given"

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        """Fit the parameters to all records together."""
        simulator = self._matched(records[0])
        effort = Effort(self.starts, self.seconds, how["workers"])
        self.estimate = identify(simulator, *records, effort=effort)
        experiments = [Experiment.of(record, simulator) for record in records]
        adjusted = Adjusted.of(simulator, self.estimate, experiments)
        self.adjusted = replace(adjusted, simulator=None)
        self.u, self.y = records[0].u, records[0].y_with_gaps
        self.memory = self._chosen_memory(experiments[0])
        self.fitted = self.require_fitted().reporting(cut=self.estimate.cut)

    def _matched(self, record: Record) -> Any:
        """Return the simulator for the channels and inputs of a record."""
        return matched(self.simulator, record.columns, record.inputs)

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the simulation from the state estimated from the last samples of the history."""
        if not 0 < self.memory < len(known.y):
            return self.trajectory(known)[len(known.y) :]
        return self._ahead(self._experiment(known), len(known.y), self.memory)

    def trajectory(self, known: ForecastContext) -> Array:
        """Return the simulation over the history and the forecast, `(time + steps, ny)`.

        Where the history goes on from the training record, it starts from the state of the first
        sample of that; else the state at the first sample of the history is estimated.
        """
        return self._simulated(known, self._experiment(known))[0]

    def _simulated(self, known: ForecastContext, whole: Experiment) -> Response:
        """Return channels and states over history and forecast, see `trajectory`."""
        adjusted = self._adjusted()
        if self._anchored(known):
            begin, u = int(known.begin or 0), whole.u
            if u is not None and self.u is not None:
                u = np.concatenate([self.u[:begin], u])
            y, x = adjusted.response(self._times(0.0, begin + len(whole.time)), u)
            return y[begin:], x[begin:]
        state = adjusted.beginning(whole.part(0, len(known.y)))
        return adjusted.response(whole.time, whole.u, state)

    def stepped_part(self, outside: bool = False) -> Part:
        """Return the simulator, integrated from the first state of the training record on."""
        if outside and self.writable:
            return self._written()
        if outside:
            ny = self.require_fitted().record.ny
            return part_of_given_output(np.ones(ny), np.zeros(ny), self.trajectory)
        if not self.simulator.advances:
            raise NotSteppedError(
                f"{self.name} has a simulator that cannot go on from a given state"
            )
        adjusted = self._adjusted()

        def run(
            x: Array | None, first: float, samples: int, u: Array | None, size: float = 0.0
        ) -> State:
            """Return the state at the last of some samples, of which the first has the state x."""
            y, x, size = adjusted.advance(x, self._times(first, samples), u, size)
            last = None if u is None else u[-1]
            return {"x": x[-1], "y": y[-1], "u": last, "at": first + samples - 1, "size": size}

        def moved(now: State | None, u: Array) -> State:
            inputs = u[None] if len(u) else None
            if now is None:  # before the first sample of all
                return run(None, 0.0, 1, inputs)
            inputs = None if inputs is None else np.stack([now["u"], u])
            return run(now["x"], now["at"], 2, inputs, now["size"])

        def initial(known: ForecastContext | None) -> State:
            if known is None or not self._anchored(known):
                raise NotSteppedError(
                    f"{self.name} cannot be stepped: its first state is estimated from the history"
                )
            begin = int(known.begin or 0)
            before = None if self.u is None else self.u[:begin]
            return {"now": run(None, 0.0, begin, before) if begin else None}

        def row(state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
            now = later = moved(state["now"], u)
            rows = [now["y"]]
            for _ in range(ahead):  # with the same inputs
                later = moved(later, u)
                rows.append(later["y"])
            return {"now": now}, np.stack(rows)[..., None]

        return Part(row, initial)

    @property
    def writable(self) -> bool:
        """Return whether a program can hold its simulator: an equation that can be integrated."""
        return isinstance(self.simulator, Ode) and self.simulator.advances

    def _written(self) -> Part:
        """Return the equation by equal steps, as a program holds it.

        `begun` is 0 before the first sample of all, where the state is the initial one.
        """
        fitted, adjusted = self.require_fitted(), self._adjusted()
        samples, width = fitted.begin + len(fitted.record), fitted.record.sampling_time
        time = self._times(0.0, samples)
        spread = np.maximum(np.ptp(fitted.y_range, axis=0), adjusted.noise)
        u = None if self.u is None else self.u[:samples]
        count = enough_steps(adjusted, time, u, self.estimate.window, spread)
        equation = FixedSteps(adjusted.simulator, adjusted.values, width, count)
        start, nu = float(time[0]), fitted.record.nu
        _check_rows(equation, *adjusted.response(time, u), u, spread)

        def moved(now: State, u: Array) -> State:
            def later() -> Array:
                return equation.advance(now["x"], start + width * now["at"], now["u"], u)

            following = {"u": u, "at": now["at"] + 1}
            if "begun" not in now:  # in a free run, see `merged`
                return {"x": later(), **following}
            x = cond(now["begun"] > 0, later, lambda: now["x"])
            return {"x": x, **following, "begun": np.ones(())}

        def row(state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
            now = later = moved(state, u)
            rows = [equation.observed(now["x"], u)]
            for _ in range(ahead):  # with the same inputs
                later = moved(later, u)
                rows.append(equation.observed(later["x"], u))
            return now, np.stack(rows)[..., None]

        def initial(known: ForecastContext | None) -> State:
            """Return the state before a history: simulated from the training record, or estimated.

            Where nothing is known it is that of the equation, at the first training sample.
            """
            begin, begun, last = 0.0 if known is None else self._begin(known), 0.0, np.zeros(nu)
            if known is not None and not self._anchored(known):
                x = adjusted.beginning(self._experiment(known))
            elif begin:
                past = None if self.u is None else self.u[: int(begin)]
                x = adjusted.response(self._times(0.0, int(begin)), past)[1][-1]
                begun, last = 1.0, last if past is None else past[-1]
            else:
                x = adjusted.simulator.initial(adjusted.values)
            return {"x": x, "u": last, "at": np.array(begin - 1.0), "begun": np.array(begun)}

        def merged(state: State, settled: Array) -> State:
            return {name: value for name, value in state.items() if name != "begun"}

        return Part(row, initial, merged=merged)

    def recursion(self, outside: bool = False) -> Recursion:
        """Return the simulator, unless its state is estimated from the last samples.

        A program begins with the estimate at the end of the history, and is not corrected later.
        """
        if outside:
            return self._as_program()
        if self.memory:
            raise NotSteppedError(f"{self.name} estimates its state from {self.memory} samples")
        return super().recursion()

    def _as_program(self) -> Recursion:
        record = self.require_fitted().record
        simulator = self.simulator.require()
        if not self.writable:
            ode = isinstance(simulator, Ode)
            why = f"with the method {simulator.method} " if ode else ""
            raise NotSteppedError(
                f"{self.name} cannot be exported: its simulator {why}cannot be written as equal "
                "steps of RK45; export a hybrid on it, which takes its output as y_sim"
            )
        recursion = recursion_of_part(self._written(), record.ny, record.nu)

        def followed(known: ForecastContext) -> State:
            return recursion.initial(None) | {"part": self._end(known)}

        return replace(recursion, followed=followed)

    def _end(self, known: ForecastContext) -> State:
        """Return the state at the last sample of a history, as `extrapolate` finds it."""
        adjusted, samples = self._adjusted(), len(known.y)
        whole = self._experiment(replace(known, steps=0))
        if 0 < self.memory < samples:
            part = whole.part(samples - self.memory, samples)
            x = adjusted.response(part.time, part.u, adjusted.beginning(part))[1]
        else:
            x = self._simulated(known, whole)[1]
        u = np.zeros(0) if whole.u is None else whole.u[-1]
        at = np.array(self._begin(known) + samples - 1.0)
        return {"x": x[-1], "u": u, "at": at, "begun": np.ones(())}

    def describe(self) -> str:
        """Return the values with standard errors, and those that the record does not determine."""
        return str(self.estimate)

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return that the record favours the other course of inputs between samples, if it does."""
        return [self.estimate.doubt] if self.estimate.doubt else []

    def _begin(self, known: ForecastContext) -> float:
        """Return where a history begins, in samples after the first one of training."""
        if known.begin is not None:
            return float(known.begin)
        # Of another record, which has its own clock.
        start = None if known.grid is None else known.grid.start
        since = origin(self.simulator, start) - float(self._times(0.0, 1)[0])
        return since / self.require_fitted().record.sampling_time

    def _anchored(self, known: ForecastContext) -> bool:
        """Return whether a history begins in the training record, or right after it.

        Then all inputs since the first sample of that are known. A history with other inputs or
        samples at the same times is of another run, although its time stamps may be alike, as of
        loggers that begin at 0; one that begins later may be.
        """
        assert self.y is not None
        begin = known.begin
        if begin is None or begin % 1 or not 0 <= begin <= len(self.y):
            return False
        for ours, theirs in ((self.u, known.u), (self.y, known.y)):
            if ours is not None and theirs is not None:
                same = ours[int(begin) :][: len(known.y)]
                # Those of a file may be rounded.
                rounding = 1e-6 * (np.nanmax(ours, axis=0) - np.nanmin(ours, axis=0))
                if (abs(theirs[: len(same)] - same) > rounding).any():  # gaps are alike
                    return False
        return True

    def _times(self, first: float, samples: int) -> Array:
        """Return the simulator's times of samples, in s; `first` is counted from training."""
        fitted = self.require_fitted()
        places = first + np.arange(samples, dtype=np.float64)
        start = origin(self.simulator, fitted.start)
        return np.asarray(start + fitted.record.sampling_time * places)

    def _adjusted(self) -> Adjusted:
        """Return the simulator with the fitted values, for the channels of the record."""
        assert self.adjusted is not None
        return replace(self.adjusted, simulator=self._matched(self.require_fitted().record))

    def _experiment(self, known: ForecastContext) -> Experiment:
        """Return history and forecast as one experiment, with NaN for the samples to come."""
        ahead = np.full((known.steps, known.y.shape[1]), np.nan)
        time = self._times(self._begin(known), len(known.y) + known.steps)
        u = None if known.u is None else known.u[: len(time)]
        return Experiment(time, np.concatenate([known.y, ahead]), u)

    def _ahead(self, whole: Experiment, samples: int, memory: int) -> Array:
        """Return the simulation after `samples`, from a state estimated on the last `memory`."""
        adjusted, part = self._adjusted(), whole.part(samples - memory, len(whole.y))
        state = adjusted.beginning(part.part(0, memory))
        return adjusted.response(part.time, part.u, state)[0][memory:]

    def _chosen_memory(self, experiment: Experiment) -> int:
        """Return the memory with the lowest forecast error: for a correct model 0, all samples."""
        samples, window = len(experiment.y), self.estimate.window
        origins = [int(share * samples) for share in STARTS]
        if not self.simulator.states or origins[0] < SHORTEST:
            return window if self.simulator.states else 0
        ends = [min(origin + samples // 6, samples) for origin in origins]

        def error(forecasts: Sequence[Array]) -> float:
            pairs = zip(origins, forecasts, strict=True)
            parts = [experiment.y[at : at + len(y)] - y for at, y in pairs]
            left = np.concatenate(parts) / self._adjusted().noise
            return rmse(left, np.zeros_like(left))

        best = np.inf
        if not window:
            whole = self._adjusted().response(experiment.time, experiment.u)[0]
            best = MAX_ERROR_SHARE * error([whole[a:b] for a, b in zip(origins, ends, strict=True)])
        chosen, length = window, SHORTEST
        while length <= min(window or samples, origins[0]):
            try:
                parts = ((experiment.part(0, b), a) for a, b in zip(origins, ends, strict=True))
                found = error([self._ahead(part, a, length) for part, a in parts])
            except ValueError:
                found = np.inf
            if found < best:
                best, chosen = found, length
            length *= GROWTH
        return chosen


def _check_rows(equation: FixedSteps, y: Array, x: Array, u: Array | None, spread: Array) -> None:
    """Raise ValueError where `observe` maps a sample `(nx,)` not as in a whole run `(time, nx)`."""
    for n in np.linspace(0, len(x) - 1, 20).astype(int):
        alone = equation.observed(x[n], np.zeros(0) if u is None else u[n])
        if not (abs(alone - y[n]) <= 1e-6 * spread).all():
            raise InputError(
                "observe must map each sample by itself for a program, got other values from one "
                f"row of states than from all of them (sample {n})"
            )
