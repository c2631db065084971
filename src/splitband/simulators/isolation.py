"""Run a user's simulator in a separate process, which may hang or crash.

`python -m splitband.simulators.isolation FOLDER` is that process. The folder holds the task and
the times, and receives the result.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import runpy
import signal
import subprocess
import sys
import tempfile
import threading
import time as clock
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array
from splitband.runtime.errors import one_line
from splitband.simulators.base import SimulatorError, SimulatorTimeoutError, within
from splitband.simulators.fmu import Fmu
from splitband.simulators.fmu_unit import variables_of
from splitband.simulators.function import Function
from splitband.simulators.sources import digest, source_files
from splitband.simulators.starting import Start

_START = 20.0
"""Seconds for the start of the process, in addition to the simulator's timeout. By eye."""
_STDERR = 2
"""File descriptor for everything that the simulator prints, including its C code: stdout is kept
for results."""
_TASK, _TIME, _INPUTS = "task.json", "time.npy", "inputs.npy"
_VALUES, _FAILURE = "values.npy", "failure.json"


@dataclass(frozen=True)
class Isolated:
    """Run an FMU, or a function of a Python file, in a process that can be killed at any time.

    Attributes
    ----------
    path : Path of the file.
    function : Name of the function in a Python file; None for an FMU.
    outputs : Output variables of an FMU; empty for those of the channels' names.
    timeout : Seconds to wait; None for no limit.
    reads : Other files that the output depends on.
    cache : Folder to store outputs in, see `run`.
    inputs : Variables of an FMU that take the record's inputs; None for those of their names.
    driven : Whether it takes the record's inputs; set for an FMU by `matched`.
    start : Time of a record's first sample in s, or "record"; None for 0, which a function of time
        alone does not take for granted.
    """

    path: str
    function: str | None = None
    outputs: tuple[str, ...] = ()
    timeout: float | None = None
    reads: tuple[str, ...] = ()
    cache: str | None = None
    inputs: tuple[str, ...] | None = None
    driven: bool = False
    start: Start | None = None

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
        with tempfile.TemporaryDirectory(prefix="splitband-") as name:
            folder = Path(name)
            (folder / _TASK).write_text(json.dumps(asdict(self)), encoding="utf-8")
            np.save(folder / _TIME, time)
            if u is not None:
                np.save(folder / _INPUTS, u)
            patience = None if self.timeout is None else self.timeout + _START
            status = _run_in(folder, patience)
            if (folder / _VALUES).is_file():
                return np.asarray(np.load(folder / _VALUES, allow_pickle=False))
            if not (folder / _FAILURE).is_file():
                how = f"signal {-status}" if status < 0 else f"exit status {status}"
                raise SimulatorError(f"it ended its process ({how})")
            kind, said = json.loads((folder / _FAILURE).read_text(encoding="utf-8"))
        if kind == "KeyboardInterrupt":
            raise KeyboardInterrupt
        if kind == SimulatorTimeoutError.__name__:
            raise SimulatorTimeoutError
        raise SimulatorError(said)

    def fingerprint(self) -> str:
        """Return an identifier of everything the output depends on except the time grid.

        It covers the content of the file, of the modules that it imports and of the files `reads`.
        """
        if self.function is not None:
            return f"{digest([*source_files(self.path), *self.reads])} {self.function}"
        content = hashlib.sha256(Path(self.path).read_bytes()).hexdigest()
        outputs = [*self.outputs]
        inputs = None if self.inputs is None else [*self.inputs]
        # In the format of an `Fmu` without parameters.
        alone = f"{content} {outputs} {inputs} {self.start or 0.0} False []"
        return f"{alone} {digest(self.reads)}" if self.reads else alone


def _run_in(folder: Path, patience: float | None) -> int:
    """Run the process that the folder describes and return its exit status."""
    # Behind the user's own, whose modules may have the names of ours.
    package = str(Path(__file__).resolve().parents[2])
    known = os.environ.get("PYTHONPATH")
    search = os.pathsep.join([known, package] if known else [package])
    process = subprocess.Popen(
        # -P keeps Python from importing modules out of the working directory.
        [sys.executable, "-P", "-m", "splitband.simulators.isolation", str(folder)],
        env=os.environ | {"PYTHONPATH": search, "TMPDIR": str(folder)},
        stdout=_STDERR,
        start_new_session=True,
    )
    try:
        return process.wait(patience)
    except subprocess.TimeoutExpired:
        raise SimulatorTimeoutError from None
    finally:
        if hasattr(os, "killpg"):  # kill its child processes as well
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        process.wait()


def named_in(path: str, name: str) -> Any:
    """Run the user's file and return its object of that name, or None."""
    sys.path.insert(0, str(Path(path).resolve().parent))
    try:
        return runpy.run_path(path, run_name=Path(path).stem).get(name)
    except (Exception, SystemExit) as error:
        raise ValueError(f"{path} cannot be run: {type(error).__name__}: {error}") from error


def _simulate(task: Isolated, time: Array, u: Array | None = None) -> npt.ArrayLike:
    if task.function is not None:
        function = named_in(task.path, task.function)
        if not callable(function):
            raise ValueError(f"{task.path} must define a function {task.function}")
        return Function(function).simulate(time, u)
    with Fmu(task.path, task.outputs or None, inputs=task.inputs) as fmu:
        return fmu.simulate(time, u)


def _end_with_parent(parent: int) -> None:
    """End this process when its parent process has ended."""
    while os.getppid() == parent:
        clock.sleep(1)
    os._exit(1)


def _main(folder: Path) -> None:
    threading.Thread(target=_end_with_parent, args=(os.getppid(),), daemon=True).start()
    facts = json.loads((folder / _TASK).read_text(encoding="utf-8"))
    listed = [name for name, value in facts.items() if isinstance(value, list)]
    task = Isolated(**(facts | {name: tuple(facts[name]) for name in listed}))
    time = np.load(folder / _TIME, allow_pickle=False)
    given = (folder / _INPUTS).is_file()
    u = np.load(folder / _INPUTS, allow_pickle=False) if given else None
    try:
        values = np.asarray(within(task.timeout, lambda: _simulate(task, time, u)))
        if values.dtype == object:
            values = values.astype(float)
        np.save(folder / "partial.npy", values, allow_pickle=False)
        (folder / "partial.npy").rename(folder / _VALUES)
    except BaseException as error:
        kind = type(error).__name__
        said = one_line(error) if isinstance(error, ValueError) else f"{kind}: {one_line(error)}"
        (folder / _FAILURE).write_text(json.dumps([kind, said]), encoding="utf-8")
    sys.stdout.flush()
    os._exit(0)  # ends at once, even if the simulator left threads running


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
