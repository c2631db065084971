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

from splitband.runtime.options import Written

Array = npt.NDArray[np.float64]


class Fmu(Written):
    """Run a functional mock-up unit by FMPy (the extra `splitband[fmu]`).

    The archive is unpacked once; its instance is reset, not loaded again, between runs. The
    unpacked files are removed by `close`, at the end of a `with` block, with the object, or when
    the process ends.

    Parameters
    ----------
    path : Of the .fmu file.
    outputs : Variables that correspond to the record's channels; by default the FMU's outputs.
    start_values : Parameters and initial values by name.
    """

    def __init__(
        self,
        path: str | Path,
        outputs: Sequence[str] | None = None,
        start_values: Mapping[str, float] | None = None,
    ) -> None:
        try:
            import fmpy  # noqa: PLC0415  the optional extra
            from fmpy.simulation import instantiate_fmu  # noqa: PLC0415
        except ImportError:
            raise ValueError("an FMU needs FMPy: pip install 'splitband[fmu]'") from None
        self.path = Path(path)
        self.start_values = None if start_values is None else dict(start_values)
        if not self.path.is_file():
            raise FileNotFoundError(f"no such FMU: {self.path}")
        self._simulate_fmu = fmpy.simulate_fmu
        self._folder = tempfile.mkdtemp(prefix="splitband-fmu-")
        self._idle: list[Any] = []  # the instance while it does not run
        # Unlike `weakref.finalize` it also runs at the end of a worker process, and leaves alone
        # what a parent process has unpacked.
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
        for name in (*given, *(self.start_values or {})):
            if name not in variables:
                self.close()
                raise ValueError(f"{self.path} has no variable {name}; it has {_some(variables)}")
        self.outputs = list(given)

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s."""
        if not self._idle:
            raise ValueError(f"the FMU {self.path} has been closed, or an earlier run failed")
        # Kept for the next run only after success: one that failed or still runs cannot be freed.
        instance = self._idle.pop()
        step = float(time[1] - time[0])
        result = self._simulate_fmu(
            self._folder,
            model_description=self._description,
            fmu_instance=instance,
            start_time=float(time[0]),
            stop_time=float(time[-1]),
            output_interval=step,
            start_values=self.start_values or {},
            output=self.outputs,
        )
        instance.reset()
        self._idle.append(instance)
        if result["time"][-1] < time[-1] - step / 2:
            raise ValueError(f"the FMU {self.path} stopped at {result['time'][-1]:g} s")
        values = np.column_stack([result[name] for name in self.outputs])
        # At an event FMPy stores more samples than the grid has: take the grid's.
        at = np.searchsorted(result["time"], time - step / 4)
        return values[np.minimum(at, len(values) - 1)]

    def fingerprint(self) -> str:
        """Return the cache key: all that the output depends on besides the time grid."""
        content = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return f"{content} {self.outputs} {sorted((self.start_values or {}).items())}"

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


def _some(names: Mapping[str, Any]) -> str:
    shown = list(names)[:10]
    return ", ".join(shown) + (", ..." if len(names) > 10 else "")
