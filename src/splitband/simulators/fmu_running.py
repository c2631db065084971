"""Run an instance of an FMU over the samples of a record: what is read belongs to their inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from ctypes import POINTER, c_double
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.fmu_unit import EXCHANGE, REAL, WHOLE, Unit

RELATIVE_TOLERANCE = 1e-8
"""Of the solver for model exchange, relative to the nominal values of the states. By eye."""
MOST_STEPS = 100_000
"""Most steps of that solver between two samples. Bounds the time."""
MOST_EVENTS = 10_000
"""Most events between two samples, and most updates at one event. Bounds the time."""
NEAR = 1e-9
"""Times this close, as a share of the sampling time, count as the same. Rounding."""


@dataclass(frozen=True, eq=False)
class Task:
    """Say what a run is given, and what it returns.

    `time`: evenly spaced, in s, two at least; `u`: inputs, `(time, inputs)`; `values`: start values
    of variables; `outputs`, `inputs`: names of the variables to read, and of those that take `u`;
    `held`: whether model exchange holds inputs until the next sample, or interpolates them;
    `substeps`: communication steps of co-simulation from one sample to the next.
    """

    time: Array
    u: Array | None
    values: Mapping[str, float]
    outputs: Sequence[str]
    inputs: Sequence[str]
    held: bool = False
    substeps: int = 1

    @property
    def step(self) -> float:
        """Return the sampling time in s."""
        return float(self.time[1] - self.time[0])

    @property
    def length(self) -> float:
        """Return the communication step in s."""
        return self.step / self.substeps


class Access:
    """Read and set variables of an instance, of several types at once."""

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
            given = [float(values[i]) for i in places]
            whole = kind not in REAL
            setter = getattr(self.instance, f"set{kind}")
            setter(references, [*map(round, given)] if whole else given)

    def get(self) -> Array:
        """Return the values, `(count,)`."""
        found = np.empty(self.count)
        for kind, (places, references) in self.groups.items():
            found[places] = [*getattr(self.instance, f"get{kind}")(references)]
        return found


def check_inputs(unit: Unit, names: Sequence[str], u: Array, what: str = "inputs") -> None:
    """Raise ValueError for values that an integer or a Boolean variable cannot take."""
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


def initialise(unit: Unit, instance: Any, task: Task, inputs: Access, end: float) -> None:
    """Set start values and the first inputs, and leave the initialisation."""
    from fmpy import simulation as by_fmpy  # noqa: PLC0415  the optional extra

    def apply(values: Mapping[str, float], settable: Any) -> dict[str, float]:
        left: dict[str, float] = by_fmpy.apply_start_values(
            instance, unit.description, dict(values), settable=settable
        )
        return left

    version, begin, exchange = unit.version, float(task.time[0]), unit.kind == EXCHANGE
    if version == 1:
        if exchange:
            instance.setTime(begin)
        left = apply(task.values, by_fmpy.has_start_value)
    else:
        if version == 2:
            instance.setupExperiment(startTime=begin, stopTime=end)
        left = apply(task.values, by_fmpy.settable_in_instantiated)
        how = {"startTime": begin, "stopTime": end} if version == 3 else {}
        instance.enterInitializationMode(**how)
        left = apply(left, by_fmpy.settable_in_initialization_mode)
    if task.u is not None:
        inputs.set(task.u[0])
    if version > 1:
        instance.exitInitializationMode()
    else:
        instance.initialize(**({} if exchange else {"tStart": begin, "stopTime": end}))
    if left:
        raise InputError(f"these variables of {unit.path} cannot be set: {', '.join(left)}")


class _Inputs:
    """Set the inputs of a run by model exchange; a solver calls `apply`."""

    def __init__(self, unit: Unit, instance: Any, task: Task) -> None:
        kinds = [(unit.by_name[name].type, unit.by_name[name].variability) for name in task.inputs]
        smooth = [
            i for i, (kind, variability) in enumerate(kinds) if kind in REAL and not task.held
            and variability not in ("discrete", "tunable")
        ]  # fmt: skip
        self.all = Access(unit, instance, task.inputs)
        self.smooth = Access(unit, instance, [task.inputs[i] for i in smooth])
        self.time, self.step = task.time, task.step
        self.u = np.empty((len(task.time), 0)) if task.u is None else task.u
        self.lines = self.u[:, smooth]
        self.jumps = np.delete(self.u, smooth, axis=1)

    def apply(self, time: float, **_: Any) -> None:
        """Set the inputs that run along straight lines between samples."""
        if not self.smooth.count:
            return
        place = min(max((time - self.time[0]) / self.step, 0.0), len(self.lines) - 1.0)
        n = min(int(place), len(self.lines) - 2)
        self.smooth.set(self.lines[n] + (place - n) * (self.lines[n + 1] - self.lines[n]))


class Exchange:
    """Integrate an FMU for model exchange by CVODE (Hindmarsh et al., ACM TOMS 31, 2005)."""

    def __init__(self, unit: Unit, instance: Any, task: Task) -> None:
        self.unit, self.instance, self.task = unit, instance, task
        self.inputs = _Inputs(unit, instance, task)
        initialise(unit, instance, task, self.inputs.all, float(task.time[-1]))
        self.event_time = np.inf
        if unit.version > 1:
            self._update()
        self.solver = self._solver()
        self.touched = self._touches()

    def run(self) -> Array:
        """Return the outputs, `(time, outputs)`, of events at a sample those after them."""
        outputs = Access(self.unit, self.instance, self.task.outputs)
        found = np.empty((len(self.task.time), outputs.count))
        for n in range(len(found)):
            self._integrate(n)
            found[n] = outputs.get()
        self.instance.terminate()
        return found

    def _integrate(self, n: int) -> None:
        """Go on to sample n, and set its inputs."""
        before = max(n - 1, 0)
        now, end = float(self.task.time[before]), float(self.task.time[n])
        near, instance = max(NEAR * self.task.step, 8 * np.spacing(abs(end))), self.instance
        for _ in range(MOST_EVENTS):
            if now >= end - near and self.event_time > end + near and not self.touched:
                break
            event, stop, touched = False, min(end, self.event_time), self.touched
            if touched:  # the solver does not see an indicator that leaves 0
                _, _, now = self.solver.step(now, now + near)
                event = True
            elif stop > now + near:
                event, _, now = self.solver.step(now, stop)
            if self.event_time <= now + near:
                event, now = True, max(now, self.event_time)
            self._set_time(now)
            if self.unit.description.modelExchange.needsCompletedIntegratorStep:
                done = instance.completedIntegratorStep()
                event |= bool(done if self.unit.version == 1 else done[0])
            if event:
                self._event(now)
                self.touched &= not touched
        else:
            raise InputError(f"the FMU {self.unit.path} has no end of events at {now:g} s")
        self._set_time(end)
        if (self.inputs.jumps[n] != self.inputs.jumps[before]).any():
            self._event(end, n)

    def _event(self, now: float, n: int | None = None) -> None:
        """Handle an event, at which the inputs of sample n are set."""
        if self.unit.version > 1:
            self.instance.enterEventMode()
        if n is not None:
            self.inputs.all.set(self.inputs.u[n])
        self._update()
        self.solver.reset(now)
        self.touched = self._touches()

    def _touches(self) -> bool:
        """Return whether an event indicator is 0: its event may be due just after."""
        z = np.ones(self.solver.nz)
        if self.solver.nz:
            self.instance.getEventIndicators(z.ctypes.data_as(POINTER(c_double)), len(z))
        return bool((z == 0).any())

    def _update(self) -> None:
        """Update the discrete states, and find the time of the next event."""
        instance, version = self.instance, self.unit.version
        update = ("eventUpdate", "newDiscreteStates", "updateDiscreteStates")[version - 1]
        for _ in range(MOST_EVENTS):
            if version == 1:
                settled, _, _, ended, defined, at = getattr(instance, update)()
            else:
                more, ended, _, _, defined, at = getattr(instance, update)()
                settled = not more
            if ended:
                raise InputError(f"the FMU {self.unit.path} has ended its simulation")
            if settled:
                break
        self.event_time = at if defined else np.inf
        if version > 1:
            instance.enterContinuousTimeMode()

    def _set_time(self, time: float) -> None:
        """Set the time and its inputs, also where derivatives are evaluated: FMPy leaves them."""
        self.instance.setTime(time)
        self.inputs.apply(time)

    def _solver(self) -> Any:
        from fmpy.sundials import CVodeSolver  # noqa: PLC0415  the optional extra

        instance, description, version = self.instance, self.unit.description, self.unit.version
        nominals = "getNominalContinuousStates" if version == 1 else "getNominalsOfContinuousStates"
        slopes = "getContinuousStateDerivatives" if version == 3 else "getDerivatives"
        experiment = description.defaultExperiment
        given = None if experiment is None else experiment.tolerance
        return CVodeSolver(
            nx=description.numberOfContinuousStates,
            nz=description.numberOfEventIndicators,
            get_x=instance.getContinuousStates,
            set_x=instance.setContinuousStates,
            get_dx=getattr(instance, slopes),
            get_z=instance.getEventIndicators,
            get_nominals=getattr(instance, nominals),
            set_time=self._set_time,
            input=self.inputs,
            startTime=float(self.task.time[0]),
            maxStep=self.task.step,
            relativeTolerance=min(RELATIVE_TOLERANCE, float(given or 1.0)),
            maxNumSteps=MOST_STEPS,
        )


@dataclass(frozen=True, eq=False)
class Reading:
    """Say when the outputs of a co-simulation FMU are read.

    `late`: those that show a sample's inputs only after the step, `(outputs,)`; `before`: whether
    the others are read before the inputs are set, as they cannot be read then.
    """

    late: NDArray[np.bool_]
    before: bool = False


class CoSimulation:
    """Step an FMU for co-simulation from sample to sample."""

    def __init__(self, unit: Unit, instance: Any, task: Task) -> None:
        self.unit, self.instance, self.task = unit, instance, task
        self.inputs = Access(unit, instance, task.inputs)
        self.outputs = Access(unit, instance, task.outputs)
        self.now = float(task.time[0])
        initialise(unit, instance, task, self.inputs, float(task.time[-1]) + task.step)

    def run(self, reading: Reading) -> Array:
        """Return the outputs, `(time, outputs)`."""
        task, late = self.task, reading.late
        found = np.empty((len(task.time), self.outputs.count))
        for n in range(len(found)):
            if reading.before:
                found[n] = self.outputs.get()
            self.drive(n)
            if not (reading.before or late.all()):
                found[n] = self.outputs.get()
            if n + 1 < len(found) or late.any():
                self.step(task.length)
            if late.any():
                found[n, late] = self.outputs.get()[late]
            if n + 1 < len(found):
                self.rest()
        self.instance.terminate()
        return found

    def advance(self) -> None:
        """Go on to the last sample."""
        for n in range(len(self.task.time) - 1):
            self.drive(n)
            self.step(self.task.length)
            self.rest()

    def drive(self, n: int) -> None:
        """Set the inputs of a sample."""
        self.now = float(self.task.time[n])
        if self.task.u is not None:
            self.inputs.set(self.task.u[n])

    def rest(self) -> None:
        """Make the steps after the first one up to the next sample."""
        for _ in range(self.task.substeps - 1):
            self.step(self.task.length)

    def step(self, length: float) -> None:
        """Make a step of this length in s."""
        try:
            done = self.instance.doStep(self.now, length)
        except Exception as error:
            own = self.unit.own_step
            raise InputError(
                f"the FMU {self.unit.path} stopped at {self.now:g} s, in a step of {length:g} s: "
                f"{error}; it declares "
                + ("no step" if own is None else f"a step of {own:g} s")
                + ", and step (--simulator-step) sets the step"
            ) from error
        if done is not None and (done[1] or done[2]):  # FMI 3 tells it ended or returned early
            raise InputError(f"the FMU {self.unit.path} stopped at {done[3]:g} s")
        self.now += length
