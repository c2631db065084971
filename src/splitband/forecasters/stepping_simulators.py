"""Run simulators sample by sample: output given from outside, computed ahead, or integrated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitband.forecasters.prediction import Known
from splitband.forecasters.stepping import NotSteppedError, Part, Recursion, State
from splitband.runtime.arrays import Array
from splitband.simulators.adjusted import Adjusted
from splitband.simulators.shooting import Experiment
from splitband.simulators.starting import origin


class Given(Part):
    """Calibrate a simulator's output, which is given with each sample.

    `gain`, `offset`: of the calibration, `(ny,)` each. `trajectory`: see `Forecaster.trajectory`.
    """

    simulated = True

    def __init__(self, gain: Array, offset: Array, trajectory: Callable[[Known], Array]) -> None:
        self.gain, self.offset, self.trajectory = gain, offset, trajectory

    def initial(self, known: Known | None) -> State:
        """Return an empty state."""
        return {}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the calibrated output."""
        return state, (y_sim[: 1 + ahead] * self.gain + self.offset)[..., None]

    def simulated_over(self, known: Known, ahead: int) -> Array | None:
        """Return the output before calibration; its last known sample is held beyond its end."""
        known = replace(known, steps=0)
        if ahead and known.y_sim is not None and len(known.y_sim) > len(known.y):
            known = replace(known, steps=ahead)
        values = (self.trajectory(known) - self.offset) / np.where(self.gain, self.gain, 1.0)
        return np.concatenate([values, np.repeat(values[-1:], ahead, axis=0)])


MARGIN = 30
"""Unused samples at the end of a run, where splines and solvers depend on its length. By eye."""


class RunAhead(Part):
    """Run a simulator ahead, over twice the time whenever its output does not reach far enough.

    Recorded output, which has an end, is read only as far as needed.

    `trajectory`: see `Forecaster.trajectory`.
    """

    def __init__(self, trajectory: Callable[[Known], Array]) -> None:
        self.trajectory = trajectory

    def initial(self, known: Known | None) -> State:
        """Return a sample count of 0, after a run over the history, if there is one."""
        if known is not None:
            self.known = known
            self.output = self._run(len(known.y), 2 * len(known.y) + MARGIN)
        return {"samples": 0}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the output at the sample and at `ahead` more."""
        at, end = state["samples"], state["samples"] + 1 + ahead
        if end + MARGIN > len(self.output):
            self.output = self._run(end, 2 * end + MARGIN)
        return {"samples": at + 1}, self.output[at:end, :, None]

    def _run(self, least: int, most: int) -> Array:
        """Return the output of `most` samples or, if it ends earlier, of `least`."""
        begun = len(self.known.y)
        try:
            return self.trajectory(replace(self.known, steps=most - begun))
        except ValueError:
            return self.trajectory(replace(self.known, steps=max(least - begun, 0)))


@dataclass(frozen=True, eq=False)
class Clock:
    """Compute the times of samples.

    Attributes
    ----------
    start, step : Time of the first training sample, and sampling time, in s.
    u : Inputs of the training record, from its first sample on.
    simulator : The one that runs at these times.
    """

    start: float
    step: float
    u: Array | None
    simulator: Any

    def times(self, first: float, samples: int) -> Array:
        """Return the times of samples in s; `first` is counted from the first training sample."""
        return np.asarray(self.start + self.step * (first + np.arange(samples, dtype=np.float64)))

    def reaches(self, known: Known) -> bool:
        """Return whether all inputs since the first sample of the training record are known."""
        begin, most = known.begin, np.inf if self.u is None else len(self.u)
        return begin is not None and begin % 1 == 0 and 0 <= begin <= most

    def place(self, known: Known) -> float:
        """Return where a history begins, in samples after the first training sample."""
        if known.begin is not None:
            return known.begin
        start = None if known.grid is None else known.grid.start
        return (origin(self.simulator, start) - self.start) / self.step


class Integrated(Part):
    """Integrate a fitted simulator sample by sample, from the first state of the training record.

    The simulator has a method `advance` like `Ode`.
    """

    def __init__(self, name: str, adjusted: Adjusted, clock: Clock) -> None:
        self.name, self.adjusted, self.clock = name, adjusted, clock

    def initial(self, known: Known | None) -> State:
        """Return the state at the last sample before the history; None before the first of all.

        Raises NotSteppedError where the inputs before it are not known: the initial state is then
        estimated from the history, and changes with each sample.
        """
        if known is None or not self.clock.reaches(known):
            raise NotSteppedError(f"{self.name} begins in a state that its history tells")
        begin, u = int(known.begin or 0), self.clock.u
        return {"now": self.run(None, 0.0, begin, None if u is None else u[:begin])}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the channels at the sample and, with the same inputs, at `ahead` more."""
        inputs = u if len(u) else None
        now = later = self.moved(state["now"], inputs)
        rows = [now["y"]]
        for _ in range(ahead):
            later = self.moved(later, inputs)
            rows.append(later["y"])
        return {"now": now}, np.stack(rows)[..., None]

    def run(self, x: Array | None, first: float, samples: int, u: Array | None) -> State | None:
        """Return the state at the last of some samples, of which the first has the state `x`."""
        if not samples:
            return None
        if samples == 1:  # `advance` needs two times, even for the first
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
    """Run a fitted simulator alone: a forecast starts from a state estimated on the last samples.

    `memory`: the number of these samples; 0 if the state follows from the inputs.
    """

    def __init__(self, simulator: Integrated, memory: int, ny: int, nu: int) -> None:
        self.simulator, self.memory, self.ny, self.nu = simulator, memory, ny, nu

    def initial(self, known: Known | None = None) -> State:
        """Return the state before a history.

        Raises NotSteppedError where the state has to be estimated from all samples.
        """
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
        """Return the state after a sample, and its forecast if it was not measured."""
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
        """Return the state at the last sample, estimated on the samples in memory."""
        y, u = state["y"], state["u"] if self.nu else None
        first = state["next"] - len(y)
        history = Experiment(self.simulator.clock.times(first, len(y)), y, u)
        now = self.simulator.run(self.simulator.adjusted.beginning(history), first, len(y), u)
        assert now is not None
        return now
