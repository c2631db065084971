"""Compare a simulator with records: residuals and their derivatives, over whole records or windows.

Where a long simulation loses its phase or is unstable, and so does not determine the parameters,
records are simulated in windows, each from its own initial state (multiple shooting; Bock, 1987).
The initial states are optimised for each set of parameters, and the derivatives are projected
accordingly (variable projection; Kaufman, BIT 15, 1975).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from typing import Any, Protocol

import numpy as np

from splitband.data import Record
from splitband.runtime import deadlines
from splitband.runtime.arrays import Array
from splitband.simulators.parameters import Parameters, Point, Response
from splitband.simulators.sources import failure
from splitband.simulators.starting import origin

BAD = 1e3
"""Residual of a failed run, in deviations of a channel, and limit of all others. By eye."""
STATE_STEP = 1e-6
"""Relative step of finite differences with respect to a state. By eye."""
WORTH_A_ROUND = 1e-3
"""Smallest relative reduction of the squared error for which the search for a window's state goes
on. By eye."""
_ROUNDS = 6
"""Most iterations of a search for a window's state. By eye."""
_DAMPINGS = (1e-8, 1e-4, 1e-1, 1e1)
"""Levenberg-Marquardt dampings that are tried in an iteration, relative to the trace. By eye."""


class Adjustable(Protocol):
    """Define the interface of simulators whose parameters can be fitted."""

    @property
    def known(self) -> Parameters:
        """Return its parameters."""

    def fixed(self, values: Mapping[str, float]) -> Any:
        """Return a copy with some parameters set to these values."""

    def precise(self) -> Any:
        """Return the simulator for the last steps of a fit and for standard errors."""

    def digest(self) -> str:
        """Return an identifier of the response, without the values of parameters."""

    @property
    def states(self) -> int:
        """Return the number of states that a run can start from; 0 for a black box."""

    @property
    def difference(self) -> float:
        """Return the finite-difference step, as a share of a parameter's range."""

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> Sequence[Response]:
        """Return the responses at several neighbouring points; `u` is `(time, nu)`."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """Hold the times, measured samples and inputs of a record.

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
        """Return the experiment of a record for a simulator, on whose clock its times are."""
        begin = origin(simulator, record.start)
        time = begin + record.sampling_time * np.arange(len(record), dtype=np.float64)
        return cls(time, record.seen, record.u)

    def part(self, begin: int, end: int) -> Experiment:
        """Return the samples from `begin` to before `end`."""
        u = None if self.u is None else self.u[begin:end]
        return Experiment(self.time[begin:end], self.y[begin:end].copy(), u)


def fit_key(simulator: Adjustable, experiments: Sequence[Experiment], starts: int) -> str:
    """Return a digest of the simulator, experiments and number of starts of a fit."""
    said = sha256(f"{simulator.digest()} {simulator.known} {starts}".encode())
    for array in (a for e in experiments for a in (e.time, e.y, e.u)):
        said.update(b"none" if array is None else np.ascontiguousarray(array).tobytes())
    return said.hexdigest()


@dataclass(eq=False)
class Window:
    """Hold a part of a record that is simulated from its own initial state.

    Attributes
    ----------
    record : Number of the record.
    part : The samples.
    state : Latest estimate of the initial state, `(nx,)`; None at the beginning of a record, where
        parameters define it.
    slope : Derivatives of the residuals with respect to the state, `(residuals, nx)`.
    follows : State and places at the last Jacobian, and the derivative of the optimal state with
        respect to the places, `(nx, places)`.
    """

    record: int
    part: Experiment
    state: Array | None = None
    slope: Array | None = None
    follows: tuple[Array, Array, Array] | None = None

    def moved(self, places: Array) -> None:
        """Move the state to where it should be at other places, as the start of the next search."""
        if self.follows is not None:
            state, before, slope = self.follows
            self.state = state + slope @ (places - before)


