"""Find out how the outputs of a co-simulation FMU that belong to a sample's inputs are read.

An output may depend on an input at once (direct feedthrough). Many FMUs compute it when it is read
after the input was set; others compute outputs only in a step, or refuse to be read before it (FMI
2.0.4, Sec. 4.2.3). One run at the start, with inputs that are changed one at a time, tells.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.fmu_running import CoSimulation, Reading, Task
from splitband.simulators.fmu_unit import Unit

SAMPLES = 8
"""Samples before the inputs are changed, so that states are not at 0. By eye."""
FRACTION_OF_A_STEP = 1e-4
"""A short step, as a share of the sampling time. By eye."""
AT_ONCE = 0.01
"""An output that changes in a step without length by this share of what it changes in a whole one
depends on the input at once. By eye."""
SAME = 1e-6
"""Relative difference within which changes count as the same. By eye."""

Mask = NDArray[np.bool_]


def reading_of(unit: Unit, task: Task) -> tuple[Reading, bool]:
    """Return how the outputs are read, and whether that is known.

    It is not where an output does not change with any input here. Raises LateError for an output
    that cannot be read at its sample, or where that cannot be reported.
    """
    nothing = np.zeros(len(task.outputs), dtype=bool)
    if task.u is None or not task.u.shape[1]:
        return Reading(nothing), True
    start = replace(task, time=task.time[:SAMPLES])
    if len(start.time) < 2:
        return Reading(nothing), True
    try:
        reported, before = _reported_when_set(unit, start), False
    except _UnreadableError:
        reported, before = nothing, True
    declared, free = _declared(unit, task)
    open_ones = ~reported & ~free
    if not open_ones.any():
        return Reading(nothing, before), True
    late, changes = _late(unit, start, open_ones, declared)
    return Reading(late, before), bool(changes[open_ones].all())


class LateError(InputError):
    """Report an output that cannot be read at its sample."""


class _UnreadableError(Exception):
    """Report that outputs cannot be read after inputs were set, without a step."""


def _declared(unit: Unit, task: Task) -> tuple[Mask, Mask]:
    """Return which outputs the FMU declares to depend on an input, and which to depend on none."""
    reported = {each.variable.name: each.dependencies for each in unit.description.outputs
            if each.variable is not None and each.dependencies is not None}  # fmt: skip
    depends = [
        None if name not in reported else any(v.name in task.inputs for v in reported[name])
        for name in task.outputs
    ]
    return np.array([d is True for d in depends]), np.array([d is False for d in depends])


def _reported_when_set(unit: Unit, task: Task) -> Mask:
    """Return which outputs change when an input is set, without a step."""
    with unit.instance() as instance:
        run = CoSimulation(unit, instance, task)
        _advance(run)
        reported = np.zeros(len(task.outputs), dtype=bool)
        for changed in _changes(unit, task):
            values = []
            for u in (_usual(task), changed):
                run.inputs.set(u)
                try:
                    values.append(run.outputs.get())
                except Exception as error:
                    raise _UnreadableError from error
            reported |= values[0] != values[1]
        run.instance.terminate()
    return reported


def _late(unit: Unit, task: Task, asked: Mask, declared: Mask) -> tuple[Mask, Mask]:
    """Return which of the outputs that are `asked` about show their sample's inputs after a step.

    Also return which ones change with an input at all. Two steps follow, in the first of which one
    input is changed. What changes with the input in a step without length, which two short ones
    tell, depends on it at once; if the second step forgets it, there is no state.
    """
    late, moved = np.zeros((2, len(task.outputs)), dtype=bool)
    usual = _two_steps(unit, task, _usual(task), 1.0)
    shares = FRACTION_OF_A_STEP, FRACTION_OF_A_STEP / 2
    short = [_short_steps(unit, task, _usual(task), share) for share in shares]
    for changed in _changes(unit, task):
        first, second = np.abs(_two_steps(unit, task, changed, 1.0) - usual)
        forgets = second <= SAME * first
        moved |= first > 0
        soon = [None if before is None else _short_steps(unit, task, changed, share)
                for before, share in zip(short, shares, strict=True)]  # fmt: skip
        for i in np.flatnonzero(asked & (first > 0)).tolist():
            name = task.outputs[i]
            steps = [(after - before)[:, i] for after, before in zip(soon, short, strict=True)
                     if after is not None and before is not None]  # fmt: skip
            # One that makes steps of its own does nothing in a step that is shorter than these.
            if len(steps) == len(shares) and np.any(steps):
                (at_once, then), (half, _) = steps
                if abs(2 * half - at_once) <= AT_ONCE * first[i]:
                    continue  # by its states
                changes = np.abs([at_once, then])
                same = np.allclose(changes, [first[i], second[i]], rtol=SAME, atol=0.0)
                if same and not forgets[i]:  # its steps do not depend on their length
                    _warn(unit, name)
                    continue
            elif not declared[i]:
                if forgets[i]:
                    raise LateError(
                        f"{name} of {unit.path} cannot be read at its sample: it is either a "
                        "function of the inputs that is computed in the step after it, or one "
                        "sample late, and steps of another length, which would tell, are not made; "
                        "declare its dependencies in the model description, or export the FMU for "
                        "model exchange"
                    )
                _warn(unit, name)
                continue
            if not forgets[i]:
                raise LateError(
                    f"{name} of {unit.path} cannot be read at its sample: it depends on the inputs "
                    "at once, and is computed only in the step after them; export the FMU for "
                    "model exchange, or so that its outputs can be read when inputs are set"
                )
            late[i] = True
    return late, moved


def _warn(unit: Unit, name: str) -> None:
    warnings.warn(
        f"{name} of {unit.path} is taken not to depend on the inputs at once, which its "
        "description does not say and a run cannot tell; otherwise it comes one sample late",
        stacklevel=2,
    )


def _advance(run: CoSimulation) -> None:
    """Go on to the last sample of the task."""
    for n in range(len(run.task.time) - 1):
        run.drive(n)
        run.step(run.task.step)


def _two_steps(unit: Unit, task: Task, changed: Array, share: float) -> Array:
    """Return the outputs after two steps of this share of the sampling time, `(2, outputs)`.

    The inputs are those `changed` in the first one, and the usual ones in the second.
    """
    found = []
    with unit.instance() as instance:
        run = CoSimulation(unit, instance, replace(task, time=task.time))
        _advance(run)
        for u in (changed, _usual(task)):
            run.inputs.set(u)
            run.step(share * task.step)
            found.append(run.outputs.get())
        run.instance.terminate()
    return np.stack(found)


def _short_steps(unit: Unit, task: Task, changed: Array, share: float) -> Array | None:
    """Return the outputs after two short steps; None for an FMU that makes none."""
    able = unit.description.coSimulation.canHandleVariableCommunicationStepSize
    if not able and unit.version > 1:  # FMPy does not read it of FMI 1
        return None
    try:
        return _two_steps(unit, task, changed, share)
    except Exception:
        return None


def _changes(unit: Unit, task: Task) -> Sequence[Array]:
    """Return the usual inputs with one of them changed, as far as in the record, then with all."""
    assert task.u is not None
    changes, usual, together = [], _usual(task), _usual(task).copy()
    for j, name in enumerate(task.inputs):
        values, last = task.u[:, j], usual[j]
        others = [other for other in (values.min(), values.max()) if other != last]
        if not others:
            others = [1.0 - last if unit.by_name[name].type == "Boolean" else last + 1.0]
        for other in others:
            changes.append(np.where(np.arange(len(usual)) == j, other, usual))
        together[j] = max(others, key=lambda other: abs(other - last))
    return changes if len(usual) == 1 else [*changes, together]


def _usual(task: Task) -> Array:
    """Return the inputs at the last sample of a task, whose inputs may go on."""
    assert task.u is not None
    usual: Array = task.u[len(task.time) - 1]
    return usual
