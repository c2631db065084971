"""Compare a simulator with records, over whole records or windows.

A long simulation may lose its phase or be unstable, and then does not determine the parameters.
Then records are simulated in windows (multiple shooting; Bock, 1987). Positions of parameters in
their ranges and the initial states of the windows are the unknowns of one least-squares problem,
whose residuals are the errors of the outputs, and the steps of the state from the end of a window
to the beginning of the next one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import check
from splitband.simulators.base import origin
from splitband.simulators.least_squares import BAD, finite, likely_state, limited
from splitband.simulators.parameters import (
    INITIAL,
    Adjustable,
    Point,
    Response,
)
from splitband.simulators.user_code import failure, is_ours

GROWTH = 4
"""Growth of windows from stage to stage. Bounds the time."""
_REGULAR = 1e-6
"""Share of the weight decay that is left, as weights may have no effect. Rounding."""
MOST_GROWTH, _EXPONENT = 10.0, 1.5
"""Largest growth of an error of the state in a window, and least exponent of the growth in a second
half by that in the first one: 1 for powers of time, 2 for exponentials. By eye."""
_STATE_ROUNDS = 4
"""Largest number of steps in the search for the initial state of a window, a start for the search
for all unknowns. Bounds the time."""


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

    `begin`: first sample; `columns`: indices of the unknowns by which a response is differentiated,
    -1 for what is no unknown; `state`: index of the first unknown of the initial state, -1 at the
    beginning of a record, where parameters define it.
    """

    record: int
    begin: int
    part: Experiment
    columns: Array
    state: int


class Compared(NamedTuple):
    """A comparison: what is minimised, and what else it tells.

    `errors`: of the windows in deviations of the channels, `(samples, ny)`, NaN in gaps;
    `begins`, `steps`: residuals of the steps of the state to first windows and between windows;
    `path`: states by record, `(time, nx)`; `transitions`, only with slopes: derivatives of a
    window's last state by its first one, in sizes of the states.
    """

    cost: float
    gradient: Array
    normal: Array
    errors: list[Array]
    begins: list[Array]
    steps: list[Array]
    path: list[Array]
    transitions: list[Array]


