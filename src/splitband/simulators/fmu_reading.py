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
    able = unit.description.coSimulation.canHandleVariableCommunicationStepSize
    able = able or unit.version == 1  # of which FMPy does not read it
    shares = (1.0, FRACTION_OF_A_STEP, FRACTION_OF_A_STEP / 2) if able else (1.0,)
    begin = [_two_steps(unit, start, usual, usual, share) for share in shares]
    for changed in changes:
        moves = [None if at is None else _two_steps(unit, start, changed, usual, share)
                 for at, share in zip(begin, shares, strict=True)]  # fmt: skip
        moves = [None if to is None or at is None else to - at
                 for to, at in zip(moves, begin, strict=True)]  # fmt: skip
        assert moves[0] is not None
        moved |= moves[0][0] != 0
        for i in np.flatnonzero(open_ones & (moves[0][0] != 0)).tolist():
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
                run.step(share * task.step)
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
