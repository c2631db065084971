"""Forecast by a simulator with fitted parameters."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, ClassVar, Unpack, final

import numpy as np
import numpy.typing as npt

from splitband.forecasters.base import Forecaster, Training
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.steps import GivenSteps, NotSteppedError, State, Steps
from splitband.metrics import ExtrapolationWarning
from splitband.records import Record
from splitband.records.preparation import check_level
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.errors import InputError
from splitband.simulators.adjusted import Adjusted
from splitband.simulators.base import Absent, matched, origin
from splitband.simulators.fixed_steps import FixedSteps, enough_steps
from splitband.simulators.functions import Ode
from splitband.simulators.identification import Effort, check_runs, identify
from splitband.simulators.parameters import Adjustable, Estimate, Response
from splitband.simulators.shooting import Experiment
from splitband.simulators.unknown import Unknown, UnknownCurve

STARTS = 0.5, 2 / 3, 5 / 6
"""Origins of the forecasts that choose the `memory`, as shares of the training record. By eye."""
SHORT = 20
"""Samples of the `memory` that is tried beside all of them. By eye."""
MAX_ERROR_SHARE = 0.9
"""A memory is used if its error is below this share of that of the simulation from the start.
By eye."""


@final
class GreyBox(Forecaster):
    """A simulator whose parameters are fitted to the training samples.

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
        if self.adjusted.terms:
            found["unknown"] = [{"in_training": term.ranges()} for term in self.terms]
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
        terms: Sequence[Any] = () if self.adjusted is None else self.adjusted.terms
        if self.adjusted is None and self.simulator is not None:
            terms = [term for term in self.simulator.terms if term.free]
        if terms:
            return "equation with trained unknown terms"
        return "simulator with fitted parameters" if fitted else "simulator as given"

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        simulator = self._matched(records[0])
        effort = Effort(self.starts, self.seconds, how["workers"], how["seed"])
        self.estimate = identify(simulator, *records, effort=effort)
        experiments = [Experiment.of(record, simulator) for record in records]
        adjusted = Adjusted.of(simulator, self.estimate, experiments)
        self.adjusted = replace(adjusted, simulator=None)
        self.estimate = replace(self.estimate, terms=(), members=())
        self.u, self.y = records[0].u, records[0].y_with_gaps
        self.memory = self._chosen_memory(experiments[0])
        self.fitted = self.require_fitted().reporting(cut=self.estimate.cut)

    def _matched(self, record: Record) -> Any:
        """Return the simulator for the channels and inputs of a record."""
        return matched(self.simulator, record.columns, record.inputs)

    def extrapolate(self, known: ForecastContext) -> Array:
        return self._forecast(known)[0]

    def _forecast(self, known: ForecastContext) -> Response:
        """Return channels and states of a forecast."""
        samples, whole = len(known.y), self._experiment(known)
        if 0 < self.memory < samples:
            return self._ahead(whole, samples, self.memory)
        y, x = self._simulated(known, whole)
        return y[samples:], x[samples:]

    def trajectory(self, known: ForecastContext) -> Array:
        """Return the simulation over the history and the forecast, `(time + steps, ny)`.

        If the history continues the training record, the simulation starts from the state at the
        first sample of that record; else the state at the history's first sample is estimated.
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

    @property
    def writable(self) -> bool:
        """Return whether a program can hold its simulator: an equation that can be integrated."""
        return isinstance(self.simulator, Ode) and self.simulator.advances

    def step_form(self) -> Steps:
        """Return the equation by equal steps."""
        simulator = self.simulator.require()
        if not self.writable:
            ode = isinstance(simulator, Ode)
            why = f"with the method {simulator.method} " if ode else ""
            raise NotSteppedError(
                f"{self.name} cannot be stepped: its simulator {why}cannot be written as equal "
                "steps of RK45; a hybrid on it can, which takes its output as y_sim"
            )
        return EquationSteps(self)

    def step_form_as_base(self) -> Steps:
        """Return the equation, its state from all samples as in `trajectory`, or a given output."""
        ny, whole = self.require_fitted().record.ny, copy(self)
        whole.memory = 0
        return whole.step_form() if self.writable else GivenSteps(np.ones(ny), np.zeros(ny))

    def equation(self) -> FixedSteps:
        """Return the equation by as many equal steps a sample as the training record needs."""
        fitted, adjusted = self.require_fitted(), self._adjusted()
        samples, width = fitted.begin + len(fitted.record), fitted.record.sampling_time
        time = self._times(0.0, samples)
        spread = np.maximum(np.ptp(fitted.y_range, axis=0), adjusted.noise)
        u = None if self.u is None else self.u[:samples]
        count = enough_steps(adjusted, time, u, self.estimate.window, spread)
        equation = FixedSteps(adjusted.simulator, adjusted.values, width, count)
        _check_rows(equation, *adjusted.response(time, u), u, spread)
        return equation

    def first(self) -> tuple[Array, float]:
        """Return the initial state `(nx,)` of the equation, and the time of that sample in s."""
        adjusted = self._adjusted()
        return adjusted.simulator.initial(adjusted.values), float(self._times(0.0, 1)[0])

    def last(self, known: ForecastContext) -> tuple[Array, float]:
        """Return the state at the last sample of a history, as for a forecast, and its place.

        The place counts from the first sample of the training record.
        """
        adjusted, samples = self._adjusted(), len(known.y)
        whole = self._experiment(replace(known, steps=0))
        if 0 < self.memory < samples:
            part = whole.part(samples - self.memory, samples)
            x = adjusted.response(part.time, part.u, adjusted.beginning(part))[1]
        else:
            x = self._simulated(known, whole)[1]
        return x[-1], self._begin(known) + samples - 1.0

    def describe(self) -> str:
        terms = [str(term) for term in self.terms if term.trained]
        return "; ".join(filter(None, [str(self.estimate), *terms]))

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return a sentence where the record favours the other `hold` of inputs.

        Also return the quantities of unknown terms that leave their range in training.
        """
        said = [self.estimate.doubt] if self.estimate.doubt else []
        if not any(term.trained for term in self.terms) or not known.steps:
            return said
        _, x = self._forecast(known)
        u = None if known.u is None else known.u[len(known.y) :][: len(x)]
        return [*said, *(sentence for term in self.terms for sentence in term.leaves(x, u))]

    @property
    def terms(self) -> tuple[Unknown, ...]:
        """Return the unknown terms of the fitted equation."""
        terms: tuple[Unknown, ...] = (
            () if self.adjusted is None else self._adjusted().simulator.terms
        )
        return terms

    def unknown_curve(
        self,
        term: int = 0,
        quantity: int = 0,
        at: npt.ArrayLike | None = None,
        z: npt.ArrayLike | None = None,
    ) -> UnknownCurve:
        """Return what a trained unknown term was found to be, over one of its quantities.

        Parameters
        ----------
        term, quantity : Numbers of the term, and of the quantity.
        at : Values of all quantities of the term, of which the others are used, `(quantities,)`; by
            default the middles of their ranges in training.
        z : Values of the quantity, `(points,)`; by default 101 over its range in training.

        Raises
        ------
        ValueError
            For a model without this term, or before it is trained.

        Warns
        -----
        ExtrapolationWarning
            For values outside the range in training, where the term goes on straight.
        """
        terms = self.terms
        if not 0 <= term < len(terms) or terms[term].trained is None:
            raise InputError(
                "term must be the number of a trained unknown term, from 0 on, got "
                f"{term} of {len(terms)} term(s) of {self.name}"
            )
        assert self.adjusted is not None
        curve = terms[term].curve(quantity, at, z, self.adjusted.members[term :: len(terms)])
        low, high = curve.range
        if len(curve.z) and not (low <= curve.z.min() and curve.z.max() <= high):
            warnings.warn(
                f"{curve.quantity} was from {low:.4g} to {high:.4g} in training: outside the "
                "unknown term is not known, and goes on straight from there",
                ExtrapolationWarning,
                stacklevel=2,
            )
        return curve

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
        simulator = self._matched(self.require_fitted().record)
        return replace(self.adjusted, simulator=simulator.taught(self.adjusted.terms))

    def _experiment(self, known: ForecastContext) -> Experiment:
        """Return history and forecast as one experiment, with NaN for the samples to come."""
        ahead = np.full((known.steps, known.y.shape[1]), np.nan)
        time = self._times(self._begin(known), len(known.y) + known.steps)
        u = None if known.u is None else known.u[: len(time)]
        return Experiment(time, np.concatenate([known.y, ahead]), u)

    def _ahead(self, whole: Experiment, samples: int, memory: int) -> Response:
        """Return channels and states after `samples`, from a state told by the last `memory`."""
        adjusted, part = self._adjusted(), whole.part(samples - memory, len(whole.y))
        state = adjusted.beginning(part.part(0, memory))
        y, x = adjusted.response(part.time, part.u, state)
        return y[memory:], x[memory:]

    def _chosen_memory(self, experiment: Experiment) -> int:
        """Return the memory with the lower forecast error: for a correct model all samples."""
        samples, window = len(experiment.y), self.estimate.window
        origins = [int(share * samples) for share in STARTS]
        if not self.simulator.states or origins[0] <= max(SHORT, window):
            return window if self.simulator.states else 0
        ends = [min(origin + samples // 6, samples) for origin in origins]

        def error(memory: int) -> float:
            pairs = [*zip(origins, ends, strict=True)]
            if memory:
                ahead = [self._ahead(experiment.part(0, b), a, memory)[0] for a, b in pairs]
            else:
                whole = self._adjusted().response(experiment.time, experiment.u)[0]
                ahead = [whole[a:b] for a, b in pairs]
            left = [experiment.y[a:b] - y for (a, b), y in zip(pairs, ahead, strict=True)]
            return float(np.sqrt(np.nanmean((np.concatenate(left) / self._adjusted().noise) ** 2)))

        try:
            return SHORT if error(SHORT) < MAX_ERROR_SHARE * error(window) else window
        except ValueError:
            return window


@final
class EquationSteps(Steps):
    """Integrate the equation of a grey box; measured samples do not correct its state.

    `begun` is 0 before the first sample of all, to which the equation goes on by no time.
    """

    note = (
        "Observed samples do not correct the state of its equation: for another run, export it "
        "after a history of that run."
    )

    def __init__(self, grey_box: GreyBox) -> None:
        self.grey_box, self.equation = grey_box, grey_box.equation()
        self.first, self.start = grey_box.first()

    def begin(self, history: ForecastContext | None) -> State:
        """Return the state at the end of a history; without one the initial one."""
        if history is None:
            nu = self.grey_box.require_fitted().record.nu
            x, at, begun, u = self.first, -1.0, 0.0, np.zeros(nu)
        else:
            (x, at), begun = self.grey_box.last(history), 1.0
            u = np.zeros(0) if history.u is None else history.u[-1]
        return {"x": x, "u": u, "at": np.array(at), "begun": np.array(begun)}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        width = self.equation.width
        equation = replace(self.equation, width=width * state["begun"])
        x = equation.advance(state["x"], self.start + width * state["at"], state["u"], u)
        following = {"x": x, "u": u, "at": state["at"] + 1, "begun": np.ones(())}
        return following, equation.observed(x, u)


def _check_rows(equation: FixedSteps, y: Array, x: Array, u: Array | None, spread: Array) -> None:
    """Raise ValueError where `observe` maps a sample `(nx,)` not as in a whole run `(time, nx)`."""
    for n in np.linspace(0, len(x) - 1, 20).astype(int):
        alone = equation.observed(x[n], np.zeros(0) if u is None else u[n])
        if not (abs(alone - y[n]) <= 1e-6 * spread).all():
            raise InputError(
                "observe must map each sample by itself for a program, got other values from one "
                f"row of states than from all of them (sample {n})"
            )
