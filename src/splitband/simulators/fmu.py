"""Run a functional mock-up unit as a simulator."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array
from splitband.runtime.options import WithRepr
from splitband.simulators.parameters import Given, Parameters, Point, Response


class Fmu(WithRepr):
    """Run a functional mock-up unit with FMPy (the extra `splitband[fmu]`).

    The archive is unpacked once; between runs its instance is reset, not loaded again. The unpacked
    files are removed by `close`, at the end of a `with` block, when the object is deleted, or when
    the process ends.

    Parameters
    ----------
    path : Path of the .fmu file.
    outputs : Variables that correspond to the record's channels; by default the FMU's outputs.
    parameters : Start values of parameters and variables by name: a number, or a range
        `(low, high)` in which it is fitted. They are the same for all records.
    inputs : Variables that take the record's inputs; by default the FMU's inputs, if the record has
        any. Co-simulation holds them until the next sample, model exchange interpolates.
    """

    states = 0
    difference = 1e-4

    def __init__(
        self,
        path: str | Path,
        outputs: Sequence[str] | None = None,
        parameters: Given | None = None,
        inputs: Sequence[str] | None = None,
    ) -> None:
        try:
            import fmpy  # noqa: PLC0415  the optional extra
            from fmpy.simulation import instantiate_fmu  # noqa: PLC0415
        except ImportError:
            raise ValueError("an FMU needs FMPy: pip install 'splitband[fmu]'") from None
        self.path = Path(path)
        self.parameters = None if parameters is None else dict(parameters)
        self.known = Parameters(dict(parameters or {}))
        if not self.path.is_file():
            raise FileNotFoundError(f"no such FMU: {self.path}")
        self._simulate_fmu, self._instantiate = fmpy.simulate_fmu, instantiate_fmu
        self._folder = tempfile.mkdtemp(prefix="splitband-fmu-")
        self._idle: list[Any] = []  # the instance while it does not run
        # Unlike `weakref.finalize` it also runs at the end of a worker process, and does not remove
        # the files of a parent process.
        self._end = Finalize(self, _free, (self._idle, self._folder), exitpriority=0)
        try:
            fmpy.extract(str(self.path), self._folder)
            self._description = fmpy.read_model_description(self._folder)
            self._idle.append(instantiate_fmu(self._folder, self._description))
        except Exception as error:
            self.close()
            raise ValueError(f"{self.path} is not an FMU that can be run here: {error}") from error
        variables = {v.name: v for v in self._description.modelVariables}
        given = outputs or [v.name for v in variables.values() if v.causality == "output"]
        taken = [v.name for v in variables.values() if v.causality == "input"]
        self._inputs = [*(taken if inputs is None else inputs)]
        self.inputs = None if inputs is None else list(inputs)
        for name in (*given, *self._inputs, *self.known.given):
            if name not in variables:
                self.close()
                known = ", ".join([*variables][:10]) + (", ..." if len(variables) > 10 else "")
                raise ValueError(f"{self.path} has no variable {name}; it has {known}")
        self.outputs = list(given)

    @property
    def adjustable(self) -> bool:
        """Return whether it needs fitting or inputs, and so a `GreyBox` to run it."""
        return bool(self.known.free) or bool(self._inputs)

    def precise(self) -> Fmu:
        """Return the FMU itself: its tolerances cannot be tightened here."""
        return self

    def fixed(self, values: Mapping[str, float]) -> Fmu:
        """Return the FMU with some parameters set to these values."""
        given = self.known.fixed(values).given
        return Fmu(self.path, self.outputs, given, self.inputs)

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s.

        A parameter with a range takes the middle of it.
        """
        return self._run(time, None, self.known.middle())

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
                    raise ValueError(f"the FMU {self.path} failed: {error}") from error
                y = np.full((len(time), len(self.outputs)), np.nan)
            found.append((y, np.empty((len(time), 0))))
        return found

    def _run(self, time: Array, u: Array | None, values: Mapping[str, float]) -> Array:
        instance = self._idle.pop() if self._idle else self._instance()
        step = float(time[1] - time[0])
        result = self._simulate_fmu(
            self._folder,
            model_description=self._description,
            fmu_instance=instance,
            start_time=float(time[0]),
            stop_time=float(time[-1]),
            output_interval=step,
            start_values=dict(values),
            input=self._signals(time, u),
            output=self.outputs,
        )
        instance.reset()
        # Reused only after success: an instance that failed or still runs cannot be freed.
        self._idle.append(instance)
        if result["time"][-1] < time[-1] - step / 2:
            raise ValueError(f"the FMU {self.path} stopped at {result['time'][-1]:g} s")
        found = np.column_stack([result[name] for name in self.outputs])
        # FMPy stores additional samples at events: keep those of the grid.
        at = np.searchsorted(result["time"], time - step / 4)
        return np.asarray(found[np.minimum(at, len(found) - 1)])

    def _instance(self) -> Any:
        """Return a new instance, to replace one that failed."""
        if not Path(self._folder).is_dir():
            raise ValueError(f"the FMU {self.path} has been closed")
        return self._instantiate(self._folder, self._description)

    def _signals(self, time: Array, u: Array | None) -> Any:
        """Return the inputs in FMPy's format."""
        if u is None or not self._inputs:
            return None
        if u.shape[1] != len(self._inputs):
            raise ValueError(
                f"inputs must be {u.shape[1]} variables of the FMU, as many as the record has, got "
                f"{', '.join(self._inputs)}"
            )
        signals = np.empty(len(time), [("time", float), *((name, float) for name in self._inputs)])
        signals["time"] = time
        for name, column in zip(self._inputs, u.T, strict=True):
            signals[name] = column
        return signals

    def digest(self) -> str:
        """Return an identifier of the response, without the values of parameters."""
        content = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return f"{content} {self.outputs} {self._inputs}"

    def __getstate__(self) -> dict[str, Any]:
        """Return the constructor's arguments, with which another process opens it."""
        return {"path": self.path, "outputs": self.outputs, "parameters": self.parameters,
                "inputs": self.inputs}  # fmt: skip

    def __setstate__(self, state: dict[str, Any]) -> None:
        Fmu.__init__(self, **state)

    def fingerprint(self) -> str:
        """Return the cache key: everything the output depends on except the time grid."""
        content = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return f"{content} {self.outputs} {sorted(self.known.middle().items())}"

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._end()

    def __enter__(self) -> Fmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _free(idle: list[Any], folder: str) -> None:
    while idle:
        idle.pop().freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