class Shooting:
    """A comparison of a simulator with records.

    The unknowns are the relative positions of parameters in their ranges, 0 to 1, the weights of
    unknown terms, and the initial states of the windows, in units of `sizes`.

    Parameters
    ----------
    simulator, experiments : The simulator to fit, and the data of the records.
    scale : Deviations of the channels, `(ny,)`, the unit of errors.

    Attributes
    ----------
    names : Parameters by position: the common ones, then initial values by record.
    noise : Errors of the channels in deviations, by which they are weighted, `(ny,)`.
    slack : Of the steps of the state between windows: 1 if these are as large as the error of a
        state that a window's samples determine.
    anchored : Whether the given initial state counts for the first one of several windows.
    trained : Which weights of unknown terms are unknowns, `(weights,)`.
    prior : Residuals of these weights, with their derivatives; None for none.
    decay : The weight decay in it.
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
        self.noise, self.slack, self.anchored = np.ones(len(scale)), 1.0, False
        self.trained = np.zeros(len(simulator.weights), dtype=bool)
        self.prior: Callable[[Array], tuple[Array, Array]] | None = None
        self.decay = 0.0

    def of(
        self, simulator: Adjustable, experiments: Sequence[Experiment] | None = None
    ) -> Shooting:
        """Return the same comparison with another simulator, whose terms are taught, or records."""
        states: Any = tuple(term.trained for term in self.simulator.terms)
        simulator = simulator.taught(states) if self.trained.any() else simulator
        other = Shooting(simulator, experiments or self.experiments, self.scale)
        other.trained, other.prior, other.decay = self.trained, self.prior, self.decay
        return other

    @property
    def longest(self) -> int:
        """Return the number of samples of the longest record."""
        return max(len(experiment.y) for experiment in self.experiments)

    @property
    def common(self) -> int:
        """Return the number of unknowns other than states of windows."""
        return len(self.names) + int(self.trained.sum())

    @property
    def varied(self) -> tuple[str, ...]:
        """Return the names of parameters by which responses are differentiated."""
        known = self.simulator.known
        return known.shared if self.simulator.states else known.free

    def values(self, unknowns: Array, record: int) -> dict[str, float]:
        """Return the values of all parameters for a record."""
        parameters = self.simulator.known
        by_name = parameters.middle()
        for (name, of), fraction in zip(self.names, unknowns, strict=False):
            if of in (-1, record):
                by_name[name] = parameters.value_at(name, float(fraction))
        return by_name

    def divide(self, length: int) -> None:
        """Divide every record into windows of at most `length` samples.

        A black box, which runs from the beginning of a record, has a single window there.
        """
        self.windows, states, last = [], self.simulator.states, self.common
        weights = np.where(self.trained, len(self.names) - 1 + np.cumsum(self.trained), -1)
        for r, experiment in enumerate(self.experiments):
            places = {name: i for i, (name, record) in enumerate(self.names) if record in (-1, r)}
            own = [places[name] for name in self.varied]
            samples = len(experiment.y)
            cuts = np.array([0, min(length, samples)])
            if states:
                cuts = np.linspace(0, samples, -(-samples // length) + 1).round().astype(int)
            for begin, end in pairwise(cuts):
                part = experiment.part(begin, min(end + 1, samples) if states else end)
                if states and end < samples:  # it counts as the first one of the next window
                    part.y[-1] = np.nan
                state, columns = -1, [places.get(f"{INITIAL}{i + 1}", -1) for i in range(states)]
                # Where a run of the whole record may be lost, its first state may be wrong, too.
                if begin or (len(cuts) > 2 and not self.simulator.known.initial):
                    state, columns = last, [*range(last, last + states)]
                    last += states
                every = np.array([*own, *columns, *weights], int)
                self.windows.append(Window(r, begin, part, every, state))

    def begun(self, fractions: Array) -> Array:
        """Return unknowns at parameters and weights, with the windows one after another.

        The state of a window is that of the least residuals after the window before it.
        """
        states: list[Array] = []
        self.learn(fractions)
        x, sizes, self.sizes = np.zeros(0), 0.0 * self.sizes, np.ones(self.simulator.states)
        for window in self.windows:
            values = self.values(fractions, window.record)
            if window.begin == 0 and self.simulator.states:
                x = self.simulator.initial(values)
            if window.state >= 0:
                x = self._settled(window, x, np.where(sizes > 0, sizes, 1.0), values)
                states.append(x)
            path = self.respond(window.part, [(values, x)])[0][1]
            path = path[np.isfinite(path).all(axis=1)]
            if len(path):
                x, sizes = path[-1].copy(), np.maximum(sizes, _size(path))
        self.sizes = np.where(sizes > 0, sizes, 1.0)
        return np.concatenate([fractions, *(state / self.sizes for state in states)])

    def resumed(self, fractions: Array, path: Sequence[Array]) -> Array:
        """Return unknowns at the positions of parameters and the weights, and states on a path.

        `path` has the states by record.
        """
        self.sizes = np.maximum.reduce([_size(x) for x in path])
        self.sizes = np.where(self.sizes > 0, self.sizes, 1.0)
        begins = [path[w.record][w.begin] / self.sizes for w in self.windows if w.state >= 0]
        return np.concatenate([fractions, *begins])

    def restored(self, length: int, fit: Any) -> Compared:
        """Divide the records as for a fit, and compare them there."""
        self.divide(length)
        self.sizes, self.noise = fit.sizes, fit.noise
        return self.compare(fit.unknowns)

    def ahead(self, length: int, fit: Any, experiments: Sequence[Experiment]) -> float:
        """Return the RMS error in deviations of samples after those of a fit; infinite for none.

        They are simulated from the last windows on; `experiments` have the whole records.
        """
        self.restored(length, fit)
        errors = []
        for window in {window.record: window for window in self.windows}.values():
            part = experiments[window.record].part(window.begin, len(experiments[window.record].y))
            y, _ = self.respond(part, [self._point(window, fit.unknowns)])[0]
            errors.append(self._errors(part, y)[len(window.part.y) :])
        every = np.concatenate(errors)
        return float(np.sqrt(np.nanmean(every**2))) if np.isfinite(every).any() else np.inf

    def compare(  # noqa: PLR0915  one pass over the windows
        self, unknowns: Array, slopes: bool = False
    ) -> Compared:
        """Compare the simulator with the records, with or without derivatives."""
        count, nx, cost = len(unknowns), self.simulator.states, 0.0
        gradient, normal = np.zeros(count), np.zeros((count, count))
        errors, transitions = list[Array](), list[Array]()
        begins, steps = list[Array](), list[Array]()
        path = [np.full((len(e.y), nx), np.nan) for e in self.experiments]
        end, end_slopes, end_columns = np.zeros(0), np.zeros((0, 0)), np.zeros(0, int)
        self.learn(unknowns)

        def add(residuals: Array, block: Array, columns: Any) -> None:
            nonlocal cost
            cost += 0.5 * float(residuals @ residuals)
            if slopes:
                gradient[columns] += block.T @ residuals
                normal[np.ix_(columns, columns)] += block.T @ block

        if self.prior is not None:
            of = np.arange(len(self.names), self.common)
            add(*self.prior(unknowns[of]), of)
        first = len(self.varied)
        states = slice(first, first + nx)
        for window in self.windows:
            point = self._point(window, unknowns)
            state = point[1]
            anchored = not window.begin and window.state >= 0 and self.anchored
            if anchored:
                end = self.simulator.initial(point[0])
                end_slopes, end_columns = np.zeros((nx, 0)), np.zeros(0, int)
            if window.begin or anchored:  # the step of the state from the end of the window before
                unit = self.sizes * self.slack * self.noise.max() / np.sqrt(len(window.part.y))
                step = limited((state - end) / unit)
                (begins if anchored else steps).append(step)
                block = np.zeros((0, 0))
                if slopes:
                    good = (np.abs(step) < BAD)[:, None]
                    block = np.hstack([-end_slopes, np.diag(self.sizes)]) * good / unit[:, None]
                add(step, block, np.concatenate([end_columns, window.columns[states]]))
            if slopes:
                y, x, dy, dx = self._derivatives(window.part, point)
            else:
                ((y, x),) = self.respond(window.part, [point])
            error = self._errors(window.part, y)
            errors.append(error)
            path[window.record][window.begin : window.begin + len(x)] = x
            end = x[-1] if nx else end
            block = np.zeros((0, 0))
            own = window.columns >= 0
            if slopes:
                widths = self._widths(window, unknowns)
                dy, dx = dy * widths, dx * widths
                whole = np.abs(error) < BAD
                block = np.where(whole[..., None], dy / (self.scale * self.noise)[:, None], 0.0)
                block = finite(block.reshape(error.size, -1)[:, own])
                if nx:
                    last = finite(dx[-1])
                    transitions.append(
                        last[:, -nx:] / widths[-nx:] * self.sizes / self.sizes[:, None]
                    )
                    end_slopes, end_columns = last[:, own], window.columns[own]
            add(np.nan_to_num(error / self.noise).ravel(), block, window.columns[own])
        return Compared(cost, gradient, normal, errors, begins, steps, path, transitions)

    def learn(self, unknowns: Array) -> None:
        """Set the weights of the simulator."""
        if self.trained.any():
            weights = self.simulator.weights.copy()
            weights[self.trained] = unknowns[len(self.names) : self.common]
            self.simulator = self.simulator.weighted(weights)

    def undecayed(self, normal: Array) -> Array:
        """Return a normal matrix without the weight decay, which knows nothing of the system."""
        told, of = normal.copy(), np.arange(len(self.names), self.common)
        told[of, of] -= (1 - _REGULAR) * self.decay
        return told

    def information(self, normal: Array) -> Array:
        """Return the normal matrix of the parameters with all other unknowns optimal."""
        n, scale = len(self.names), np.sqrt(np.maximum(np.diag(normal), 1e-300))
        whole = normal / scale / scale[:, None]
        others = whole[n:, n:] + 1e-12 * np.eye(len(whole) - n)  # of which some may not matter
        inner = whole[:n, n:] @ np.linalg.solve(others, whole[n:, :n])
        return (whole[:n, :n] - inner) * scale[:n] * scale[:n, None]

    def growth(self, transitions: Sequence[Array]) -> tuple[float, float]:
        """Return how much an error of the state grows in a window and in one of the next stage.

        Both are medians of the windows; 0 if it does not grow exponentially, and for unknown terms
        in training, which longer windows correct.
        """
        if self.trained.any():
            return 0.0, 0.0
        growths = []
        for length in (1, GROWTH // 2, GROWTH):
            each = []
            for i in range(0, len(transitions) - length + 1, length):
                if self.windows[i].record == self.windows[i + length - 1].record:
                    product = transitions[i]
                    for transition in transitions[i + 1 : i + length]:
                        product = transition @ product
                    each.append(np.linalg.norm(product, 2))
            growths.append(float(np.median(each)) if each else 0.0)
        one, half, all_of = np.maximum(growths, 1e-300)
        exponential = all_of / half > (half / one) ** _EXPONENT
        return (growths[0], growths[-1]) if exponential else (0.0, 0.0)

    def respond(self, part: Experiment, points: Sequence[Point]) -> list[Response]:
        """Return the simulator's responses at several points; NaN for a failed call."""
        return self._called(part, len(points), self.simulator.respond, points)

    def _derivatives(self, part: Experiment, point: Point) -> Any:
        """Return the response and its derivatives at a point, see `Adjustable.derivatives`."""
        found = self._called(part, 1, self.simulator.derivatives, point, self.varied)
        if len(found) > 1:
            return found
        count = len(self.varied) + self.simulator.states + len(self.trained)
        return *found[0], *(np.zeros((*each.shape, count)) for each in found[0])

    def _called(self, part: Experiment, count: int, function: Any, *arguments: Any) -> Any:
        check()
        try:
            with np.errstate(all="ignore"):
                return function(part.time, part.u, *arguments)
        except Exception as error:
            if is_ours(error):
                raise
            self.failure = failure(error)
            nothing = np.full(part.y.shape, np.nan)
            return [(nothing, np.full((len(part.y), self.simulator.states), np.nan))] * count

    def _point(self, window: Window, unknowns: Array) -> Point:
        values = self.values(unknowns, window.record)
        if window.state >= 0:
            state = unknowns[window.state : window.state + self.simulator.states]
            return values, state * self.sizes
        return values, self.simulator.initial(values) if self.simulator.states else None

    def _widths(self, window: Window, unknowns: Array) -> Array:
        """Return the change of parameters and states with a unit of the unknowns."""
        known, nx = self.simulator.known, self.simulator.states
        names = [*self.varied, *(f"{INITIAL}{i + 1}" for i in range(nx))]
        widths = np.concatenate([np.ones(len(self.varied)), self.sizes, np.ones(len(self.trained))])
        for i, (name, column) in enumerate(zip(names, window.columns, strict=False)):
            if 0 <= column < len(self.names):
                widths[i] = known.slope(name, float(unknowns[column]))
        return widths

    def _errors(self, part: Experiment, y: Array) -> Array:
        """Return the errors of channels in deviations, `(samples, ny)`, NaN in gaps."""
        bad = ~np.isfinite(y)
        if bad.any() and not self.failure:
            at = int(np.argmax(bad.any(axis=1)))
            self.failure = self.simulator.unfinished(float(part.time[at]))
        return np.where(np.isnan(part.y), np.nan, limited((y - np.nan_to_num(part.y)) / self.scale))

    def _settled(
        self, window: Window, x: Array, sizes: Array, values: Mapping[str, float]
    ) -> Array:
        """Return the initial state with the least residuals of a window and of the step from x."""
        states = slice(len(self.varied), len(self.varied) + len(x))

        def run(state: Array, slopes: bool) -> tuple[Array, Array]:
            if not slopes:
                return self.respond(window.part, [(values, state)])[0]
            y, _, dy, _ = self._derivatives(window.part, (values, state))
            return y, dy[..., states]

        spread = sizes * self.noise.max() / np.sqrt(len(window.part.y))
        unit = self.noise * self.scale
        return likely_state(run, window.part.y, unit, x, spread, x, _STATE_ROUNDS, BAD)[0]


def _size(path: Array) -> Array:
    """Return the RMS of finite states, `(nx,)`."""
    good = path[np.isfinite(path).all(axis=1)]
    return np.sqrt(np.mean(good**2, axis=0)) if len(good) else np.zeros(path.shape[1])
