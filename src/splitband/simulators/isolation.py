"""Run a simulator of a user's file: in a process of its own, which may hang or crash, or here.

Simulators with fitted parameters run here, as a fit may itself run in a process of its own.
"""

from __future__ import annotations

import contextlib
import os
import runpy
import sys
import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from pebble import ProcessExpired

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError, one_line
from splitband.runtime.system import end_group, lead_group
from splitband.runtime.workers import Workers, ended_from_outside, result_of
from splitband.simulators.base import (
    Hold,
    KnownSimulator,
    SimulatorError,
    SimulatorTimeoutError,
    Start,
    fingerprint,
)
from splitband.simulators.fmu import Fmu
from splitband.simulators.fmu_unit import variables_of
from splitband.simulators.functions import Function, Ode, UserCode
from splitband.simulators.parameters import INITIAL, Adjustable, Parameters
from splitband.simulators.unknown import Unknown
from splitband.simulators.user_code import count_arguments

_STDOUT, _STDERR = 1, 2
"""File descriptors. Simulators, C code included, print to stderr: stdout is for results."""


@dataclass(eq=False)
class Isolated(KnownSimulator):
    """An FMU, or a function of a Python file, in a process that can be killed at any time.

    `timeout`: seconds to wait; `outputs`, `inputs`, `start`, `hold`, `step`: see `Fmu` and
    `Function`; `driven`: whether the record's inputs are used, set for an FMU by `matched`.
    """

    path: str
    function: str | None = None
    outputs: tuple[str, ...] = ()
    timeout: float | None = None
    inputs: tuple[str, ...] | None = None
    driven: bool = False
    start: Start | None = None
    hold: Hold | None = None
    step: float | None = None

    def __post_init__(self) -> None:
        """Check that held inputs are possible."""
        if self.hold == "zoh" and self.function is not None:
            raise _not_an_equation(self.name)

    @property
    def name(self) -> str:
        """Return the name in messages: the file, and the function."""
        return self.path if self.function is None else f"{self.path}:{self.function}"

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Isolated:
        """Return a copy with the variables of a record's channels and inputs, see `Fmu`."""
        if self.function is not None:
            return self
        variables = variables_of(Path(self.path))
        variables.check(self.outputs, self.inputs)
        taken = variables.inputs_for(inputs, self.inputs)
        outputs = variables.outputs_for(columns, self.outputs or None)
        return replace(self, outputs=tuple(outputs), inputs=tuple(taken), driven=any(taken))

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Simulate the channels at `time` in s, with the inputs `(time, nu)`, see `Simulator`.

        Raises SimulatorTimeoutError after the timeout, and kills the process. Raises SimulatorError
        if the simulator fails, with its message, or ends its process.
        """
        workers, head = Workers(1), None
        try:
            head = result_of(workers.submit(lead_group))
            task = workers.submit(_simulated, self, time, u)
            values, messages = result_of(task, self.timeout)
        except TimeoutError:
            raise SimulatorTimeoutError(f"within {self.timeout:g} s") from None
        except ProcessExpired as error:
            raise SimulatorError(f"it ended its process ({_how(error.exitcode)})") from None
        except BrokenProcessPool as error:
            # With a leader, the process ended before the pool knew the owner of the task.
            reason = ended_from_outside(error) if head is None else "it ended its process"
            raise SimulatorError(reason) from None
        finally:
            if head is not None:
                end_group(head)
            workers.shutdown()
        for message in messages:
            warnings.warn(message, stacklevel=2)
        return values

    def facts(self, fitted: bool) -> tuple[str, str, str | None]:
        """Return the class of the simulator, file and fingerprint for a saved model."""
        file = Path(self.path).name
        if self.function is not None:
            return "Function", file, fingerprint(self.path, self.function)
        inputs = None if self.inputs is None else [*self.inputs]
        step = "" if self.step is None else f" {self.step}"
        used = f"{[*self.outputs]} {inputs} {self.start or 0.0} {self.hold}{step}"
        return "Fmu", file, fingerprint(self.path, used)


def _how(code: int) -> str:
    """Return the end of a process in words: a signal or, on Windows, an error like 0xC0000005."""
    if code < 0:
        return f"signal {-code}"
    return f"exit status {code if code < 256 else f'0x{code:X}'}"


def _simulated(
    task: Isolated, time: Array, u: Array | None = None
) -> tuple[npt.NDArray[Any], Sequence[str]]:
    """Return the output and the warnings."""
    with contextlib.suppress(OSError):  # a program without a console has no descriptors
        os.dup2(_STDERR, _STDOUT)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            values = np.asarray(simulate(task, time, u))
        values = values.astype(float) if values.dtype == object else values
    except KeyboardInterrupt:  # by the user, not by the simulator
        raise
    except BaseException as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        raise SimulatorError(f"{kind}{one_line(error)}") from None
    finally:
        if sys.stdout is not None:
            sys.stdout.flush()
    return values, [*dict.fromkeys(str(warning.message) for warning in caught)]


def simulate(task: Isolated, time: Array, u: Array | None = None) -> npt.ArrayLike:
    """Run the simulator in this process."""
    if task.function is None:
        how: dict[str, Any] = {
            "inputs": task.inputs,
            "hold": task.hold or "linear",
            "step": task.step,
        }
        with Fmu(task.path, task.outputs or None, **how) as fmu:
            return fmu.simulate(time, u)
    function = named_in(task.path, task.function)
    if not callable(function):
        raise InputError(f"{task.path} must define a function {task.function}")
    return Function(function).simulate(time, u)


def named_in(path: str, name: str) -> Any:
    """Run the user's file and return its object of this name, or None."""
    sys.path.insert(0, str(Path(path).resolve().parent))
    try:
        return runpy.run_path(path, run_name=Path(path).stem).get(name)
    except (Exception, SystemExit) as error:
        raise InputError(f"{path} cannot be run: {type(error).__name__}: {error}") from error


