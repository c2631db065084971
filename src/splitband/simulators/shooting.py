"""Compare a simulator with records: residuals and their derivatives, over whole records or windows.

A long simulation may lose its phase or be unstable, and then does not determine the parameters.
Then records are simulated in windows with separate initial states (multiple shooting; Bock, 1987).
Parameters and initial states are the unknowns of one least-squares problem. The simulator with
fitted parameters runs from an initial state estimated from a history.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
import scipy

from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError, check
from splitband.runtime.errors import InputError
from splitband.simulators.base import origin
from splitband.simulators.parameters import MIN_NOISE, Adjustable, Estimate, Point, Response
from splitband.simulators.unknown import Trained
from splitband.simulators.user_code import failure, place

BAD = 1e3
"""Residual of a failed run, and upper limit of others, in deviations of a channel. By eye."""
FAILED = 1e9
"""The same limit in deviations of the noise, for the larger residuals of a wrong state. Rounding.
"""
STATE_STEP = 1e-6
"""Relative step of finite differences with respect to a state. Rounding."""
_STATE_RUNS = 8
"""Largest number of evaluations in the search for the initial state of a window, a start for the
search for all unknowns. Bounds the time."""
MOST_STATES = 500
"""Largest number of stored training states, as prior and as starting points. Bounds the time."""
_TRIED, _MOST_RUNS = 3, 50
"""Number of stored states with the closest outputs as starts for an initial state, and largest
number of evaluations per start. Bounds the time."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """The times, measured samples and inputs of a record.

    Attributes
    ----------
    time : `(time,)` in s, as passed to the simulator.
    y, u : `(time, ny)`, NaN in gaps, and `(time, nu)` or None.
    """

    time: Array
    y: Array
    u: Array | None

    @classmethod
    def of(cls, record: Record, simulator: Any) -> Experiment:
        """Return the experiment of a record, with times on the simulator's clock."""
        begin = origin(simulator, record.start)
        time = begin + record.sampling_time * np.arange(len(record), dtype=np.float64)
        return cls(time, record.y_with_gaps, record.u)

    def part(self, begin: int, end: int) -> Experiment:
        """Return the samples from `begin` to before `end`."""
        u = None if self.u is None else self.u[begin:end]
        return Experiment(self.time[begin:end], self.y[begin:end].copy(), u)


class Window(NamedTuple):
    """A part of a record for one simulation.

    `unknowns`: indices of the window's unknowns, the last ones, `states`, for its initial state. At
    the beginning of a record, parameters define the initial state.
    """

    record: int
    part: Experiment
    unknowns: Sequence[int]
    states: slice


