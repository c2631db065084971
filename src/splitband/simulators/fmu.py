"""Run a functional mock-up unit as a simulator, and detect when its outputs are valid.

An output of a co-simulation FMU may depend on an input at once (direct feedthrough). Many FMUs
compute it when it is read after the input was set; others compute outputs only in a step, or refuse
reading before a step (FMI 2.0.4, Sec. 4.2.3). The model description names outputs without such a
dependence; for the others a short run with changed inputs decides.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt
from numpy.typing import NDArray

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.base import Hold, Start, check_hold, check_start, fingerprint
from splitband.simulators.fmu_running import (
    CoSimulation,
    Exchange,
    FmuRun,
    UnreadableError,
    check_inputs,
)
from splitband.simulators.fmu_unit import EXCHANGE, REAL, Unit, listed
from splitband.simulators.parameters import Adjustable, Given, Point, Response

SAMPLES = 8
"""Samples before the change of inputs, when states have left 0. Bounds the time."""
SHORT = 1e-4
"""A short step, as a share of the communication step, and the finite-difference step of parameters:
the root of a solver's tolerance (Press et al., Numerical Recipes, 2007, Sec. 5.7). Rounding."""
DEPENDS = 0.01
"""Least effect that counts as a dependence: of half the communication step, as a share of an
output's range; of an input at once, as a share of an output's change in a step. A convention."""
MOST_CHECKED = 1000
"""Largest number of samples in the check of the communication step. Bounds the time."""
BY_LENGTH = 0.1
"""Largest change of an output in a short step, as a share of its change in a whole one, if the
length of steps has an effect. By eye."""
SAME, ROUNDING = 1e-6, 1e-12
"""Relative difference of equal values from different, and from equal computations. Rounding."""
PROBED = 0.45
"""Position in the ranges of parameters of the test run: not the middle, often a gain of 0, but near
it, as elsewhere an FMU may end its process. By eye."""


