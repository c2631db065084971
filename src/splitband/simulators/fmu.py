"""Run a functional mock-up unit as a simulator, and find out how its outputs are read.

An output of a co-simulation FMU may depend on an input at once (direct feedthrough). Many FMUs
compute it when it is read after the input was set; others compute outputs only in a step, or refuse
to be read before it (FMI 2.0.4, Sec. 4.2.3). One run at the start, with inputs that are changed one
at a time, tells.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.files import sha256_of
from splitband.simulators.base import Start, check_start
from splitband.simulators.fmu_running import CoSimulation, Exchange, Reading, Task, check_inputs
from splitband.simulators.fmu_unit import EXCHANGE, REAL, Unit, listed
from splitband.simulators.parameters import Adjustable, Given, Point, Response

SAMPLES = 8
"""Samples before the inputs are changed, so that states are not at 0. By eye."""
FRACTION_OF_A_STEP = 1e-4
"""A short step, as a share of the communication step. By eye."""
DEPENDS, MOST_CHECKED = 0.01, 1000
"""Change of an output by half the communication step, as a share of its range, above which it is
said to depend on that, and the samples over which it is found out. A convention; bounds the time.
"""
AT_ONCE = 0.01
"""An output that changes in a step without length by this share of what it changes in a whole one
depends on the input at once. By eye."""
SAME = 1e-6
"""Relative difference within which changes count as the same. Rounding."""
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
    step : Communication step of co-simulation in s, of which the sampling time is a multiple. By
        default the one that the FMU declares, or the next shorter one that divides the sampling
        time, or that if it declares none. A warning says where half of it changes the outputs by
        more than one per cent of their range, over the first 1,000 samples.
    """

    difference = 1e-4
    _fitted = False

    def __init__(  # noqa: PLR0913
        self,
        path: str | Path,
        outputs: Sequence[str] | None = None,
        parameters: Given | None = None,
        inputs: Sequence[str] | None = None,
        start: Start = 0.0,
        held: bool = False,
        step: float | None = None,
    ) -> None:
        self.path = Path(path)
        self.parameters = None if parameters is None else dict(parameters)
        self.inputs = None if inputs is None else [*inputs]
        self.start, self.held, self.step = check_start(start), held, step
        self._unit, self._named = Unit(self.path), bool(outputs)
        self.outputs = [*(outputs or self._unit.variables.outputs)]
        try:
            self._unit.variables.check([*self.outputs, *self.known.given], self.inputs)
            if step is not None and self._unit.kind == EXCHANGE:
                raise InputError(
                    f"step (--simulator-step) must be left out for {self.path}, which is run by "
                    f"model exchange: its solver adapts the steps; got {step}"
                )
            self._check_parameters()
        except ValueError:
            self.close()
            raise

    def _check_parameters(self) -> None:
        """Raise ValueError for what cannot be set, and what integer parameters cannot have."""
        for name in self.known.given:
            kind = self._unit.by_name[name].type
            if name not in (able := self._unit.settable()):
                raise InputError(
                    f"parameters must be variables that can be set, got {name} of {self.path}, "
                    f"which is constant or computed by the FMU; it has {listed(able) or 'none'}"
                )
            if name in self.known.free and kind not in REAL:
                raise InputError(
                    f"parameters must be numbers, not ranges, for {name} of {self.path}, which is "
                    f"of the type {kind}"
                )
            check_inputs(self._unit, [name], np.array([[self.known.range(name)[0]]]), "parameters")

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
        unit = self._unit
        names = [*unit.variables.inputs] if self.inputs is None else self.inputs
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
        task = replace(task, substeps=substeps(unit, task.step, self.step))
        reading = self._reading(task)
        self._check_step(task, reading)
        with unit.instance() as instance:
            return CoSimulation(unit, instance, task).run(reading)

    def _reading(self, task: Task) -> Reading:
        """Return how the outputs are read; with parameters to fit, wherever these are.

        A feedthrough may have a gain of 0 at one place, and for inputs in another range.
        """
        unit, step = self._unit, round(task.step, 12)
        span = () if task.u is None else (*task.u.min(axis=0), *task.u.max(axis=0))
        what = *task.outputs, *task.inputs, str(self.known), *span
        key = (*what, step, task.substeps, min(len(task.time), SAMPLES))
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

    def _check_step(self, task: Task, reading: Reading) -> None:
        """Warn where the outputs depend on the communication step; of a fit, at its values."""
        unit, step = self._unit, round(task.length, 12)
        other = unit.any_step or unit.own_step is None  # half of it may be asked for
        if step in unit.checked or not other or (self.known.free and not self._fitted):
            return
        unit.checked[step] = ""
        part = slice(MOST_CHECKED)
        short = replace(task, time=task.time[part], u=None if task.u is None else task.u[part])
        found = []
        try:
            for count in (task.substeps, 2 * task.substeps):
                with unit.instance() as instance:
                    run = CoSimulation(unit, instance, replace(short, substeps=count))
                    found.append(run.run(reading))
        except Exception:  # it makes no such steps; the run itself says what else is wrong
            return
        apart, span = np.abs(found[1] - found[0]).max(axis=0), np.ptp(found[1], axis=0)
        shares = np.divide(apart, span, out=np.zeros(len(span)), where=span > 0)
        if shares[worst := int(np.argmax(shares))] > DEPENDS:
            unit.checked[step] = (
                f"{self.outputs[worst]} of {self.path} depends on the communication step: with "
                f"{step / 2:g} s in place of {step:g} s it changes by up to {shares[worst]:.2g} of "
                "its range; step (--simulator-step) sets a shorter one"
            )
            if not self._fitted:
                warnings.warn(unit.checked[step], stacklevel=2)

    @property
    def remarks(self) -> list[str]:  # type: ignore[override]
        """Return a sentence on its communication step, if the outputs depend on it."""
        return [*filter(None, self._unit.checked.values())]

    def precise(self) -> Self:
        """Return a copy for the last steps of a fit, which checks its communication step."""
        self._unit.checked.clear()
        return self._with(_fitted=True)

    def _with(self, **changes: Any) -> Self:
        """Return a copy that shares the unpacked files."""
        made = type(self).__new__(type(self))
        vars(made).update(vars(self) | changes)
        vars(made).pop("known", None)
        return made

    def otherwise(self) -> Any:
        """Return a copy with the other course of inputs; None but for model exchange with some."""
        exchange = self.driven and self._unit.kind == EXCHANGE
        return self._with(held=not self.held) if exchange else None

    def fingerprint(self) -> str:
        """Return the SHA-256 of its file, and what is used of it; see `Simulator`."""
        step = "" if self.step is None else f" {self.step}"
        used = f"{self.outputs} {self.inputs} {self.start} {self.held}{step}"
        return f"{sha256_of(self.path)} {used}"

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor's arguments, with which another process opens it."""
        outputs, rest = self.outputs if self._named else None, (self.start, self.held, self.step)
        return type(self), (self.path, outputs, self.parameters, self.inputs, *rest)

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._unit.close()

    def __enter__(self) -> Fmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def substeps(unit: Unit, sampling_time: float, given: float | None) -> int:
    """Return how many communication steps lead from one sample to the next.

    Raises ValueError for a given one that does not divide the sampling time, with the next ones
    that do. Warns where that holds for the one that the FMU declares.
    """
    own = unit.own_step if given is None else given
    if own is None:
        return 1
    count = max(math.ceil(sampling_time / own * (1 - SAME)), 1) if own > 0 else 1
    used, longer = (sampling_time / n for n in (count, max(count - 1, 1)))
    if abs(used / own - 1 if own > 0 else 1.0) <= SAME:
        return count
    if given is not None:
        near = " or ".join(f"{each:.9g}" for each in dict.fromkeys((used, longer)))
        raise InputError(
            f"step (--simulator-step) must divide the sampling time, {sampling_time:g} s: got "
            f"{given:g}; the nearest are {near}"
        )
    if own < sampling_time or not unit.any_step:
        warnings.warn(
            f"{unit.path} declares a communication step of {own:g} s, and is run with "
            f"{used:.6g} s, which divides the sampling time, {sampling_time:g} s; if it keeps to "
            f"its own step, resample the record to a multiple of {own:g} s",
            stacklevel=2,
        )
    return count


