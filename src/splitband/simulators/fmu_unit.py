"""Unpack a functional mock-up unit, and lend its instances."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

from splitband.simulators.fmu_variables import Variables

EXCHANGE, COSIMULATION = "ModelExchange", "CoSimulation"
"""Kinds of FMUs by FMPy's names. Model exchange is preferred: its outputs can be read at once."""


class Unit:
    """Hold an unpacked FMU and an idle instance of it.

    The archive is unpacked once; between runs an instance is reset, not loaded again. The unpacked
    files are removed by `close`, when the object is deleted, or when the process ends.

    Attributes
    ----------
    description : By FMPy.
    variables : The names of its variables.
    kind : `EXCHANGE` or `COSIMULATION`.
    readings : How its outputs are read, by outputs, inputs and sampling time.
    """

    def __init__(self, path: Path) -> None:
        try:
            import fmpy  # noqa: PLC0415  the optional extra
        except ImportError:
            raise ValueError("an FMU needs FMPy: pip install 'splitband[fmu]'") from None
        self.path = path
        if not path.is_file():
            raise FileNotFoundError(f"no such FMU: {path}")
        self.readings: dict[Any, Any] = {}
        self.folder = tempfile.mkdtemp(prefix="splitband-fmu-")
        self._idle: list[Any] = []  # the instance while it does not run
        # Unlike `weakref.finalize` it also runs at the end of a worker process, and does not remove
        # the files of a parent process.
        self._end = Finalize(self, _free, (self._idle, self.folder), exitpriority=0)
        try:
            fmpy.extract(str(path), self.folder)
            self.description = fmpy.read_model_description(self.folder)
            self.variables = Variables.of(path, self.description, Path(self.folder))
            self.kind = EXCHANGE if self.description.modelExchange is not None else COSIMULATION
            self._idle.append(self._first())
        except Exception as error:
            self.close()
            raise ValueError(f"{path} is not an FMU that can be run here: {error}") from error
        self.by_name = {v.name: v for v in self.description.modelVariables}

    @property
    def version(self) -> int:
        """Return the version of FMI: 1, 2 or 3."""
        return int(self.description.fmiVersion.split(".")[0])

    @contextmanager
    def instance(self) -> Iterator[Any]:
        """Lend an instance; it is used again only after success.

        An instance that failed or still runs cannot be freed.
        """
        instance = self._idle.pop() if self._idle else self._instance()
        yield instance
        if hasattr(instance, "reset"):
            instance.reset()
            self._idle.append(instance)
        else:  # model exchange by FMI 1
            instance.freeInstance()

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._end()

    def _first(self) -> Any:
        """Return an instance; where that for model exchange fails, one for co-simulation."""
        try:
            return self._instance()
        except Exception:
            if self.kind == COSIMULATION or self.description.coSimulation is None:
                raise
            self.kind = COSIMULATION
            return self._instance()

    def _instance(self) -> Any:
        from fmpy.simulation import instantiate_fmu  # noqa: PLC0415  the optional extra

        if not Path(self.folder).is_dir():
            raise ValueError(f"the FMU {self.path} has been closed")
        return instantiate_fmu(self.folder, self.description, self.kind)


def variables_of(path: Path) -> Variables:
    """Return the variables of an FMU, without running its code."""
    try:
        import fmpy  # noqa: PLC0415  the optional extra
    except ImportError:
        raise ValueError("an FMU needs FMPy: pip install 'splitband[fmu]'") from None
    with tempfile.TemporaryDirectory(prefix="splitband-fmu-") as folder:
        try:
            fmpy.extract(str(path), folder, include=lambda name: name == "modelDescription.xml")
            description = fmpy.read_model_description(folder)
        except Exception as error:
            raise ValueError(f"{path} is not an FMU that can be run here: {error}") from error
        return Variables.of(path, description, Path(folder))


def _free(idle: list[Any], folder: str) -> None:
    while idle:
        idle.pop().freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