class Fmu(Adjustable):
    """A functional mock-up unit, run with FMPy (the extra `splitband[fmu]`).

    The unpacked files are removed by `close`, at the end of a `with` block, when the object is
    deleted, or when the process ends. An FMU of both kinds is run by model exchange.

    Parameters
    ----------
    path : Path of the .fmu file.
    outputs : Variables of the record's channels; by default the variables of equal names. A record
        of one channel matches an FMU of one output.
    parameters : Start values of parameters and variables by name: a number, or a range
        `(low, high)` to fit, common to all records.
    inputs : Variables of the record's inputs, in their order, "" for an input unknown to the FMU;
        by default the variables of equal names. A record of one input matches an FMU of one input.
        Other variables keep their start values, with an empty list all of them.
    start : Time of a record's first sample in s, or "record" for its time stamp.
    hold : Course of inputs between samples in model exchange: "zoh" holds inputs until the next
        sample, as co-simulation does, "linear" interpolates.
    step : Communication step of co-simulation in s, a divisor of the sampling time. By default the
        step declared by the FMU, or the next shorter divisor, or the sampling time. A warning is
        given if half the step changes the outputs by more than one per cent of their range, over
        the first 1,000 samples.

    Raises
    ------
    FileNotFoundError
        For a missing file.
    ValueError
        For a file that is no FMU, and names or values of variables that it cannot take.

    Examples
    --------
    >>> plant = sb.Fmu("tank.fmu", outputs=["level"], inputs=["valve"])  # doctest: +SKIP
    >>> model = sb.Residual(plant, sb.GRU(32)).fit(record)  # doctest: +SKIP
    >>> fitted = sb.Fmu("tank.fmu", parameters={"area": (0.1, 2.0)})  # doctest: +SKIP
    >>> sb.GreyBox(fitted).fit(record).describe()  # doctest: +SKIP
    """

    difference = SHORT
    _fitted = False

    def __init__(  # noqa: PLR0913
        self,
        path: str | Path,
        outputs: Sequence[str] | None = None,
        parameters: Given | None = None,
        inputs: Sequence[str] | None = None,
        start: Start = 0.0,
        hold: Hold = "linear",
        step: float | None = None,
    ) -> None:
        self.path = Path(path)
        self.parameters = None if parameters is None else dict(parameters)
        self.inputs = None if inputs is None else [*inputs]
        self.start, self.hold, self.step = check_start(start), check_hold(hold), step
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
        """Raise ValueError for constant variables, and for invalid values of integer ones."""
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
    def driven(self) -> bool:  # type: ignore[override]
        """Return whether the FMU takes a record's inputs."""
        return any(self._unit.variables.inputs if self.inputs is None else self.inputs)

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Fmu:
        """Return the FMU with the variables of these channels and inputs of a record.

        Raises ValueError, with the names of both, for an ambiguous or missing match.
        """
        variables = self._unit.variables
        return self._with(
            outputs=variables.outputs_for(columns, self.outputs if self._named else None),
            _named=True,
            inputs=variables.inputs_for(inputs, self.inputs),
        )

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s, with the inputs `(time, nu)`.

        A parameter with a range takes the middle.
        """
        return self._run(time, u, self.known.middle())

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """Return the responses, without states, see `Adjustable`.

        Among several runs a failed one gives NaN; a failed single run raises ValueError.
        """
        responses = []
        for values, _ in points:
            try:
                y = np.asarray(self._run(time, u, values), dtype=float)
            except Exception as error:
                if len(points) == 1:
                    raise InputError(f"the FMU {self.path} failed: {error}") from error
                y = np.full((len(time), len(self.outputs)), np.nan)
            responses.append((y, np.empty((len(time), 0))))
        return responses

    def _run(self, time: Array, u: Array | None, values: Mapping[str, float]) -> Array:
        unit = self._unit
        names = [*unit.variables.inputs] if self.inputs is None else self.inputs
        count = 0 if u is None else u.shape[1]
        if names and count != len(names):
            raise InputError(
                f"inputs must be {count or 'the'} variables of {self.path} that take the inputs "
                f"of the record, which has {count or 'none'}; got {', '.join(names)}"
            )
        columns = np.empty((len(time), 0))
        if names and u is not None:
            columns = np.asarray(u, float)[:, [*map(bool, names)]]
        names = [name for name in names if name]
        check_inputs(unit, names, columns)
        task = FmuRun(np.asarray(time, float), columns, values, self.outputs, names, self.hold)
        if unit.kind == EXCHANGE:
            with unit.instance() as instance:
                return Exchange(unit, instance, task).run()
        task = replace(
            task, substeps=substeps(unit, task.step, self.step), before=unit.reads_before
        )
        try:
            return self._stepped(task)
        except UnreadableError:
            outputs = self._stepped(replace(task, before=True))
            unit.reads_before = True
            return outputs

    def _stepped(self, task: FmuRun) -> Array:
        """Return the outputs of a co-simulation, read the same way for all values in the ranges."""
        parameters, probed = self.known, task
        if parameters.free:
            values = {name: parameters.value_at(name, PROBED) for name in parameters.given}
            probed = replace(task, values=values)
        late = late_outputs(self._unit, probed)
        with self._unit.instance() as instance:
            outputs = CoSimulation(self._unit, instance, task).run(late)
        self._check_step(task, late, outputs)
        return outputs

    def _check_step(self, task: FmuRun, late: NDArray[np.bool_], outputs: Array) -> None:
        """Warn if the outputs depend on the communication step; in a fit, at the fitted values."""
        unit, step = self._unit, round(task.length, 12)
        other = unit.any_step or unit.own_step is None  # half the step is possible
        if step in unit.checked or not other or (self.known.free and not self._fitted):
            return
        unit.checked[step] = ""
        time, u, outputs = task.time[:MOST_CHECKED], task.u[:MOST_CHECKED], outputs[:MOST_CHECKED]
        finer = replace(task, time=time, u=u, substeps=2 * task.substeps)
        try:
            with unit.instance() as instance:
                y = CoSimulation(unit, instance, finer).run(late)
        except Exception:  # half the step is impossible
            return
        apart, span = np.abs(y - outputs).max(axis=0), np.ptp(y, axis=0)
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
        """Return a sentence on the communication step, if the outputs depend on it."""
        return [*filter(None, self._unit.checked.values())]

    def precise(self) -> Self:
        """Return a copy for the last steps of a fit, with a check of the communication step."""
        self._unit.checked.clear()
        return self._with(_fitted=True)

    def _with(self, **changes: Any) -> Self:
        """Return a copy with the same unpacked files."""
        made = type(self).__new__(type(self))
        vars(made).update(vars(self) | changes)
        vars(made).pop("known", None)
        return made

    def otherwise(self) -> Any:
        """Return a copy with the other `hold`, for model exchange with inputs; else None."""
        exchange = self.driven and self._unit.kind == EXCHANGE
        return self._with(hold="linear" if self.hold == "zoh" else "zoh") if exchange else None

    def facts(self, fitted: bool) -> tuple[str, str, str | None]:
        """Return class, file and fingerprint for a saved model."""
        step = "" if self.step is None else f" {self.step}"
        used = f"{self.outputs} {self.inputs} {self.start} {self.hold}{step}"
        identity = fingerprint(self.path, used if fitted else f"{used} {self.known}".strip())
        return type(self).__name__, self.path.name, identity

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor's arguments, for other processes."""
        outputs, rest = self.outputs if self._named else None, (self.start, self.hold, self.step)
        return type(self), (self.path, outputs, self.parameters, self.inputs, *rest)

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._unit.close()

    def __enter__(self) -> Fmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def substeps(unit: Unit, sampling_time: float, chosen: float | None) -> int:
    """Return the number of communication steps from one sample to the next.

    Raises ValueError for a `chosen` step that does not divide the sampling time, with the nearest
    divisors. Warns of such a step declared by the FMU.
    """
    step = unit.own_step if chosen is None else chosen
    if step is None:
        return 1
    count = max(math.ceil(sampling_time / step * (1 - SAME)), 1) if step > 0 else 1
    used, longer = (sampling_time / n for n in (count, max(count - 1, 1)))
    if abs(used / step - 1 if step > 0 else 1.0) <= SAME:
        return count
    if chosen is not None:
        near = " or ".join(f"{divisor:.9g}" for divisor in dict.fromkeys((used, longer)))
        raise InputError(
            f"step (--simulator-step) must divide the sampling time, {sampling_time:g} s: got "
            f"{chosen:g}; the nearest are {near}"
        )
    if step < sampling_time or not unit.any_step:
        warnings.warn(
            f"{unit.path} declares a communication step of {step:g} s, and is run with "
            f"{used:.6g} s, which divides the sampling time, {sampling_time:g} s; if it keeps to "
            f"its own step, resample the record to a multiple of {step:g} s",
            stacklevel=2,
        )
    return count