# ---------------------------------------------------------------- how outputs are read


def reading_of(unit: Unit, task: Task) -> tuple[Reading, bool]:
    """Return how the outputs are read, and whether that is known.

    It is not where an output does not change with any input here. Raises LateError for an output
    that cannot be read at its sample, or where that cannot be reported.
    """
    nothing = np.zeros(len(task.outputs), dtype=bool)
    start = replace(task, time=task.time[:SAMPLES])
    if task.u is None or not task.u.shape[1] or len(start.time) < 2:
        return Reading(nothing), True
    usual = task.u[len(start.time) - 1]
    changes = _changes(unit, task, usual)
    try:
        reported, before = _reported_when_set(unit, start, usual, changes), False
    except _UnreadableError:
        reported, before = nothing, True
    depends = _declared(unit, task)
    open_ones = ~reported & np.array([each is not False for each in depends])
    if not open_ones.any():
        return Reading(nothing, before), True
    late, moved = nothing.copy(), nothing.copy()
    shares = (1.0, FRACTION_OF_A_STEP, FRACTION_OF_A_STEP / 2) if unit.any_step else (1.0,)
    begin = [_two_steps(unit, start, usual, usual, share) for share in shares]
    for changed in changes:
        moves = [None if at is None else _two_steps(unit, start, changed, usual, share)
                 for at, share in zip(begin, shares, strict=True)]  # fmt: skip
        moves = [None if to is None or at is None else to - at
                 for to, at in zip(moves, begin, strict=True)]  # fmt: skip
        assert moves[0] is not None
        first = abs(moves[0][0]) > 0  # not for NaN
        moved |= first
        for i in np.flatnonzero(open_ones & first).tolist():
            each = [move[:, i] for move in moves if move is not None]
            late[i] |= _is_late(each, f"{task.outputs[i]} of {unit.path}", depends[i])
    return Reading(late, before), bool(moved[open_ones].all())


