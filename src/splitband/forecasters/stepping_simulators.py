"""Define simulators sample by sample: given from outside, run ahead, or integrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitband.data.timing import seconds_of
from splitband.forecasters.known import Known
from splitband.forecasters.stepping import NotSteppedError, Part, Recursion, State
from splitband.runtime.arrays import Array
from splitband.simulators.adjusted import Adjusted
from splitband.simulators.shooting import Experiment


class Given(Part):
    """Take a simulator's output, which comes with each sample, with its calibration, `(ny,)` each.

    `trajectory`: the calibrated output over what is known, see `Forecaster.trajectory`.
    """

    simulated = True

    def __init__(self, gain: Array, offset: Array, trajectory: Callable[[Known], Array]) -> None:
        self.gain, self.offset, self.trajectory = gain, offset, trajectory

    def initial(self, known: Known | None) -> State:
        """Return nothing: all is given."""
        return {}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the calibrated output."""
        return state, (y_sim[: 1 + ahead] * self.gain + self.offset)[..., None]

    def simulated_over(self, known: Known, ahead: int) -> Array | None:
        """Return the output as it comes; after the last sample that is known it stands still."""
        known = replace(known, steps=0)
        if ahead and known.y_sim is not None and len(known.y_sim) > len(known.y):
            known = replace(known, steps=ahead)
        values = (self.trajectory(known) - self.offset) / np.where(self.gain, self.gain, 1.0)
        return np.concatenate([values, np.repeat(values[-1:], ahead, axis=0)])


MARGIN = 30
"""Samples at the end of a run that are not used: splines and solvers end differently there.
By eye."""


class RunAhead(Part):
    """Run a simulator over twice the time whenever its output does not reach far enough.

    Recorded output, which ends somewhere, is read as far as it is asked for.

    `trajectory`: its output over what is known, see `Forecaster.trajectory`.
    """

    def __init__(self, trajectory: Callable[[Known], Array]) -> None:
        self.trajectory = trajectory

    def initial(self, known: Known | None) -> State:
        """Return the number of samples so far."""
        if known is not None:
            self.known = known
            self.output = self._run(len(known.y), 2 * len(known.y) + MARGIN)
        return {"samples": 0}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the output of the sample, and of `ahead` more."""
        at, end = state["samples"], state["samples"] + 1 + ahead
        if end + MARGIN > len(self.output):
            self.output = self._run(end, 2 * end + MARGIN)
        return {"samples": at + 1}, self.output[at:end, :, None]

    def _run(self, least: int, most: int) -> Array:
        """Return the output of the most samples, or where it ends before, of the least."""
        begun = len(self.known.y)
        try:
            return self.trajectory(replace(self.known, steps=most - begun))
        except ValueError:
            return self.trajectory(replace(self.known, steps=max(least - begun, 0)))


@dataclass(frozen=True, eq=False)
class Clock:
    """Say where samples are in time.

    Attributes
    ----------
    start, step : Seconds of the training record's first sample, and between two.
    u : Inputs of the training record, from its first sample on.
    """

    start: float
    step: float
    u: Array | None

    def times(self, first: float, samples: int) -> Array:
        """Return the seconds of samples, the first of them counted from the training record's."""
        return np.asarray(self.start + self.step * (first + np.arange(samples, dtype=np.float64)))

    def reaches(self, known: Known) -> bool:
        """Return whether all inputs from the training record's first sample on are known."""
        begin, most = known.begin, np.inf if self.u is None else len(self.u)
        return begin is not None and begin % 1 == 0 and 0 <= begin <= most

    def place(self, known: Known) -> float:
        """Return where a history begins, in samples after the training record's first one."""
        if known.begin is not None:
            return known.begin
        start = None if known.grid is None else known.grid.start
        return (seconds_of(start) - self.start) / self.step


