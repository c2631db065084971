"""Run a functional mock-up unit as a simulator."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.base import Start, check_start
from splitband.simulators.fmu_reading import SAMPLES, LateError, reading_of
from splitband.simulators.fmu_running import CoSimulation, Exchange, Reading, Task, check_inputs
from splitband.simulators.fmu_unit import EXCHANGE, Unit
from splitband.simulators.parameters import Adjustable, Given, Point, Response

PROBED = 0.45, 0.55
"""Places in the ranges of parameters at which it is also found out how outputs are read: near the
middle, as elsewhere an FMU may end its process. By eye."""


class Fmu(Adjustable):
    """Run a functional mock-up unit with FMPy (the extra `splitband[fmu]`).

    The unpacked files are removed by `close`, at the end of a `with` block, when the object is
    deleted, or when the process ends. An FMU that has both kinds is run by model exchange.

    Parameters
    ----------
    path : Path of the .fmu file.
    outputs : Variables that correspond to the record's channels; by default those of their names.
        A record of one channel matches an FMU of one output.
    parameters : Start values of parameters and variables by name: a number, or a range
        `(low, high)` in which it is fitted. They are the same for all records.
    inputs : Variables that take the record's inputs, in their order, "" for one that the FMU does
        not take; by default those of their names. A record of one input matches an FMU of one
        input. The others keep their start values, with an empty list all of them.
    start : Time of a record's first sample in s, or "record" for its time stamp.
    held : Whether model exchange holds inputs until the next sample, as co-simulation does. By
        default it interpolates them.
    """

    difference = 1e-4

    def __init__(
        self,
        path: str | Path,
        outputs: Sequence[str] | None = None,
        parameters: Given | None = None,
        inputs: Sequence[str] | None = None,
        start: Start = 0.0,
        held: bool = False,
    ) -> None:
        self.path = Path(path)
        self.parameters = None if parameters is None else dict(parameters)
        self.inputs = None if inputs is None else [*inputs]
        self.start, self.held = check_start(start), held
        self._unit, self._named = Unit(self.path), bool(outputs)
        self.outputs = [*(outputs or self._unit.variables.outputs)]
        try:
            self._unit.variables.check([*self.outputs, *self.known.given], self.inputs)
        except ValueError:
            self.close()
            raise

    @property
    def driven(self) -> bool:
        """Return whether it takes a record's inputs."""
        return any(self._unit.variables.inputs if self.inputs is None else self.inputs)

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Fmu:
        """Return the FMU with the variables of these channels and inputs of a record.

        Raises ValueError, with the names of both, where they cannot be told.
        """
        variables = self._unit.variables
        return self._with(
            outputs=variables.outputs_for(columns, self.outputs if self._named else None),
            _named=True,
            inputs=variables.inputs_for(inputs, self.inputs),
        )

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s, with the inputs `(time, nu)`.

        A parameter with a range takes the middle of it.
        """
        return self._run(time, u, self.known.middle())

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """Return the responses, without states, see `Adjustable`.

        Among several runs a failed one gives NaN; a single run that fails raises ValueError.
        """
        found = []
        for values, _ in points:
            try:
                y = np.asarray(self._run(time, u, values), dtype=float)
            except Exception as error:
                if len(points) == 1:
                    raise InputError(f"the FMU {self.path} failed: {error}") from error
                y = np.full((len(time), len(self.outputs)), np.nan)
            found.append((y, np.empty((len(time), 0))))
        return found

    def _run(self, time: Array, u: Array | None, values: Mapping[str, float]) -> Array:
        unit, names = self._unit, [*self._unit.variables.inputs]
        names = names if self.inputs is None else self.inputs
        count = 0 if u is None else u.shape[1]
        if names and count != len(names):
            raise InputError(
                f"inputs must be {count or 'the'} variables of {self.path} that take the inputs "
                f"of the record, which has {count or 'none'}; got {', '.join(names)}"
            )
        given = None if not names or u is None else np.asarray(u, float)[:, [*map(bool, names)]]
        names = [name for name in names if name]
        if given is not None:
            check_inputs(unit, names, given)
        task = Task(np.asarray(time, float), given, values, self.outputs, names, self.held)
        if unit.kind == EXCHANGE:
            with unit.instance() as instance:
                return Exchange(unit, instance, task).run()
        reading = self._reading(task)
        with unit.instance() as instance:
            return CoSimulation(unit, instance, task).run(reading)

    def _reading(self, task: Task) -> Reading:
        """Return how the outputs are read; with parameters to fit, wherever these are.

        A feedthrough may have a gain of 0 at one place.
        """
        unit, step = self._unit, round(task.step, 12)
        key = (*task.outputs, *task.inputs, step, min(len(task.time), SAMPLES))
        if key in unit.readings:
            return cast("Reading", unit.readings[key])
        found = [reading_of(unit, task)]
        for place in PROBED if self.known.free else ():
            values = {name: self.known.value_at(name, place) for name in self.known.given}
            try:
                found.append(reading_of(unit, replace(task, values=values)))
            except LateError:
                raise
            except Exception:  # it does not run there
                continue
        late = np.any([reading.late for reading, _ in found], axis=0)
        reading = Reading(late, any(reading.before for reading, _ in found))
        if any(known for _, known in found):
            unit.readings[key] = reading
        return reading

    def _with(self, **changes: Any) -> Self:
        """Return a copy that shares the unpacked files."""
        made = type(self).__new__(type(self))
        vars(made).update(vars(self) | changes)
        vars(made).pop("known", None)
        return made

    def digest(self) -> str:
        """Return an identifier of the response, without the values of parameters."""
        content = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return f"{content} {self.outputs} {self.inputs} {self.start} {self.held}"

    def __getstate__(self) -> dict[str, Any]:
        """Return the constructor's arguments, with which another process opens it."""
        names = "path", "outputs", "parameters", "inputs", "start", "held"
        outputs = self.outputs if self._named else None
        return {name: getattr(self, name) for name in names} | {"outputs": outputs}

    def __setstate__(self, state: dict[str, Any]) -> None:
        Fmu.__init__(self, **state)

    def fingerprint(self) -> str:
        """Return the cache key: everything the output depends on except the time grid."""
        return f"{self.digest()} {sorted(self.known.middle().items())}"

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._unit.close()

    def __enter__(self) -> Fmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
