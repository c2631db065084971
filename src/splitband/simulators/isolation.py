"""Run a simulator of a user's file: in a process of its own, which may hang or crash, or here.

It runs here where its parameters are fitted, as a fit may itself run in a process of its own.
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
from splitband.simulators.user_code import count_arguments

_STDOUT, _STDERR = 1, 2
"""File descriptors. What a simulator prints, C code included, goes to stderr: stdout is for
results."""


@dataclass(eq=False)
class Isolated(KnownSimulator):
    """Run an FMU, or a function of a Python file, in a process that can be killed at any time.

    `timeout`: seconds to wait; `outputs`, `inputs`, `start`, `hold`, `step`: see `Fmu` and
    `Function`; `driven`: whether it takes the record's inputs, set for an FMU by `matched`.
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
        """Check that it can hold its inputs, if it is to."""
        if self.hold == "zoh" and self.function is not None:
            raise _not_an_equation(self.name)

    @property
    def name(self) -> str:
        """Return the name in messages: the file, and the function in it."""
        return self.path if self.function is None else f"{self.path}:{self.function}"

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Isolated:
        """Return it with the variables of these channels and inputs of a record, see `Fmu`."""
        if self.function is not None:
            return self
        known = variables_of(Path(self.path))
        known.check(self.outputs, self.inputs)
        taken = known.inputs_for(inputs, self.inputs)
        outputs = known.outputs_for(columns, self.outputs or None)
        return replace(self, outputs=tuple(outputs), inputs=tuple(taken), driven=any(taken))

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Simulate the channels at `time` in s, with the inputs `(time, nu)`, see `Simulator`.

        Raises SimulatorTimeoutError after the timeout; the process is then killed. Raises
        SimulatorError if the simulator fails, with its message, or ends its process.
        """
        workers, head = Workers(1), None
        try:
            head = result_of(workers.submit(lead_group))
            task = workers.submit(_simulated, self, time, u)
            values, said = result_of(task, self.timeout)
        except TimeoutError:
            raise SimulatorTimeoutError(f"within {self.timeout:g} s") from None
        except ProcessExpired as error:
            raise SimulatorError(f"it ended its process ({_how(error.exitcode)})") from None
        except BrokenProcessPool as error:
            # Once it has a leader, it ended before the pool knew who had begun its task.
            said = ended_from_outside(error) if head is None else "it ended its process"
            raise SimulatorError(said) from None
        finally:
            if head is not None:  # with the processes that it has started
                end_group(head)
            workers.shutdown()
        for each in said:
            warnings.warn(each, stacklevel=2)
        return values

    def facts(self, fitted: bool) -> tuple[str, str, str | None]:
        """Return the class that it stands for, its file, and what a saved model knows it by."""
        file = Path(self.path).name
        if self.function is not None:
            return "Function", file, fingerprint(self.path, self.function)
        inputs = None if self.inputs is None else [*self.inputs]
        step = "" if self.step is None else f" {self.step}"
        used = f"{[*self.outputs]} {inputs} {self.start or 0.0} {self.hold}{step}"
        return "Fmu", file, fingerprint(self.path, used)


def _how(code: int) -> str:
    """Return how a process ended: by a signal or, on Windows, by an error such as 0xC0000005."""
    if code < 0:
        return f"signal {-code}"
    return f"exit status {code if code < 256 else f'0x{code:X}'}"


def _simulated(
    task: Isolated, time: Array, u: Array | None = None
) -> tuple[npt.NDArray[Any], Sequence[str]]:
    """Return the output and the warnings."""
    with contextlib.suppress(OSError):  # a program without a console has neither
        os.dup2(_STDERR, _STDOUT)
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("default")
            values = np.asarray(simulate(task, time, u))
        values = values.astype(float) if values.dtype == object else values
    except KeyboardInterrupt:  # the user's, not the simulator's
        raise
    except BaseException as error:
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        raise SimulatorError(f"{kind}{one_line(error)}") from None
    finally:
        if sys.stdout is not None:
            sys.stdout.flush()
    return values, [*dict.fromkeys(str(each.message) for each in caught)]


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
    """Run the user's file and return its object of that name, or None."""
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
) -> Adjustable:
    """Return a simulator with these parameters, which runs in this process.

    Raises ValueError for a file that cannot be run, or whose `name` is missing or of another type.

    Parameters
    ----------
    file : An .fmu, or a Python file, which is run.
    name : Name in the Python file; empty for an FMU. It stands for an `Ode`, a `Function`, a
        function of time as `Function` takes it, or a function `rhs(t, x, u, p)` of four arguments:
        the right-hand side of an `Ode` whose first state is measured.
    given : Parameters, which override those of an `Ode` or a `Function` in the file.
    outputs, inputs : Variables of an FMU.
    start : Of the simulator; None for its own.
    hold : How inputs run between samples, see `Ode`; None for what an `Ode` of the file says.
    step : Communication step of an FMU.
    """
    if not name:
        return Fmu(file, outputs or None, dict(given), inputs, start or 0.0, hold or "linear", step)
    file = str(Path(file).resolve())
    simulator: Adjustable = _of_file(file, name, start, hold, given)
    return simulator


def _not_an_equation(name: str) -> InputError:
    """Return the error for a function whose inputs are to be held."""
    return InputError(
        "simulator must be a differential equation or an .fmu for --simulator-hold zoh, "
        f"also of a saved model, got {name}, which is given the samples of the inputs alone"
    )


def _of_file(
    file: str, name: str, start: Start | None, hold: Hold | None, given: Mapping[str, Any]
) -> Any:
    """Return a simulator of a Python file, in any process."""
    found = _defined(file, name, Path(file).read_bytes())
    if isinstance(found, UserCode):
        parameters = {**(found.parameters or {}), **given}
        simulator: Any = replace(found, parameters=parameters)  # type: ignore[type-var]
    elif not callable(found):
        raise InputError(f"{file} must define a function, an Ode or a Function {name}")
    elif count_arguments(found) == 4:
        simulator = Ode(found, _initial(given), parameters=dict(given))
    else:
        simulator = Function(found, dict(given))
    if start is not None:
        simulator = replace(simulator, start=start)
    if isinstance(simulator, Ode):
        simulator = replace(simulator, hold=hold or simulator.hold)
    elif hold == "zoh":
        raise _not_an_equation(name)
    return simulator.opened_by(partial(_of_file, file, name, start, hold))


@lru_cache(maxsize=16)
def _defined(file: str, name: str, content: bytes) -> Any:
    """Return the object of that name, one for a content, so that it is compiled once a process."""
    return named_in(file, name)


def _initial(given: Mapping[str, Any]) -> list[float]:
    """Return the initial states named by the parameters; states between them begin at 0."""
    told = Parameters(dict(given)).middle()
    ends = [name.removeprefix(INITIAL) for name in told if name.startswith(INITIAL)]
    numbers = [int(end) for end in ends if end.isdigit()]
    if not numbers:
        raise InputError(
            "parameters must say how many states the differential equation has, and where they "
            f"begin: {INITIAL}1=0,{INITIAL}2=-1:1"
        )
    return [told.get(f"{INITIAL}{i + 1}", 0.0) for i in range(max(numbers))]
