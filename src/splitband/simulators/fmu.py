"""A simulator that is a functional mock-up unit."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Fmu:
    """A functional mock-up unit, run by FMPy (the extra `splitband[fmu]`).

    The archive is unpacked once; its instance is reset, not loaded again, between runs. Use it as
    a context manager, or `close` it, to remove the unpacked files.

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
        self.path, self.start_values = Path(path), dict(start_values or {})
        if not self.path.is_file():
            raise FileNotFoundError(f"no such FMU: {self.path}")
        self._simulate_fmu = fmpy.simulate_fmu
        self._folder: str | None = None
        self._instance: Any = None
        try:
            self._folder = tempfile.mkdtemp(prefix="splitband-fmu-")
            fmpy.extract(str(self.path), self._folder)
            self._description = fmpy.read_model_description(self._folder)
            self._instance = instantiate_fmu(self._folder, self._description)
        except Exception as error:
            self.close()
            raise ValueError(f"{self.path} is not an FMU that can be run here: {error}") from error
        variables = {v.name: v for v in self._description.modelVariables}
        given = outputs or [v.name for v in variables.values() if v.causality == "output"]
        for name in (*given, *self.start_values):
            if name not in variables:
                self.close()
                raise ValueError(f"{self.path} has no variable {name}; it has {_some(variables)}")
        self.outputs = list(given)

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`."""
        if self._instance is None:
            raise ValueError(f"the FMU {self.path} has been closed, or an earlier run failed")
        # Kept for the next run only after success: one that failed or still runs cannot be freed.
        instance, self._instance = self._instance, None
        step = float(time[1] - time[0])
        result = self._simulate_fmu(
            self._folder,
            model_description=self._description,
            fmu_instance=instance,
            start_time=float(time[0]),
            stop_time=float(time[-1]),
            output_interval=step,
            start_values=self.start_values,
            output=self.outputs,
        )
        instance.reset()
        self._instance = instance
        if result["time"][-1] < time[-1] - step / 2:
            raise ValueError(f"the FMU {self.path} stopped at {result['time'][-1]:g} s")
        values = np.column_stack([result[name] for name in self.outputs])
        # At an event FMPy stores more samples than the grid has: take the grid's.
        at = np.searchsorted(result["time"], time - step / 4)
        return values[np.minimum(at, len(values) - 1)]

    def fingerprint(self) -> str:
        """What the trajectory depends on besides the time grid; the key of the cache."""
        content = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return f"{content} {self.outputs} {sorted(self.start_values.items())}"

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        if self._instance is not None:
            self._instance.freeInstance()
            self._instance = None
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def __enter__(self) -> Fmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _some(names: Mapping[str, Any]) -> str:
    shown = list(names)[:10]
    return ", ".join(shown) + (", ..." if len(names) > 10 else "")