# ---------------------------------------------------------------- how outputs are read


def late_outputs(unit: Unit, task: FmuRun) -> NDArray[np.bool_]:
    """Return a mask of the outputs that follow a sample's inputs only after a step, `(outputs,)`.

    Outputs that change when an input is set, or with a declaration of no dependence, are not among
    them. Raises ValueError for an output that is not readable at its sample, or not certainly so.
    """
    late, depends = np.zeros(len(task.outputs), dtype=bool), _declared(unit, task)
    last = min(SAMPLES, len(task.time)) - 1
    usual = task.u[last]
    rows = _changes(unit, task, usual)
    if not rows or all(declared is False for declared in depends):
        return late
    asked = np.array([declared is not False for declared in depends])
    whole, short = np.empty((0, 3, len(late))), np.empty((0, 4, len(late)))
    try:
        with unit.instance() as instance:
            run = CoSimulation(unit, instance, task, spare=4 * len(rows) + 1)
            for n in range(last):
                run.drive(n)
                run.go_on(task.substeps)
            run.drive(last)
            if not task.before:
                shown = np.stack([run.show(u) for u in (usual, *rows)])
                asked &= (shown == shown[0]).all(axis=0)
            if not asked.any():
                return late
            whole = np.array([[run.after(u) for u in (usual, row, usual)] for row in rows])
            if unit.short_steps:
                short = np.array(
                    [
                        [*(run.after(u, SHORT) for u in (usual, row, row)), run.after(row)]
                        for row in rows
                    ]
                )
    except UnreadableError:
        raise
    except Exception:
        if not len(whole):
            raise
        unit.short_steps = False
    for i in np.flatnonzero(asked).tolist():
        name = f"{task.outputs[i]} of {unit.path}"
        comes_late = _comes_late(whole[..., i], short[..., i], name, depends[i])
        late[i] = bool(comes_late)
        if comes_late is None and name not in unit.doubted:
            unit.doubted.add(name)
            warnings.warn(
                f"{name} is taken not to depend on the inputs at once, which its description does "
                "not say and a run cannot tell; otherwise it comes one sample late",
                stacklevel=2,
            )
    return late


