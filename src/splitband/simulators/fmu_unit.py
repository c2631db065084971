"""Unpack a functional mock-up unit, lend its instances, and match its variables to a record's."""

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

from splitband.data.signals import bare_name
from splitband.runtime.errors import InputError, missing

EXCHANGE, COSIMULATION = "ModelExchange", "CoSimulation"
"""Kinds of FMUs by FMPy's names. Model exchange is preferred: its outputs can be read at once."""
WHOLE = (
    *("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16"),
    *("Int32", "UInt32", "Int64", "UInt64"),
)
"""Types whose values are whole numbers."""
REAL = "Real", "Float32", "Float64"
NUMERIC = *REAL, "Boolean", *WHOLE
"""Types of variables that can be a channel or an input."""
SIGNALS = "Signals"
"""Name of the element that lists signals of our own exported FMUs: their labels, which are the
names of the record's columns, and whether an input need not be driven."""
_MOST = 12
"""Most names in a message. Layout."""
_OLDEST = "0.3.29"
"""Of FMPy. With 0.3.26 outputs that a co-simulation computes in its step are a step late."""


class Variables:
    """Know the names of an FMU's variables; `description` by FMPy.

    `outputs` and `inputs` of an FMU are numbers; `inputs` must be driven, while the `optional` ones
    of an FMU of this package, which take measured samples, may keep their start values. `labels`
    has the column of the record that a variable stands for, or else the variable's own name.
    """

    def __init__(self, path: Path, description: Any) -> None:
        every, signals = description.modelVariables, _signals(path)
        self.file, self.names = path, [v.name for v in every]
        self.labels = {name: signals.get(name, {}).get("label", name) for name in self.names}
        optional = {name for name, facts in signals.items() if facts.get("optional") == "true"}
        usable = [v for v in every if v.type in NUMERIC and not (v.shape or v.dimensions)]
        inputs = [v.name for v in usable if v.causality == "input"]
        self.outputs = [v.name for v in usable if v.causality == "output"]
        # A channel may be called as a parameter is, which is no signal.
        signals_too = [v for v in usable if "arameter" not in v.causality]
        self.others = [v.name for v in signals_too if v.name not in {*self.outputs, *inputs}]
        self.optional = [name for name in inputs if name in optional]
        self.inputs = [name for name in inputs if name not in self.optional]
        self.able = {*inputs, *(v.name for v in usable if v.variability == "tunable")}
        self.arrays = [
            v.name for v in every if v.causality == "input" and (v.shape or v.dimensions)
        ]

    def check(self, outputs: Iterable[str] | None, inputs: Iterable[str] | None) -> None:
        """Raise ValueError for names that are no variables, or that cannot be driven."""
        inputs = [name for name in inputs or () if name]
        for name in (*(outputs or ()), *inputs):
            if name not in self.names:
                known = listed(self.names)
                raise InputError(f"{self.file} has no variable {name}; it has {known}")
        for name in inputs:
            if name not in self.able:
                raise InputError(
                    f"inputs must be inputs of {self.file}: {name} is none; it has "
                    f"{listed([*self.inputs, *self.optional])}"
                )

    def outputs_for(self, columns: Sequence[str], given: Sequence[str] | None) -> list[str]:
        """Return the variable of each channel: the given ones, or those of its name or label.

        Raises ValueError, with both lists, where they cannot be told.
        """
        if given is not None and len(given) == len(columns):
            return [*given]
        known = [*self.outputs, *self.others]
        found = [""] if given is not None else _by_name(columns, known, self.labels)
        if not all(found) and given is None and len(columns) == len(self.outputs) == 1:
            return [*self.outputs]
        if not all(found):
            raise InputError(
                f"outputs (--simulator-columns) must name the variable of {self.file} for each of "
                f"the record's channels, {listed(columns)}, in their order: "
                + (f"got {listed(given)}" if given else f"it has {listed(self.outputs)}")
            )
        return found

    def inputs_for(self, inputs: Sequence[str], given: Sequence[str] | None) -> list[str]:
        """Return the variable of each input: the given ones, or those of its name or label.

        An input that the FMU does not take has "". Raises ValueError, with both lists, where they
        cannot be told, or where an input of the FMU would not be driven.
        """
        if given is not None and len(given) in (0, len(inputs)):
            return [*given]
        if given is None and self.arrays:
            raise InputError(
                f"inputs (--simulator-inputs) must name the inputs of {self.file} that are driven: "
                f"{listed(self.arrays)} is an array, which cannot be; it keeps its start values"
            )
        if given is None:
            found = _by_name(inputs, [*self.inputs, *self.optional], self.labels)
            if {*self.inputs} <= {*found}:
                return found if any(found) else []
            if len(inputs) == len(self.inputs) == 1:
                return [*self.inputs]
        raise InputError(
            f"inputs (--simulator-inputs) must name the variable of {self.file} for each of the "
            f"record's inputs, {listed(inputs) or 'of which it has none'}, in their order: "
            + (f"got {listed(given)}" if given else f"it has {listed(self.inputs)}")
            + '; "" for one that it does not take; inputs that are not named keep their start '
            "values, and with an empty list all do"
        )


