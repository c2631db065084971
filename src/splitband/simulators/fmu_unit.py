"""Unpack a functional mock-up unit, lend instances, and match variables to a record's columns."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

from splitband.records.signals import bare_name
from splitband.runtime.errors import InputError, missing

EXCHANGE, COSIMULATION = "ModelExchange", "CoSimulation"
"""Kinds of FMUs by FMPy's names. Model exchange is preferred: its outputs are always readable."""
WHOLE = (
    *("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16"),
    *("Int32", "UInt32", "Int64", "UInt64"),
)
"""Types of whole numbers."""
REAL = "Real", "Float32", "Float64"
NUMERIC = *REAL, "Boolean", *WHOLE
"""Types of channels and inputs."""
SIGNALS = "Signals"
"""Name of the element with the signals of our own exported FMUs: labels, which are the names of the
record's columns, and optional inputs."""
_MOST = 12
"""Largest number of names in a message. Layout."""
_OLDEST = "0.3.29"
"""Oldest FMPy. In 0.3.26 outputs computed in a step of co-simulation are a step late."""


class Variables:
    """The names of an FMU's variables; `description` by FMPy.

    `outputs` and `inputs` of an FMU are numbers; `inputs` must be driven, while the `optional` ones
    of an FMU of this package, for measured samples, may keep their start values. `labels` maps a
    variable to its column of the record, or to its own name.
    """

    def __init__(self, path: Path, description: Any) -> None:
        every, signals = description.modelVariables, _signals(path)
        self.file, self.names = path, [v.name for v in every]
        self.labels = {name: signals.get(name, {}).get("label", name) for name in self.names}
        optional = {name for name, facts in signals.items() if facts.get("optional") == "true"}
        usable = [v for v in every if v.type in NUMERIC and not (v.shape or v.dimensions)]
        inputs = [v.name for v in usable if v.causality == "input"]
        self.outputs = [v.name for v in usable if v.causality == "output"]
        # Parameters are no signals, even with the name of a channel.
        signals_too = [v for v in usable if "arameter" not in v.causality]
        self.others = [v.name for v in signals_too if v.name not in {*self.outputs, *inputs}]
        self.optional = [name for name in inputs if name in optional]
        self.inputs = [name for name in inputs if name not in self.optional]
        self.able = {*inputs, *(v.name for v in usable if v.variability == "tunable")}
        self.arrays = [
            v.name for v in every if v.causality == "input" and (v.shape or v.dimensions)
        ]

    def check(self, outputs: Iterable[str] | None, inputs: Iterable[str] | None) -> None:
        """Raise ValueError for unknown variables, and for inputs that cannot be driven."""
        inputs = [name for name in inputs or () if name]
        for name in (*(outputs or ()), *inputs):
            if name not in self.names:
                raise InputError(f"{self.file} has no variable {name}; it has {listed(self.names)}")
        for name in inputs:
            if name not in self.able:
                raise InputError(
                    f"inputs must be inputs of {self.file}: {name} is none; it has "
                    f"{listed([*self.inputs, *self.optional])}"
                )

    def outputs_for(self, columns: Sequence[str], chosen: Sequence[str] | None) -> list[str]:
        """Return the variables of the channels: the chosen ones, or those of their names or labels.

        Raises ValueError, with both lists, for an ambiguous or missing match.
        """
        if chosen is not None and len(chosen) == len(columns):
            return [*chosen]
        names = [*self.outputs, *self.others]
        matches = [""] if chosen is not None else _by_name(columns, names, self.labels)
        if not all(matches) and chosen is None and len(columns) == len(self.outputs) == 1:
            return [*self.outputs]
        if not all(matches):
            raise InputError(
                f"outputs (--simulator-columns) must name the variable of {self.file} for each of "
                f"the record's channels, {listed(columns)}, in their order: "
                + (f"got {listed(chosen)}" if chosen else f"it has {listed(self.outputs)}")
            )
        return matches

    def inputs_for(self, inputs: Sequence[str], chosen: Sequence[str] | None) -> list[str]:
        """Return the variables of the inputs: the chosen ones, or those of their names or labels.

        An input unknown to the FMU has "". Raises ValueError, with both lists, for an ambiguous or
        missing match, or for an input of the FMU that would not be driven.
        """
        if chosen is not None and len(chosen) in (0, len(inputs)):
            return [*chosen]
        if chosen is None and self.arrays:
            raise InputError(
                f"inputs (--simulator-inputs) must name the inputs of {self.file} that are driven: "
                f"{listed(self.arrays)} is an array, which cannot be; it keeps its start values"
            )
        if chosen is None:
            matches = _by_name(inputs, [*self.inputs, *self.optional], self.labels)
            if {*self.inputs} <= {*matches}:
                return matches if any(matches) else []
            if len(inputs) == len(self.inputs) == 1:
                return [*self.inputs]
        raise InputError(
            f"inputs (--simulator-inputs) must name the variable of {self.file} for each of the "
            f"record's inputs, {listed(inputs) or 'of which it has none'}, in their order: "
            + (f"got {listed(chosen)}" if chosen else f"it has {listed(self.inputs)}")
            + '; "" for one that it does not take; inputs that are not named keep their start '
            "values, and with an empty list all do"
        )