class Integrated(Part):
    """Run a fitted simulator on from its state, from the training record's first one on.

    It has a method `advance` as `Ode` has it.
    """

    def __init__(self, name: str, adjusted: Adjusted, clock: Clock) -> None:
        self.name, self.adjusted, self.clock = name, adjusted, clock

    def initial(self, known: Known | None) -> State:
        """Return the state of the last sample before the history; None for the very first one.

        Raises NotSteppedError where the inputs before it are not known: what the history tells of
        the first state changes with each sample then.
        """
        if known is None or not self.clock.reaches(known):
            raise NotSteppedError(f"{self.name} begins in a state that its history tells")
        begin, u = int(known.begin or 0), self.clock.u
        return {"now": self.run(None, 0.0, begin, None if u is None else u[:begin])}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the channels of the sample, and of `ahead` more, which then have no inputs."""
        inputs = u if len(u) else None
        now = later = self.moved(state["now"], inputs)
        rows = [now["y"]]
        for _ in range(ahead):
            later = self.moved(later, inputs)
            rows.append(later["y"])
        return {"now": now}, np.stack(rows)[..., None]

    def run(self, x: Array | None, first: float, samples: int, u: Array | None) -> State | None:
        """Return the state at the last of some samples, which begin in the state `x`."""
        if not samples:
            return None
        if samples == 1:  # an interval is needed to be asked about its beginning
            u = None if u is None else np.concatenate([u, u])
        found = self.adjusted.advance(x, self.clock.times(first, max(samples, 2)), u)
        return self._state(found, samples - 1, first + samples - 1, u) | (
            {"taken": 0} if samples == 1 else {}
        )

    def moved(self, now: State | None, u: Array | None) -> State:
        """Return the state at the next sample, whose inputs are `u`."""
        if now is None:
            begun = self.run(None, 0.0, 1, None if u is None else u[None])
            assert begun is not None
            return begun
        inputs = None if u is None else np.stack([now["u"], u])
        times = self.clock.times(now["at"], 2)
        found = self.adjusted.advance(now["x"], times, inputs, now["taken"])
        return self._state(found, 1, now["at"] + 1, inputs)

    def _state(self, found: Any, row: int, at: float, u: Array | None) -> State:
        y, x, taken = found
        last = None if u is None else u[row]
        return {"x": x[row], "y": y[row], "u": last, "at": at, "taken": taken}


class FromMemory(Recursion):
    """Run a fitted simulator by itself: a forecast begins in the state that the last samples tell.

    `memory`: how many samples tell the state; 0 for none, as the inputs do.
    """

    def __init__(self, simulator: Integrated, memory: int, ny: int, nu: int) -> None:
        self.simulator, self.memory, self.ny, self.nu = simulator, memory, ny, nu

    def initial(self, known: Known | None = None) -> State:
        """Return the state before a history; raises NotSteppedError where all samples tell it."""
        if known is None or not (self.memory or self.simulator.clock.reaches(known)):
            raise NotSteppedError(f"{self.simulator.name} asks for all samples of its history")
        anchored = self.simulator.clock.reaches(known)
        return {
            "part": self.simulator.initial(known) if anchored else None,
            "run": None,
            "rows": 0,
            "next": self.simulator.clock.place(known),
            "y": np.empty((0, self.ny)),
            "u": np.empty((0, self.nu)),
        }

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Return the state after a sample, and the forecast of one that was not measured."""
        part, run, rows = state["part"], state["run"], state["rows"]
        if part is not None:
            part, _ = self.simulator.row(part, u, y_sim, 0)
        missing, predicted = np.isnan(y), y
        if missing.any():
            inputs = u if self.nu else None
            if run is None and part is not None:
                run = part["now"]
            else:
                run = self.simulator.moved(run or self._told(state), inputs)
            predicted = run["y"]
        begin = max(len(state["y"]) + 1 - self.memory, 0)
        new = {
            "part": part if not self.memory or rows < self.memory else None,
            "run": run if missing.all() else None,
            "rows": rows + 1,
            "next": state["next"] + 1,
            "y": np.concatenate([state["y"], y[None]])[begin:],
            "u": np.concatenate([state["u"], u[None]])[begin:],
        }
        return new, predicted, True

    def _told(self, state: State) -> State:
        """Return the state at the last sample, as the samples before it tell."""
        y, u = state["y"], state["u"] if self.nu else None
        first = state["next"] - len(y)
        history = Experiment(self.simulator.clock.times(first, len(y)), y, u)
        now = self.simulator.run(self.simulator.adjusted.beginning(history), first, len(y), u)
        assert now is not None
        return now