def _by_name(wanted: Sequence[str], known: Sequence[str], labels: Mapping[str, str]) -> list[str]:
    """Return the known names with these labels or names, if need be without units; else ""."""
    # A label counts before a name of ours that is like it, such as `observe`.
    by_label = {labels[name]: name for name in sorted(known, key=lambda n: labels[n] != n)}
    for names in (by_label, dict(zip(known, known, strict=True))):
        if {*wanted} <= {*names}:
            return [names[name] for name in wanted]
    found = [[k for k in known if bare_name(labels[k]) == bare_name(name)] for name in wanted]
    alone = [each[0] if len(each) == 1 else "" for each in found]
    return [name if alone.count(name) == 1 else "" for name in alone]


def listed(names: Sequence[str]) -> str:
    """Return the first names for a message."""
    return ", ".join(names[:_MOST]) + (", ..." if len(names) > _MOST else "")


def _signals(path: Path) -> dict[str, dict[str, str]]:
    """Return what our own annotation in a model description says of signals, by their names."""
    with ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    listed = root.iterfind(f"VendorAnnotations/Tool[@name='splitband']/{SIGNALS}/Signal")
    return {each.get("name", ""): dict(each.attrib) for each in listed}


class Unit:
    """Hold an unpacked FMU and an idle instance of it.

    The archive is unpacked once; between runs an instance is reset, not loaded again. The unpacked
    files are removed by `close`, when the object is deleted, or when the process ends.

    Attributes
    ----------
    checked : How its outputs depend on a communication step in s, empty if they hardly do.
    doubted : Outputs of which it was said that a run cannot tell how they are read.
    version : Of FMI, 2 or 3.
    short_steps : Whether it makes steps of any length, as far as is known.
    reads_before : Whether its outputs were found to be refused between inputs and a step.
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
        # Unlike `weakref.finalize` it also runs at the end of a worker process, and does not remove
        # the files of a parent process.
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
        """Return the names of the variables whose start values can be set."""
        from fmpy import simulation as by_fmpy  # noqa: PLC0415  the optional extra

        begin, later = by_fmpy.settable_in_instantiated, by_fmpy.settable_in_initialization_mode
        variables = [v for v in self.description.modelVariables if v.variability != "constant"]
        return [v.name for v in variables if begin(v) or later(v)]

    @property
    def own_step(self) -> float | None:
        """Return the communication step in s that it declares, if it does."""
        experiment = self.description.defaultExperiment
        own = self.description.coSimulation.fixedInternalStepSize
        own = own or (experiment and experiment.stepSize)
        return float(own) if own and float(own) > 0 else None

    @property
    def any_step(self) -> bool:
        """Return whether it declares to make communication steps of any length."""
        return bool(self.description.coSimulation.canHandleVariableCommunicationStepSize)

    @contextmanager
    def instance(self) -> Iterator[Any]:
        """Lend an instance; it is used again only after success.

        An instance that failed or still runs cannot be freed.
        """
        instance = self._idle.pop() if self._idle else self._instance()
        yield instance
        instance.terminate()
        try:
            instance.reset()
        except Exception:  # it cannot be
            instance.freeInstance()
        else:
            self._idle.append(instance)

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
            raise InputError(f"the FMU {self.path} has been closed")
        return instantiate_fmu(self.folder, self.description, self.kind)


def variables_of(path: Path) -> Variables:
    """Return the variables of an FMU, without running its code."""
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