class Shooting:
    """Compare a simulator with records. Places are relative positions of parameters, 0 to 1.

    Parameters
    ----------
    simulator, experiments : The simulator to fit, and the data of the records.
    scale : Deviation of each channel, `(ny,)`, the unit of residuals.

    Attributes
    ----------
    names : Parameter of each place: those that all records share, then initial values by record.
    failure : Message of the last failed run.
    """

    def __init__(self, simulator: Adjustable, experiments: Sequence[Experiment], scale: Array):
        self.simulator, self.experiments, self.scale = simulator, experiments, scale
        known = simulator.known
        self.names = [(name, -1) for name in known.shared]
        self.names += [(name, r) for r in range(len(experiments)) for name in known.initial]
        self.failure = ""
        self.windows: list[Window] = []

    @property
    def longest(self) -> int:
        """Return the number of samples of the longest record."""
        return max(len(each.y) for each in self.experiments)

    def values(self, places: Array, record: int) -> dict[str, float]:
        """Return every parameter's value for a record."""
        known = self.simulator.known
        found = known.middle()
        for (name, of), place in zip(self.names, places, strict=True):
            if of in (-1, record):
                found[name] = known.at(name, float(place))
        return found

    def respond(self, part: Experiment, points: Sequence[Point]) -> list[Response]:
        """Return the simulator's responses at several points; NaN for all if the call fails."""
        deadlines.check()
        try:
            with np.errstate(all="ignore"):
                return [*self.simulator.respond(part.time, part.u, points)]
        except deadlines.DeadlineError:
            raise
        except Exception as error:
            self.failure = failure(error)
            nothing = np.full(part.y.shape, np.nan)
            return [(nothing, np.full((len(part.y), self.simulator.states), np.nan))] * len(points)

    def divide(self, length: int, places: Array) -> None:
        """Divide every record into windows of at most `length` samples.

        The search for a window's state starts from the final state of the window before. A black
        box can only run from the beginning of a record: it has a single window there.
        """
        self.windows = []
        for r, experiment in enumerate(self.experiments):
            samples = len(experiment.y)
            if not self.simulator.states:
                self.windows.append(Window(r, experiment.part(0, min(length, samples))))
                continue
            count = -(-samples // length)
            cuts = np.linspace(0, samples, count + 1).round().astype(int)
            state = None
            for begin, end in pairwise(cuts):
                window = Window(r, experiment.part(begin, min(end + 1, samples)), state)
                if end < samples:  # the last sample also begins the next window, and counts there
                    window.part.y[-1] = np.nan
                self.windows.append(window)
                self._settle(window, places)
                _, states = self.respond(window.part, [self._point(window, places)])[0]
                last = states[-1]
                if np.isfinite(last).all():
                    state = last.copy()
                elif state is None:
                    state = np.zeros(self.simulator.states)

    def residuals(self, places: Array) -> Array:
        """Return all residuals in deviations of the channels, `(samples * ny,)`, 0 in gaps."""
        found = []
        for window in self.windows:
            window.moved(places)
            found.append(self._settle(window, places))
        return np.concatenate(found)

    def jacobian(self, places: Array) -> Array:
        """Return the derivatives of the residuals, `(samples * ny, places)`.

        They allow for the change of the windows' optimal states with the parameters.
        """
        blocks = []
        for window in self.windows:
            block = self._slopes(window, places)
            if window.state is not None and window.slope is not None:
                u, s, vt = np.linalg.svd(window.slope, full_matrices=False)
                kept = s > 1e-9 * max(s.max(initial=0.0), 1e-300)
                u, s, vt = u[:, kept], s[kept], vt[kept]
                told = u.T @ block
                window.follows = window.state, places.copy(), -(vt.T / s) @ told
                block = block - u @ told
            blocks.append(block)
        return np.concatenate(blocks)

    def _point(self, window: Window, places: Array, state: Array | None = None) -> Point:
        return self.values(places, window.record), window.state if state is None else state

    def _errors(self, window: Window, y: Array) -> Array:
        errors = (y - window.part.y) / self.scale
        bad = ~np.isfinite(y)
        errors = np.where(bad, BAD, np.clip(errors, -BAD, BAD))
        return np.asarray(np.where(np.isnan(window.part.y), 0.0, errors).ravel())

    def _slopes(self, window: Window, places: Array) -> Array:
        """Return the derivatives of a window's residuals for a fixed initial state."""
        if not len(places):
            return np.zeros((window.part.y.size, 0))
        step = self.simulator.difference
        steps = np.where(places + step <= 1, step, -step)
        points = [self._point(window, places)]
        concerned = [i for i, (_, r) in enumerate(self.names) if r in (-1, window.record)]
        for i in concerned:
            moved = places.copy()
            moved[i] += steps[i]
            points.append(self._point(window, moved))
        responses = [self._errors(window, y) for y, _ in self.respond(window.part, points)]
        block = np.zeros((len(responses[0]), len(places)))
        for i, response in zip(concerned, responses[1:], strict=True):
            block[:, i] = _difference(responses[0], response, steps[i])
        return block

    def _settle(self, window: Window, places: Array) -> Array:
        """Find the best state of a window and return its residuals (Levenberg, Marquardt)."""
        if window.state is None:
            y, _ = self.respond(window.part, [self._point(window, places)])[0]
            return self._errors(window, y)
        x, gained = window.state, 1.0
        for _ in range(_ROUNDS):
            responses, steps = self._around(window, places, x)
            errors = [self._errors(window, y) for y, _ in responses]
            pairs = zip(errors[1:], steps, strict=True)
            slope = np.stack([_difference(errors[0], e, step) for e, step in pairs], axis=1)
            found = self._step(window, places, (x, errors[0], slope), steps / STATE_STEP)
            window.state, window.slope, best = x, slope, errors[0]
            if found is None:
                break
            gained = 1 - np.sum(found[1] ** 2) / np.sum(best**2)
            x, best = found
            window.state = x
            if gained < WORTH_A_ROUND:
                break
        return best

    def _around(self, window: Window, places: Array, x: Array) -> tuple[list[Response], Array]:
        """Return the responses at a state and at its neighbours, and their distances."""
        steps = STATE_STEP * np.maximum(np.abs(x), self.sizes)
        points = [self._point(window, places, x)]
        points += [self._point(window, places, x + step * unit)
                   for step, unit in zip(steps, np.eye(len(x)), strict=True)]  # fmt: skip
        return self.respond(window.part, points), steps

    def _step(
        self, window: Window, places: Array, at: tuple[Array, Array, Array], size: Array
    ) -> tuple[Array, Array] | None:
        """Return a better state and its residuals, or None if no step lowers the error.

        `at` holds the state, its residuals and their derivatives.
        """
        x, r, slope = at
        scaled = slope * size
        normal, power = scaled.T @ scaled, float(np.sum(r**2))
        for damping in _DAMPINGS:
            damped = normal + damping * (np.trace(normal) + 1e-12) * np.eye(len(x))
            step = -size * np.linalg.solve(damped, scaled.T @ r)
            y, _ = self.respond(window.part, [self._point(window, places, x + step)])[0]
            errors = self._errors(window, y)
            if np.sum(errors**2) < (1 - 1e-9) * power:
                return x + step, errors
            if np.abs(step / size).max() < 1e-8:
                return None
        return None

    @property
    def sizes(self) -> Array:
        """Return the typical magnitude of each state, the unit of steps."""
        initial = [w.state for w in self.windows if w.state is not None]
        if not initial:
            return np.full(self.simulator.states, 1e-3)
        return np.maximum(np.abs(np.stack(initial)).mean(axis=0), 1e-3)


def _difference(at: Array, beside: Array, step: float) -> Array:
    """Return the difference quotient of residuals; 0 where a run failed."""
    whole = (np.abs(at) < BAD) & (np.abs(beside) < BAD)
    return np.asarray(np.where(whole, (beside - at) / step, 0.0))