def _comes_late(whole: Array, short: Array, name: str, depends: bool | None) -> bool | None:
    """Return whether an output follows its sample's inputs only after a step; None if unknown.

    `whole`: values after steps with the usual inputs, with others, and with the usual ones,
    `(changes, 3)`; `short`: values after three short steps, the last two of them with the other
    inputs, and after a whole step, `(changes, 4)`, if the FMU makes short steps; `depends`: whether
    the FMU declares a dependence on an input. An output that jumps in a short step depends on the
    inputs at once; if it returns in the next step, there is no state.
    """
    before, changed, after = whole.T
    if not (changed != before).any():
        return False
    forgets = bool((np.abs(after - before) <= SAME * np.abs(changed - before)).all())
    if len(short):
        moves = np.diff(short, axis=1)
        moves[np.abs(moves) <= ROUNDING * np.abs(short).max()] = 0.0
        first, second, rest = moves.T
        # An FMU with internal steps does nothing in a shorter step.
        certain = ((first != 0) | (second != 0)) & (np.abs(second) <= BY_LENGTH * np.abs(rest))
        jumps = np.abs(first - second) > DEPENDS * np.abs(moves.sum(axis=1))
        if certain.any():
            depends = bool((certain & jumps).any())
    if depends and not forgets:
        raise InputError(
            f"{name} cannot be read at its sample: it depends on the inputs at once, and is "
            "computed only in the step after them; export the FMU for model exchange, or so that "
            "its outputs can be read when inputs are set"
        )
    if depends is None and forgets:
        raise InputError(
            f"{name} cannot be read at its sample: it is either a function of the inputs that is "
            "computed in the step after it, or one sample late, and steps of another length, which "
            "would tell, are not made; declare its dependencies in the model description, or "
            "export the FMU for model exchange"
        )
    return depends


def _declared(unit: Unit, task: FmuRun) -> list[bool | None]:
    """Return by output whether the FMU declares a dependence on an input; None if undeclared."""
    declared = {output.variable.name: output.dependencies for output in unit.description.outputs}
    depends: list[bool | None] = []
    for name in task.outputs:
        variables = declared.get(name)
        depends.append(None if variables is None else any(v.name in task.inputs for v in variables))
    return depends


def _changes(unit: Unit, task: FmuRun, usual: Array) -> list[Array]:
    """Return rows of inputs other than the usual one, with the extremes of an input.

    For a constant input of the record, one row has another value.
    """
    rows = []
    for j, (name, column) in enumerate(zip(task.inputs, task.u.T, strict=True)):
        if np.ptp(column) > 0:
            rows += [task.u[column.argmin()], task.u[column.argmax()]]
        else:
            rows.append(usual.copy())
            boolean = unit.by_name[name].type == "Boolean"
            rows[-1][j] = 1.0 - usual[j] if boolean else usual[j] + 1.0
    return [row for row in rows if (row != usual).any()]