def adjustable_from(  # noqa: PLR0913
    file: str,
    name: str,
    given: Mapping[str, Any],
    outputs: Sequence[str] = (),
    inputs: Sequence[str] | None = None,
    start: Start | None = None,
    hold: Hold | None = None,
    step: float | None = None,
    unknown: Sequence[Unknown] | None = None,
) -> Adjustable:
    """Return a simulator with these parameters, for runs in this process.

    Raises ValueError for an unusable file, or a `name` that is missing or of another type.

    Parameters
    ----------
    file : An .fmu, or a Python file, which is run.
    name : Name in the Python file; empty for an FMU. It is an `Ode`, a `Function`, a function of
        time as for `Function`, or a function `rhs(t, x, u, p)` of four arguments, or of five with
        w: the right-hand side of an `Ode` with its first state measured.
    given : Parameters, which override those of an `Ode` or a `Function` in the file.
    outputs, inputs : Variables of an FMU.
    start : Start of the simulator; None for its own.
    hold : Course of inputs between samples, see `Ode`; None for that of an `Ode` in the file.
    step : Communication step of an FMU.
    unknown : Unknown terms, which replace those of an `Ode` in the file.
    """
    if not name:
        return Fmu(file, outputs or None, dict(given), inputs, start or 0.0, hold or "linear", step)
    file = str(Path(file).resolve())
    simulator: Adjustable = _of_file(file, name, start, hold, unknown, given)
    return simulator


def _not_an_equation(name: str) -> InputError:
    """Return the error for held inputs of a function."""
    return InputError(
        "simulator must be a differential equation or an .fmu for hold='zoh' (--simulator-hold "
        f"zoh), also of a saved model, got {name}, which is given the samples of the inputs alone"
    )


def _no_terms(name: str) -> InputError:
    """Return the error for unknown terms of a function of time."""
    return InputError(
        "unknown (--unknown) must be left out but for a differential equation, a function of "
        f"(t, x, u, p, w), got {name}"
    )


def _of_file(
    file: str,
    name: str,
    start: Start | None,
    hold: Hold | None,
    unknown: Sequence[Unknown] | None,
    given: Mapping[str, Any],
) -> Any:
    """Return a simulator of a Python file, in any process."""
    defined = _defined(file, name, Path(file).read_bytes())
    if isinstance(defined, UserCode):
        parameters = {**(defined.parameters or {}), **given}
        changes = {} if unknown is None else {"unknown": unknown}
        if unknown is not None and not isinstance(defined, Ode):
            raise _no_terms(name)
        simulator: Any = replace(defined, parameters=parameters, **changes)  # type: ignore[type-var]
    elif not callable(defined):
        raise InputError(f"{file} must define a function, an Ode or a Function {name}")
    elif count_arguments(defined) in (4, 5):
        simulator = Ode(defined, _initial(given), parameters=dict(given), unknown=unknown)
    elif unknown is not None:
        raise _no_terms(name)
    else:
        simulator = Function(defined, dict(given))
    if start is not None:
        simulator = replace(simulator, start=start)
    if isinstance(simulator, Ode):
        simulator = replace(simulator, hold=hold or simulator.hold)
    elif hold == "zoh":
        raise _not_an_equation(name)
    return simulator.opened_by(partial(_of_file, file, name, start, hold, unknown))


@lru_cache(maxsize=16)
def _defined(file: str, name: str, content: bytes) -> Any:
    """Return the object of this name; cached by content, for one compilation a process."""
    return named_in(file, name)


def _initial(given: Mapping[str, Any]) -> list[float]:
    """Return the initial states named by the parameters, 0 for states in between."""
    values = Parameters(dict(given)).middle()
    ends = [name.removeprefix(INITIAL) for name in values if name.startswith(INITIAL)]
    numbers = [int(end) for end in ends if end.isdigit()]
    if not numbers:
        raise InputError(
            "parameters must say how many states the differential equation has, and where they "
            f"begin: {INITIAL}1=0,{INITIAL}2=-1:1"
        )
    return [values.get(f"{INITIAL}{i + 1}", 0.0) for i in range(max(numbers))]