class Shooting:
    """A comparison of a simulator with records.

    The unknowns are the relative positions of parameters in their ranges, 0 to 1, and then the
    initial states of the windows, in units of `sizes`.

    Parameters
    ----------
    simulator, experiments : The simulator to fit, and the data of the records.
    scale : Deviations of the channels, `(ny,)`, the unit of residuals.

    Attributes
    ----------
    names : Parameters by position: the common ones, then initial values by record.
    failure : Message of the last failed run.
    """

    def __init__(self, simulator: Adjustable, experiments: Sequence[Experiment], scale: Array):
        self.simulator, self.experiments, self.scale = simulator, experiments, scale
        parameters = simulator.known
        self.names = [(name, -1) for name in parameters.shared]
        self.names += [(name, r) for r in range(len(experiments)) for name in parameters.initial]
        self.failure = ""
        self.windows: list[Window] = []
        self.sizes = np.ones(simulator.states)

    @property
    def longest(self) -> int:
        """Return the number of samples of the longest record."""
        return max(len(experiment.y) for experiment in self.experiments)

    def values(self, unknowns: Array, record: int) -> dict[str, float]:
        """Return the values of all parameters for a record."""
        parameters = self.simulator.known
        by_name = parameters.middle()
        for (name, of), fraction in zip(self.names, unknowns, strict=False):
            if of in (-1, record):
                by_name[name] = parameters.value_at(name, float(fraction))
        return by_name

    def divide(self, length: int, fractions: Array) -> Array:
        """Divide every record into windows of at most `length` samples, and return the unknowns.

        The search for a window's state starts from the final state of the window before. A black
        box, which runs from the beginning of a record, has a single window there.
        """
        self.windows = []
        states: list[Array] = []
        for r, experiment in enumerate(self.experiments):
            samples = len(experiment.y)
            parameters = [i for i, (_, record) in enumerate(self.names) if record in (-1, r)]
            if not self.simulator.states:
                self.windows.append(Window(r, experiment.part(0, length), parameters, slice(0)))
                continue
            cuts = np.linspace(0, samples, -(-samples // length) + 1).round().astype(int)
            values, state = self.values(fractions, r), None
            for begin, end in pairwise(cuts):
                part = experiment.part(begin, min(end + 1, samples))
                if end < samples:  # the last sample counts as the first of the next window
                    part.y[-1] = np.nan
                where = slice(0)
                if state is not None:
                    state = self._settled(part, values, state)
                    states.append(state)
                    first = len(fractions) + (len(states) - 1) * self.simulator.states
                    where = slice(first, first + self.simulator.states)
                self.windows.append(
                    Window(r, part, [*parameters, *range(*where.indices(10**9))], where)
                )
                last = self.respond(part, [(values, state)])[0][1][-1]
                if np.isfinite(last).all():
                    state = last.copy()
                elif state is None:
                    state = np.zeros(self.simulator.states)
        if states:
            self.sizes = np.maximum(np.abs(states).mean(axis=0), 1e-3)
        return np.concatenate([fractions, *(state / self.sizes for state in states)])

    def residuals(self, unknowns: Array) -> Array:
        """Return all residuals in deviations of the channels, `(samples * ny,)`, 0 in gaps."""
        errors = [
            self._errors(window.part, self.respond(window.part, [self._point(window, unknowns)])[0])
            for window in self.windows
        ]
        return np.concatenate(errors)

    def jacobian(self, unknowns: Array) -> Array:
        """Return the derivatives of the residuals, `(samples * ny, unknowns)`."""
        step, count = self.simulator.difference, len(self.names)
        steps = STATE_STEP * np.maximum(np.abs(unknowns), 1.0)
        steps[:count] = np.where(unknowns[:count] + step <= 1, step, -step)
        blocks = []
        for window in self.windows:
            moved = [unknowns]
            for i in window.unknowns:
                moved.append(unknowns.copy())
                moved[-1][i] += steps[i]
            points = [self._point(window, values) for values in moved]
            responses = self.respond(window.part, points)
            at, *others = (self._errors(window.part, response) for response in responses)
            block = np.zeros((len(at), len(unknowns)))
            for i, other in zip(window.unknowns, others, strict=True):
                block[:, i] = _difference(at, other, steps[i])
            blocks.append(block)
        return np.concatenate(blocks)

    def respond(self, part: Experiment, points: Sequence[Point]) -> list[Response]:
        """Return the simulator's responses at several points; NaN for a failed call."""
        check()
        try:
            with np.errstate(all="ignore"):
                return [*self.simulator.respond(part.time, part.u, points)]
        except DeadlineError:
            raise
        except Exception as error:
            self.failure = failure(error)
            nothing = np.full(part.y.shape, np.nan)
            return [(nothing, np.full((len(part.y), self.simulator.states), np.nan))] * len(points)

    def _point(self, window: Window, unknowns: Array) -> Point:
        state = unknowns[window.states] * self.sizes if window.states.stop else None
        return self.values(unknowns, window.record), state

    def _errors(self, part: Experiment, response: Response) -> Array:
        """Return the residuals of a response, `(samples * ny,)`."""
        bad = ~np.isfinite(response[0])
        if bad.any() and not self.failure:
            at = int(np.argmax(bad.any(axis=1)))
            self.failure = self.simulator.unfinished(float(part.time[at]))
        return _scaled_errors(response[0], part.y, self.scale)

    def _settled(self, part: Experiment, values: Mapping[str, float], state: Array) -> Array:
        """Return the initial state with the least error of a window."""

        def errors(states: Sequence[Array]) -> list[Array]:
            responses = self.respond(part, [(values, begin) for begin in states])
            return [self._errors(part, response) for response in responses]

        size = np.maximum(np.abs(state), 1e-3)
        return best_state(errors, state, size, STATE_STEP, _STATE_RUNS)[0]


def best_state(
    errors: Callable[[Sequence[Array]], Sequence[Array]],
    begin: Array,
    size: Array,
    step: float,
    most: int,
    limit: float = BAD,
) -> tuple[Array, float]:
    """Return the state of the least squared error, and the error.

    `errors` returns the residuals by state for several states; `size` is the typical magnitude of a
    state, `step` the relative step of finite differences, `most` limits the evaluations, and
    `limit` the residuals.
    """

    def residuals(x: Array) -> Array:
        return errors([size * x])[0]

    def jacobian(x: Array) -> Array:
        at, *others = errors([size * x, *(size * (x + unit) for unit in step * np.eye(len(x)))])
        return np.stack([_difference(at, other, step, limit) for other in others], axis=1)

    minimum = scipy.optimize.least_squares(residuals, begin / size, jacobian, max_nfev=most)
    return np.asarray(size * minimum.x), float(minimum.cost)


def projected(jacobian: Array, count: int) -> Array:
    """Return derivatives by the first `count` unknowns, with all others optimal."""
    u, s, _ = np.linalg.svd(jacobian[:, count:], full_matrices=False)
    u = u[:, s > 1e-9 * s.max(initial=1e-300)]
    return np.asarray(jacobian[:, :count] - u @ (u.T @ jacobian[:, :count]))


def _difference(at: Array, beside: Array, step: float, limit: float = BAD) -> Array:
    """Return the difference quotient of residuals; 0 after a failed run."""
    whole = (np.abs(at) < limit) & (np.abs(beside) < limit)
    return np.asarray(np.where(whole, (beside - at) / step, 0.0))


def _scaled_errors(y: Array, measured: Array, scale: Array, limit: float = BAD) -> Array:
    """Return the errors of a simulation in units of `scale`, `(samples * ny,)`, 0 in gaps."""
    errors = np.where(np.isfinite(y), np.clip((y - measured) / scale, -limit, limit), limit)
    return np.asarray(np.where(np.isnan(measured), 0.0, errors).ravel())


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A simulator with fitted parameter values.

    Attributes
    ----------
    simulator : The simulator with the ranges of the fit; None in a saved model.
    values : Values of all parameters; initial values are those of the first training record.
    noise : RMSE by channel in training, `(ny,)`.
    states, outputs : States `(n, nx)` and outputs `(n, ny)` of the first training record, at most
        `MOST_STATES` rows.
    terms : States of the unknown terms.
    members : Those of further trainings that fit as well, one training after another.
    """

    simulator: Any
    values: dict[str, float]
    noise: Array
    states: Array = field(default_factory=lambda: np.empty((0, 0)))
    outputs: Array = field(default_factory=lambda: np.empty((0, 0)))
    terms: tuple[Trained, ...] = ()
    members: tuple[Trained, ...] = ()

    @classmethod
    def of(
        cls, simulator: Adjustable, estimate: Estimate, experiments: Sequence[Experiment]
    ) -> Self:
        """Return the fitted simulator; `experiments` are those of the fit."""
        middle = simulator.known.middle()
        values = {name: estimate.values.get(name, x) for name, x in middle.items()}
        deviation = np.nanstd(np.concatenate([e.y for e in experiments]), axis=0)
        noise = np.maximum(np.array(estimate.rmse), MIN_NOISE * np.maximum(deviation, 1e-300))
        usual = cls(simulator, values, noise)
        outputs, states = usual.response(experiments[0].time, experiments[0].u)
        rows = np.linspace(0, len(states) - 1, min(len(states), MOST_STATES)).round().astype(int)
        rows = rows[np.isfinite(states[rows]).all(axis=1)]
        terms = tuple(term.trained for term in simulator.terms if term.trained)
        return replace(usual, states=states[rows], outputs=outputs[rows], terms=terms)

    def response(self, time: Array, u: Array | None, state: Any = None) -> Response:
        """Simulate channels and states at `time` in s, by default from the fitted initial state.

        Raises ValueError if the run fails.
        """
        simulator = self._given
        with _running():
            y, x = simulator.respond(time, u, [self._began(state)])[0]
        return self._finite(y, time), x

    def advance(
        self, state: Any, time: Array, u: Array | None, size: float = 0.0
    ) -> tuple[Array, Array, float]:
        """Return channels, states, and the next step size; see `Ode.advance`.

        Raises ValueError if the run fails.
        """
        simulator = self._given
        state = simulator.initial(self.values) if state is None else state
        with _running():
            y, x, size = simulator.advance(self.values, state, time, u, size)
        return self._finite(y, time), x, size

    def beginning(self, history: Experiment) -> Array | None:
        """Estimate the initial state of a history; None for a simulator without one.

        The estimate fits the history and a prior from the training states. The prior has the weight
        of one sample per state, and decides if the history does not determine the state. For a
        black box, the initial values take the place of the state.
        """
        parameters = self._given.known
        if not self.simulator.states and not parameters.initial:
            return None
        if not self.simulator.states:
            low, high = np.transpose([parameters.range(name) for name in parameters.initial])
            return self._searched(history, [0.5 * (low + high)], 0.5 * (low + high), high - low)
        mean, spread = self.states.mean(axis=0), self.states.std(axis=0)
        spread = np.maximum(spread, 1e-6 * np.maximum(np.abs(mean), 1e-6))
        distance = np.nansum(((self.outputs - history.y[:1]) / self.noise) ** 2, axis=1)
        similar = self.states[np.argsort(distance, kind="stable")[:_TRIED]]
        return self._searched(history, [*similar, mean], mean, spread)

    @property
    def _given(self) -> Any:
        """Return the simulator; raises ValueError for a saved model without it."""
        return self.simulator.require()

    def _finite(self, y: Array, time: Array) -> Array:
        """Return the channels; raises ValueError for non-finite values."""
        good = np.isfinite(y).all(axis=1)
        if not good.all():
            raise InputError(self._given.unfinished(float(time[np.argmin(good)])))
        return y

    def _began(self, state: Any) -> Point:
        """Return parameters and initial state for `Adjustable.respond`."""
        if state is None or self.simulator.states:
            return self.values, state
        return {**self.values, **dict(zip(self.simulator.known.initial, state, strict=True))}, None

    def _searched(
        self, history: Experiment, begin: Sequence[Array], mean: Array, spread: Array
    ) -> Array:
        """Search from several states, and return the most likely result."""

        def errors(states: Sequence[Array]) -> list[Array]:
            points = [self._began(state) for state in states]
            with np.errstate(all="ignore"), _running():
                responses = self.simulator.respond(history.time, history.u, points)
            left = [_scaled_errors(y, history.y, self.noise, FAILED) for y, _ in responses]
            pairs = zip(left, states, strict=True)
            return [np.concatenate([e, (state - mean) / spread]) for e, state in pairs]

        step = max(STATE_STEP, self.simulator.difference)
        minima = [best_state(errors, state, spread, step, _MOST_RUNS, FAILED) for state in begin]
        return min(minima, key=lambda minimum: minimum[1])[0]


@contextmanager
def _running() -> Iterator[None]:
    """Turn errors of user code into a ValueError with the place."""
    try:
        yield
    except DeadlineError:
        raise
    except Exception as error:
        if isinstance(error, ValueError) and not place(error):
            raise  # raised by this package
        raise InputError(f"the simulator failed: {failure(error)}") from error
