"""Run an instance of an FMU over the samples of a record, with outputs for the samples' inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from ctypes import POINTER, c_double
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.base import Hold
from splitband.simulators.fmu_unit import REAL, WHOLE, Unit

RELATIVE_TOLERANCE = 1e-8
"""Tolerance of the solver for model exchange, relative to the nominal values of the states: the
square of the finite-difference step, `fmu.SHORT`. Rounding."""
MOST_STEPS = 100_000
"""Largest number of solver steps between two samples. Bounds the time."""
MOST_EVENTS = 10_000
"""Largest number of events between two samples, and of updates at one event. Bounds the time."""
NEAR = 1e-9
"""Distance of equal times, as a share of the sampling time. Rounding."""


@dataclass(frozen=True, eq=False)
class FmuRun:
    """The arguments of a run.

    `time`: evenly spaced, in s, two at least; `u`: inputs, `(time, inputs)`; `values`: start values
    of variables; `outputs`, `inputs`: names of the variables to read, and of the columns of `u`;
    `hold`: course of inputs between samples in model exchange; `substeps`: communication steps of
    co-simulation from one sample to the next; `before`: whether outputs are read before the inputs
    of a sample are set, as the FMU refuses it afterwards.
    """

    time: Array
    u: Array
    values: Mapping[str, float]
    outputs: Sequence[str]
    inputs: Sequence[str]
    hold: Hold = "linear"
    substeps: int = 1
    before: bool = False

    @property
    def step(self) -> float:
        """Return the sampling time in s."""
        return float(self.time[1] - self.time[0])

    @property
    def length(self) -> float:
        """Return the communication step in s."""
        return self.step / self.substeps


class Access:
    """Access to variables of an instance, of several types at once."""

    def __init__(self, unit: Unit, instance: Any, names: Sequence[str]) -> None:
        self.count = len(names)
        self.groups: dict[str, tuple[list[int], list[int]]] = {}
        for i, name in enumerate(names):
            kind = str(unit.by_name[name].type)
            if kind == "Enumeration":
                kind = "Int64" if unit.version == 3 else "Integer"
            places, references = self.groups.setdefault(kind, ([], []))
            places.append(i)
            references.append(unit.by_name[name].valueReference)
        self.instance = instance

    def set(self, values: Array) -> None:
        """Set the variables to these values, `(count,)`."""
        for kind, (places, references) in self.groups.items():
            numbers = [float(values[i]) for i in places]
            whole = kind not in REAL
            setter = getattr(self.instance, f"set{kind}")
            setter(references, [*map(round, numbers)] if whole else numbers)

    def get(self) -> Array:
        """Return the values, `(count,)`."""
        values = np.empty(self.count)
        for kind, (places, references) in self.groups.items():
            values[places] = [*getattr(self.instance, f"get{kind}")(references)]
        return values


def check_inputs(unit: Unit, names: Sequence[str], u: Array, what: str = "inputs") -> None:
    """Raise ValueError for invalid values of an integer or a Boolean variable."""
    for name, column in zip(names, u.T, strict=True):
        kind = unit.by_name[name].type
        whole = kind == "Boolean" or kind in WHOLE
        wrong = column != np.round(column) if whole else np.zeros(len(column), dtype=bool)
        if kind == "Boolean":
            wrong |= (column != 0) & (column != 1)
        if wrong.any():
            raise InputError(
                f"{what} must hold {'0 and 1' if kind == 'Boolean' else 'whole numbers'} for "
                f"{name} of {unit.path}, which is of the type {kind}: got {column[wrong][0]:g}"
            )


def initialise(unit: Unit, instance: Any, task: FmuRun, inputs: Access, end: float) -> None:
    """Set start values and the first inputs, and leave the initialisation."""
    from fmpy import simulation as by_fmpy  # noqa: PLC0415  the optional extra

    def apply(values: Mapping[str, float], settable: Any) -> dict[str, float]:
        left: dict[str, float] = by_fmpy.apply_start_values(
            instance, unit.description, dict(values), settable=settable
        )
        return left

    begin, how = float(task.time[0]), {}
    if unit.version == 2:
        instance.setupExperiment(startTime=begin, stopTime=end)
    else:
        how = {"startTime": begin, "stopTime": end}
    left = apply(task.values, by_fmpy.settable_in_instantiated)
    instance.enterInitializationMode(**how)
    left = apply(left, by_fmpy.settable_in_initialization_mode)
    inputs.set(task.u[0])
    instance.exitInitializationMode()
    if left:
        raise InputError(f"these variables of {unit.path} cannot be set: {', '.join(left)}")


class _Inputs:
    """The inputs of a run by model exchange; a solver calls `apply`."""

    def __init__(self, unit: Unit, instance: Any, task: FmuRun) -> None:
        variables = [] if task.hold == "zoh" else [unit.by_name[name] for name in task.inputs]
        jumping = "discrete", "tunable"
        smooth = [
            i for i, v in enumerate(variables) if v.type in REAL and v.variability not in jumping
        ]
        self.all = Access(unit, instance, task.inputs)
        self.smooth = Access(unit, instance, [task.inputs[i] for i in smooth])
        self.time, self.step, self.u = task.time, task.step, task.u
        self.lines = self.u[:, smooth]
        self.jumps = np.delete(self.u, smooth, axis=1)

    def apply(self, time: float, **_: Any) -> None:
        """Set the inputs with linear interpolation between samples."""
        if not self.smooth.count:
            return
        place = min(max((time - self.time[0]) / self.step, 0.0), len(self.lines) - 1.0)
        n = min(int(place), len(self.lines) - 2)
        self.smooth.set(self.lines[n] + (place - n) * (self.lines[n + 1] - self.lines[n]))


class Exchange:
    """An FMU for model exchange, integrated by CVODE (Hindmarsh et al., ACM TOMS 31, 2005)."""

    def __init__(self, unit: Unit, instance: Any, task: FmuRun) -> None:
        self.unit, self.instance, self.task = unit, instance, task
        self.inputs = _Inputs(unit, instance, task)
        initialise(unit, instance, task, self.inputs.all, float(task.time[-1]))
        self.event_time = np.inf
        self._update()
        self.solver = self._solver()
        self.touched = self._touches()

    def run(self) -> Array:
        """Return the outputs, `(time, outputs)`, at samples with events those after the events."""
        outputs = Access(self.unit, self.instance, self.task.outputs)
        samples = np.empty((len(self.task.time), outputs.count))
        for n in range(len(samples)):
            self._integrate(n)
            samples[n] = outputs.get()
        return samples

    def _integrate(self, n: int) -> None:
        """Go on to sample n, and set its inputs."""
        before = max(n - 1, 0)
        now, end = float(self.task.time[before]), float(self.task.time[n])
        near, instance = max(NEAR * self.task.step, 8 * np.spacing(abs(end))), self.instance
        for _ in range(MOST_EVENTS):
            if now >= end - near and self.event_time > end + near and not self.touched:
                break
            event, stop, touched = False, min(end, self.event_time), self.touched
            if touched:  # the solver misses an indicator that leaves 0
                _, _, now = self.solver.step(now, now + near)
                event = True
            elif stop > now + near:
                event, _, now = self.solver.step(now, stop)
            if self.event_time <= now + near:
                event, now = True, max(now, self.event_time)
            self._set_time(now)
            if self.unit.description.modelExchange.needsCompletedIntegratorStep:
                event |= bool(instance.completedIntegratorStep()[0])
            if event:
                self._event(now)
                self.touched &= not touched
        else:
            raise InputError(f"the FMU {self.unit.path} has no end of events at {now:g} s")
        self._set_time(end)
        if (self.inputs.jumps[n] != self.inputs.jumps[before]).any():
            self._event(end, n)

    def _event(self, now: float, n: int | None = None) -> None:
        """Handle an event, and set the inputs of sample n."""
        self.instance.enterEventMode()
        if n is not None:
            self.inputs.all.set(self.inputs.u[n])
        self._update()
        self.solver.reset(now)
        self.touched = self._touches()

    def _touches(self) -> bool:
        """Return whether an event indicator is 0: an event may follow at once."""
        z = np.ones(self.solver.nz)
        if self.solver.nz:
            self.instance.getEventIndicators(z.ctypes.data_as(POINTER(c_double)), len(z))
        return bool((z == 0).any())

    def _update(self) -> None:
        """Update the discrete states, and find the time of the next event."""
        instance, second = self.instance, self.unit.version == 2
        update = instance.newDiscreteStates if second else instance.updateDiscreteStates
        for _ in range(MOST_EVENTS):
            again, ended, _, _, defined, at = update()
            if ended:
                raise InputError(f"the FMU {self.unit.path} has ended its simulation")
            if not again:
                break
        self.event_time = at if defined else np.inf
        instance.enterContinuousTimeMode()

    def _set_time(self, time: float) -> None:
        """Set the time and the inputs, also for derivatives, for which FMPy does not set inputs."""
        self.instance.setTime(time)
        self.inputs.apply(time)

    def _solver(self) -> Any:
        from fmpy.sundials import CVodeSolver  # noqa: PLC0415  the optional extra

        instance, description = self.instance, self.unit.description
        second, experiment = self.unit.version == 2, description.defaultExperiment
        tolerance = None if experiment is None else experiment.tolerance
        return CVodeSolver(
            nx=description.numberOfContinuousStates,
            nz=description.numberOfEventIndicators,
            get_x=instance.getContinuousStates,
            set_x=instance.setContinuousStates,
            get_dx=instance.getDerivatives if second else instance.getContinuousStateDerivatives,
            get_z=instance.getEventIndicators,
            get_nominals=instance.getNominalsOfContinuousStates,
            set_time=self._set_time,
            input=self.inputs,
            startTime=float(self.task.time[0]),
            maxStep=self.task.step,
            relativeTolerance=min(RELATIVE_TOLERANCE, float(tolerance or 1.0)),
            maxNumSteps=MOST_STEPS,
        )


class UnreadableError(Exception):
    """Outputs are not readable after inputs were set, without a step."""


class CoSimulation:
    """An FMU for co-simulation, stepped from sample to sample, and `spare` steps further."""

    def __init__(self, unit: Unit, instance: Any, task: FmuRun, spare: int = 1) -> None:
        self.unit, self.instance, self.task = unit, instance, task
        self.inputs = Access(unit, instance, task.inputs)
        self.outputs = Access(unit, instance, task.outputs)
        self.now = float(task.time[0])
        initialise(unit, instance, task, self.inputs, float(task.time[-1]) + spare * task.step)

    def run(self, late: NDArray[np.bool_]) -> Array:
        """Return the outputs, `(time, outputs)`, the `late` ones after the step from a sample.

        Raises UnreadableError if the others are readable only before inputs are set.
        """
        samples = np.empty((len(self.task.time), self.outputs.count))
        for n in range(len(samples)):
            samples[n] = self.drive(n)
            further = n + 1 < len(samples)
            self.go_on(int(further or late.any()))
            if late.any():
                samples[n, late] = self.outputs.get()[late]
            self.go_on(self.task.substeps - 1 if further else 0)
        return samples

    def drive(self, n: int) -> Array:
        """Set the inputs of a sample, and return the outputs, see `show`."""
        self.now = float(self.task.time[n])
        return self.show(self.task.u[n])

    def show(self, u: Array) -> Array:
        """Set inputs, and return the outputs afterwards, or before it for `FmuRun.before`."""
        if self.task.before:
            outputs = self.outputs.get()
            self.inputs.set(u)
            return outputs
        self.inputs.set(u)
        try:
            return self.outputs.get()
        except Exception as error:
            raise UnreadableError from error

    def after(self, u: Array, share: float = 1.0) -> Array:
        """Set inputs, make a share of a communication step, and return the outputs."""
        self.inputs.set(u)
        self.step(share * self.task.length)
        return self.outputs.get()

    def go_on(self, count: int) -> None:
        """Make communication steps."""
        for _ in range(count):
            self.step(self.task.length)

    def step(self, length: float) -> None:
        """Make a step of this length in s."""
        try:
            done = self.instance.doStep(self.now, length)
        except Exception as error:
            declared = self.unit.own_step
            raise InputError(
                f"the FMU {self.unit.path} stopped at {self.now:g} s, in a step of {length:g} s: "
                f"{error}; it declares "
                + ("no step" if declared is None else f"a step of {declared:g} s")
                + ", and step (--simulator-step) sets the step"
            ) from error
        if done is not None and (done[1] or done[2]):  # of FMI 3: ended, or returned early
            raise InputError(f"the FMU {self.unit.path} stopped at {done[3]:g} s")
        self.now += length
