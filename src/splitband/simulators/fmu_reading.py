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
from splitband.simulators.fmu_running import CoSimulation, Reading, Task
from splitband.simulators.fmu_unit import Unit

SAMPLES = 8
"""Samples before the inputs are changed, so that states are not at 0. By eye."""
SHORT = 1e-3
"""A short step, as a share of the sampling time. By eye."""
AT_ONCE = 0.5
"""An output that changes in a short step by this share of what it changes in a whole one depends on
the input at once. By eye."""
SAME = 1e-6
"""Relative difference within which changes count as the same. By eye."""

Mask = NDArray[np.bool_]


def reading_of(unit: Unit, task: Task) -> Reading:
    """Return how the outputs are read.

    Raises ValueError for an output that cannot be read at its sample, or where that cannot be told.
    """
    nothing = np.zeros(len(task.outputs), dtype=bool)
    if task.u is None or not task.u.shape[1]:
        return Reading(nothing)
    start = replace(task, u=task.u[:SAMPLES], time=task.time[:SAMPLES])
    if len(start.time) < 2:
        return Reading(nothing)
    try:
        told, before = _told_when_set(unit, start), False
    except _UnreadableError:
        told, before = nothing, True
    declared, free = _declared(unit, task)
    open_ones = ~told & ~free
    late = _late(unit, start, open_ones, declared) if open_ones.any() else nothing
    return Reading(late, before)


class _UnreadableError(Exception):
    """Report that outputs cannot be read after inputs were set, without a step."""


def _declared(unit: Unit, task: Task) -> tuple[Mask, Mask]:
    """Return which outputs the FMU declares to depend on an input, and which to depend on none."""
    told = {each.variable.name: each.dependencies for each in unit.description.outputs
            if each.variable is not None and each.dependencies is not None}  # fmt: skip
    depends = [
        None if name not in told else any(v.name in task.inputs for v in told[name])
        for name in task.outputs
    ]
    return np.array([d is True for d in depends]), np.array([d is False for d in depends])


def _told_when_set(unit: Unit, task: Task) -> Mask:
    """Return which outputs change when an input is set, without a step."""
    with unit.instance() as instance:
        run = CoSimulation(unit, instance, task)
        _advance(run)
        told = np.zeros(len(task.outputs), dtype=bool)
        for changed in _changes(unit, task):
            values = []
            for u in (run.task.u[-1], changed):  # type: ignore[index]
                run.inputs.set(u)
                try:
                    values.append(run.outputs.get())
                except Exception as error:
                    raise _UnreadableError from error
            told |= values[0] != values[1]
        run.instance.terminate()
    return told


def _late(unit: Unit, task: Task, asked: Mask, declared: Mask) -> Mask:
    """Return which of the outputs that are `asked` about show their sample's inputs after a step.

    Two steps follow, in the first of which one input is changed. What changes with the input in
    a very short step depends on it at once; if the second step forgets it, there is no state.
    """
    assert task.u is not None
    late = np.zeros(len(task.outputs), dtype=bool)
    usual = _two_steps(unit, task, task.u[-1], 1.0)
    short = _short_steps(unit, task, task.u[-1])
    for changed in _changes(unit, task):
        first, second = np.abs(_two_steps(unit, task, changed, 1.0) - usual)
        forgets = second <= SAME * first
        soon = None if short is None else _short_steps(unit, task, changed)
        for i in np.flatnonzero(asked & (first > 0)).tolist():
            name = task.outputs[i]
            if soon is not None and short is not None:
                at_once, then = np.abs(soon - short)[:, i]
                if at_once <= AT_ONCE * first[i]:
                    continue  # by its states
                same = np.allclose([at_once, then], [first[i], second[i]], rtol=SAME)
                if same and not forgets[i]:  # its steps do not depend on their length
                    _warn(unit, name)
                    continue
            elif not declared[i]:
                if forgets[i]:
                    raise ValueError(
                        f"{name} of {unit.path} cannot be read at its sample: it is either a "
                        "function of the inputs that is computed in the step after it, or one "
                        "sample late, and steps of another length, which would tell, are refused; "
                        "declare its dependencies in the model description, or export the FMU for "
                        "model exchange"
                    )
                _warn(unit, name)
                continue
            if not forgets[i]:
                raise ValueError(
                    f"{name} of {unit.path} cannot be read at its sample: it depends on the inputs "
                    "at once, and is computed only in the step after them; export the FMU for "
                    "model exchange, or so that its outputs can be read when inputs are set"
                )
            late[i] = True
    return late


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
    assert task.u is not None
    found = []
    with unit.instance() as instance:
        run = CoSimulation(unit, instance, replace(task, time=task.time))
        _advance(run)
        for u in (changed, task.u[-1]):
            run.inputs.set(u)
            run.step(share * task.step)
            found.append(run.outputs.get())
        run.instance.terminate()
    return np.stack(found)


def _short_steps(unit: Unit, task: Task, changed: Array) -> Array | None:
    """Return the outputs after two short steps; None for an FMU that makes none."""
    able = unit.description.coSimulation.canHandleVariableCommunicationStepSize
    if not able and unit.version > 1:  # FMPy does not read it of FMI 1
        return None
    try:
        return _two_steps(unit, task, changed, SHORT)
    except Exception:
        return None


def _changes(unit: Unit, task: Task) -> Sequence[Array]:
    """Return the last inputs of a task, with one of them changed at a time."""
    assert task.u is not None
    changes = []
    for j, name in enumerate(task.inputs):
        values, last = task.u[:, j], task.u[-1, j]
        other = values[np.argmax(np.abs(values - last))]
        if other == last:
            kind = unit.by_name[name].type
            other = 1.0 - last if kind == "Boolean" else last + 1.0
        changes.append(np.where(np.arange(len(task.inputs)) == j, other, task.u[-1]))
    return changes