def _by_name(
    columns: Sequence[str], variables: Sequence[str], labels: Mapping[str, str]
) -> list[str]:
    """Return the variables with these labels or names, if need be without units; else ""."""
    # A label precedes an equal name of ours, such as `observe`.
    by_label = {labels[name]: name for name in sorted(variables, key=lambda n: labels[n] != n)}
    for names in (by_label, dict(zip(variables, variables, strict=True))):
        if {*columns} <= {*names}:
            return [names[name] for name in columns]
    matches = [[v for v in variables if bare_name(labels[v]) == bare_name(c)] for c in columns]
    alone = [names[0] if len(names) == 1 else "" for names in matches]
    return [name if alone.count(name) == 1 else "" for name in alone]


def listed(names: Sequence[str]) -> str:
    """Return the first names for a message."""
    return ", ".join(names[:_MOST]) + (", ..." if len(names) > _MOST else "")


def _signals(path: Path) -> dict[str, dict[str, str]]:
    """Return the attributes of signals by name, from our own annotation in a model description."""
    with ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    listed = root.iterfind(f"VendorAnnotations/Tool[@name='splitband']/{SIGNALS}/Signal")
    return {signal.get("name", ""): dict(signal.attrib) for signal in listed}


class Unit:
    """An unpacked FMU and an idle instance.

    The archive is unpacked once; between runs an instance is reset, not loaded again. The unpacked
    files are removed by `close`, when the object is deleted, or when the process ends.

    Attributes
    ----------
    checked : Remarks on the dependence on a communication step, by step in s; possibly empty.
    doubted : Outputs with a warning about an unknown dependence.
    version : Version of FMI, 2 or 3.
    short_steps : Whether steps of any length are possible, as far as known.
    reads_before : Whether outputs are unreadable between inputs and a step, as far as known.
    """

    def __init__(self, path: Path) -> None:
        fmpy = _fmpy()
        self.path = path
        if not path.is_file():
            raise FileNotFoundError(f"no such FMU: {path}")
        self.checked: dict[float, str] = {}
        self.doubted: set[str] = set()
        self.reads_before = False
        self.folder = tempfile.mkdtemp(prefix="splitband-fmu-")
        self._idle: list[Any] = []  # the instance while it does not run
        # Unlike `weakref.finalize`, `Finalize` also runs at the end of a worker process, and does
        # not remove the files of a parent process.
        self._end = Finalize(self, _free, (self._idle, self.folder), exitpriority=0)
        try:
            fmpy.extract(str(path), self.folder)
            self.description = _description(self.folder)
            self.variables = Variables(path, self.description)
            self.kind = EXCHANGE if self.description.modelExchange is not None else COSIMULATION
            self._idle.append(self._first())
        except Exception as error:
            self.close()
            raise InputError(f"{path} is not an FMU that can be run here: {error}") from error
        self.by_name = {v.name: v for v in self.description.modelVariables}
        self.version = int(self.description.fmiVersion.split(".")[0])
        self.short_steps = self.kind == COSIMULATION and self.any_step

    def settable(self) -> list[str]:
        """Return the names of the variables with settable start values."""
        from fmpy import simulation as by_fmpy  # noqa: PLC0415  the optional extra

        begin, later = by_fmpy.settable_in_instantiated, by_fmpy.settable_in_initialization_mode
        variables = [v for v in self.description.modelVariables if v.variability != "constant"]
        return [v.name for v in variables if begin(v) or later(v)]

    @property
    def own_step(self) -> float | None:
        """Return the declared communication step in s; None without one."""
        experiment = self.description.defaultExperiment
        step = self.description.coSimulation.fixedInternalStepSize
        step = step or (experiment and experiment.stepSize)
        return float(step) if step and float(step) > 0 else None

    @property
    def any_step(self) -> bool:
        """Return whether communication steps of any length are declared possible."""
        return bool(self.description.coSimulation.canHandleVariableCommunicationStepSize)

    @contextmanager
    def instance(self) -> Iterator[Any]:
        """Lend an instance, reused only after success; a failed or running one cannot be freed."""
        instance = self._idle.pop() if self._idle else self._instance()
        yield instance
        instance.terminate()
        try:
            instance.reset()
        except Exception:  # without support for a reset
            instance.freeInstance()
        else:
            self._idle.append(instance)

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        self._end()

    def _first(self) -> Any:
        """Return an instance for model exchange or, if it fails, for co-simulation."""
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
            raise InputError(f"the FMU {self.path} has been closed")
        return instantiate_fmu(self.folder, self.description, self.kind)


def variables_of(path: Path) -> Variables:
    """Return the variables of an FMU; its code is not run."""
    _fmpy()
    try:
        return Variables(path, _description(str(path)))
    except Exception as error:
        raise InputError(f"{path} is not an FMU that can be run here: {error}") from error


def _fmpy() -> Any:
    try:
        import fmpy  # noqa: PLC0415  the optional extra
    except ImportError:
        raise missing("an FMU", "FMPy", "fmu") from None
    there, oldest = (
        [int(n) for n in re.findall(r"\d+", v)[:3]] for v in (fmpy.__version__, _OLDEST)
    )
    if there < oldest:
        raise missing("an FMU", f"FMPy {_OLDEST} or newer, not {fmpy.__version__}", "fmu")
    return fmpy


def _description(source: str) -> Any:
    """Return the model description by FMPy; raises ValueError for FMI 1."""
    description = _fmpy().read_model_description(source)
    if description.fmiVersion.startswith("1."):
        raise InputError(
            f"it follows FMI {description.fmiVersion}; export it from its tool as FMI 2 or FMI 3"
        )
    return description


def _free(idle: list[Any], folder: str) -> None:
    while idle:
        idle.pop().freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