class LateError(InputError):
    """Report an output that cannot be read at its sample."""


class _UnreadableError(Exception):
    """Report that outputs cannot be read after inputs were set, without a step."""


def _is_late(moves: Sequence[Array], name: str, depends: bool | None) -> bool:
    """Return whether an output shows its sample's inputs only after a step.

    `moves`: what an input changes in it after a step in which that was changed, and after the next
    one: with whole steps, with short ones and with some half as long, if the FMU makes these. What
    it changes in a step without length, which the short ones tell, depends on it at once; if the
    next step forgets it, there is no state.
    """
    first, second = np.abs(moves[0])
    forgets = second <= SAME * first
    # One that makes steps of its own does nothing in a step that is shorter than these.
    if len(moves) == 3 and np.any(moves[1:]):
        (at_once, then), (half, _) = moves[1:]
        if abs(2 * half - at_once) <= AT_ONCE * first:
            return False  # by its states
        same = np.allclose(np.abs([at_once, then]), [first, second], rtol=SAME, atol=0.0)
        unknown = same and not forgets  # its steps do not depend on their length
    elif depends:
        unknown = False
    elif forgets:
        raise LateError(
            f"{name} cannot be read at its sample: it is either a function of the inputs that is "
            "computed in the step after it, or one sample late, and steps of another length, which "
            "would tell, are not made; declare its dependencies in the model description, or "
            "export the FMU for model exchange"
        )
    else:
        unknown = True
    if unknown:
        warnings.warn(
            f"{name} is taken not to depend on the inputs at once, which its description does not "
            "say and a run cannot tell; otherwise it comes one sample late",
            stacklevel=2,
        )
    elif not forgets:
        raise LateError(
            f"{name} cannot be read at its sample: it depends on the inputs at once, and is "
            "computed only in the step after them; export the FMU for model exchange, or so that "
            "its outputs can be read when inputs are set"
        )
    return not unknown


def _declared(unit: Unit, task: Task) -> list[bool | None]:
    """Return for each output whether the FMU declares it to depend on an input; None: not said."""
    said = {each.variable.name: each.dependencies for each in unit.description.outputs
            if each.variable is not None and each.dependencies is not None}  # fmt: skip
    return [any(v.name in task.inputs for v in said[name]) if name in said else None
            for name in task.outputs]  # fmt: skip


def _reported_when_set(
    unit: Unit, task: Task, usual: Array, changes: Sequence[Array]
) -> NDArray[np.bool_]:
    """Return which outputs change when an input is set, without a step."""
    with unit.instance() as instance:
        run = CoSimulation(unit, instance, task)
        run.advance()
        reported = np.zeros(len(task.outputs), dtype=bool)
        for changed in changes:
            values = []
            for u in (usual, changed):
                run.inputs.set(u)
                try:
                    values.append(run.outputs.get())
                except Exception as error:
                    raise _UnreadableError from error
            reported |= values[0] != values[1]
        run.instance.terminate()
    return reported


def _two_steps(unit: Unit, task: Task, first: Array, second: Array, share: float) -> Array | None:
    """Return the outputs after two steps of these inputs and this share of the sampling time.

    `(2, outputs)`; None for an FMU that makes no short steps.
    """
    try:
        with unit.instance() as instance:
            run, found = CoSimulation(unit, instance, task), []
            run.advance()
            for u in (first, second):
                run.inputs.set(u)
                run.step(share * task.length)
                found.append(run.outputs.get())
            run.instance.terminate()
    except Exception:
        if share == 1.0:
            raise
        return None
    return np.stack(found)


def _changes(unit: Unit, task: Task, usual: Array) -> list[Array]:
    """Return the usual inputs with one of them changed, as far as in the record, then with all."""
    assert task.u is not None
    changes, together = [], usual.copy()
    for j, name in enumerate(task.inputs):
        last = usual[j]
        others = [each for each in (task.u[:, j].min(), task.u[:, j].max()) if each != last]
        if not others:
            others = [1.0 - last if unit.by_name[name].type == "Boolean" else last + 1.0]
        changes += [np.where(np.arange(len(usual)) == j, other, usual) for other in others]
        together[j] = max(others, key=lambda other: abs(other - last))
    return changes if len(usual) == 1 else [*changes, together]
