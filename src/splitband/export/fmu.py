"""Write a program as a functional mock-up unit for co-simulation (FMI 2.0), around its C code."""

from __future__ import annotations

import hashlib
import re
import tempfile
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from io import BytesIO
from itertools import count
from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from splitband import __version__
from splitband.export import c
from splitband.export.compiling import libraries
from splitband.export.program import Program
from splitband.records.signals import unit_of
from splitband.runtime.errors import missing
from splitband.simulators.fmu_unit import SIGNALS

HEADERS = "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"
LONGEST_NAME = 63
"""Most characters of a name in MATLAB. A convention."""
_OF_C = (
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while"
)
_OF_MATLAB = "catch classdef elseif end function global otherwise parfor persistent spmd try"
KEYWORDS = frozenset(f"{_OF_C} {_OF_MATLAB}".split())
"""Words that are no names of variables, in C or in MATLAB."""
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML lacks, such as most control characters."""
_SIGNS = str.maketrans({"\u00b0": "deg", "\u03bc": "u", "\u03a9": "Ohm", "%": "percent"})
"""Signs of units, and how they are written in letters: degree, micro, ohm, per cent."""


@dataclass(frozen=True)
class Variable:
    """Hold a variable of an FMU; its value reference is its position among those of its type."""

    name: str  # as FMI defines them
    causality: str
    description: str
    start: float | bool | None = None  # value before it is set; None for a computed variable
    unit: str = ""  # unit of a number; empty if unknown
    label: str = ""  # the record's column that it stands for; empty if it stands for none


FLAGS = (
    Variable("observe", "input", "take the measured samples instead of predicting", False),
    Variable("begin_empty", "parameter", "begin with nothing measured", False),
)

ORDER = (
    "At each sample, a tool must set the inputs, read the outputs, then make the step. A tool that "
    "reads outputs after the step, such as FMPy's simulate_fmu, gets each output for the previous "
    "inputs."
)
"""What a user must know of the order in which an FMU's outputs are read."""


def render(program: Program) -> bytes:
    """Return the FMU: binaries, see `compiling.libraries`, and the sources for other platforms."""
    numbers = _numbers(program)
    sources, guid = _sources(program, numbers)
    code = tuple(name for name in sources if name.endswith(".c"))
    with tempfile.TemporaryDirectory() as folder:
        for name, content in sources.items():
            Path(folder, name).write_bytes(content)
        built = libraries(Path(folder), code, program.name)
    files = {"modelDescription.xml": _description(program, numbers, guid, code)}
    files |= {f"sources/{name}": content for name, content in sources.items()}
    files |= {f"binaries/{path}": content for path, content in built.items()}
    return _packed(files)


def platforms(path: Path) -> list[str]:
    """Return FMI's names of the platforms for which an FMU holds a binary, such as "win64"."""
    with ZipFile(path) as archive:
        parts = [name.split("/") for name in archive.namelist()]
    return sorted({part[1] for part in parts if part[0] == "binaries" and len(part) > 2})


def _sources(program: Program, numbers: Sequence[Variable]) -> tuple[dict[str, bytes], str]:
    """Return the files of the source code by their names, and the identifier of the model."""
    try:
        import fmpy  # noqa: PLC0415  the optional extra
    except ImportError:
        raise missing("an FMU", "FMPy", "fmu") from None
    # Its own names, which no file of the FMU and no header of FMI can have.
    model = f"{program.name}_model"
    header, source = c.render(replace(program, name=model), "double")
    guid = hashlib.sha256((header + source).encode()).hexdigest()[:32]
    wrapper = resources.files("splitband.export").joinpath("fmu2.c.in").read_text(encoding="ascii")
    for word, value in {
        "NAME": model,
        "GUID": guid,
        "STEP": f"{program.record.sampling_time!r}",
        "NUMBERS": str(len(numbers)),
        "OUTPUTS": str(program.record.ny),
        "STARTS": ", ".join(repr(float(v.start or 0.0)) for v in numbers),
        "GIVEN": _given(program),
        "NEEDED": str(program.needed),
    }.items():
        wrapper = wrapper.replace(f"@{word}@", value)
    texts = {f"{model}.c": source, "fmu.c": wrapper, f"{model}.h": header}
    headers = Path(fmpy.__file__).parent / "c-code"
    files = {name: text.encode("ascii") for name, text in texts.items()}
    return files | {name: (headers / name).read_bytes() for name in HEADERS}, guid


def _packed(files: Mapping[str, bytes]) -> bytes:
    """Return files as a ZIP archive, which depends on nothing but their names and contents."""
    packed = BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for name in sorted(files):
            member = ZipInfo(name)  # dated 1980
            member.compress_type = ZIP_DEFLATED
            member.create_system, member.external_attr = 3, 0o644 << 16  # Unix, on Windows too
            archive.writestr(member, files[name])
    return packed.getvalue()


class PortNames:
    """Give signals names of their own that C and MATLAB, and so Simulink, take."""

    def __init__(self) -> None:
        self.taken = {flag.name for flag in FLAGS}

    def new(self, label: str, ending: str = "") -> str:
        """Return a name for a label, with an ending; a number tells equal ones apart."""
        tails = (f"_{number}{ending}" if number > 1 else ending for number in count(1))
        names = (port_name(label)[: LONGEST_NAME - len(tail)] + tail for tail in tails)
        name = next(name for name in names if name not in self.taken)
        self.taken.add(name)
        return name


def port_name(label: str) -> str:
    """Return a label as a name that C and MATLAB take: "level (cm)" is `level_cm`."""
    word = label
    if not re.fullmatch(r"[A-Za-z]\w*", label, re.ASCII):
        letters = unicodedata.normalize("NFKD", label).translate(_SIGNS)
        plain = "".join(each for each in letters if not unicodedata.combining(each))
        word = re.sub(r"\W+", "_", plain, flags=re.ASCII).strip("_")
    if not word[:1].isalpha() or word in KEYWORDS:
        word = f"x_{word}".rstrip("_")
    return word


def _numbers(program: Program) -> list[Variable]:
    """Return the real variables: outputs, inputs, the simulator's output, measured samples."""
    record, names = program.record, PortNames()
    outputs, inputs = record.labels

    def channels(ending: str, description: str) -> list[Variable]:
        listed = zip(record.columns, outputs, record.y[-1], record.units, strict=True)
        return [
            Variable(names.new(each, ending), "input", f"{said}: {description}", float(start), unit)
            for each, said, start, unit in listed
        ]

    found = [
        Variable(names.new(each), "output", f"{said}: predicted, or as observed", None, unit, each)
        for each, said, unit in zip(record.columns, outputs, record.units, strict=True)
    ]
    if "u" in program.given and record.u is not None:
        found += [
            Variable(
                names.new(each), "input", f"{said}: known input", float(start), unit_of(each), each
            )
            for each, said, start in zip(record.inputs, inputs, record.u[-1], strict=True)
        ]
    if "y_sim" in program.given:
        said = {
            "_simulated": "output of the simulator",
            "_simulated_next": "output of the simulator at the next sample",
        }
        for ending in [*said][: program.given["y_sim"][0]]:
            found += channels(ending, said[ending])
    return [*found, *channels("_measured", "what is observed")]


def _given(program: Program) -> str:
    """Return C arguments that point to inputs and simulator's output in the list of numbers."""
    at, arguments = program.record.ny, ""
    for name in ("u", "y_sim"):
        if name in program.given:
            arguments += f", c->numbers + {at}"
            at += int(np.prod(program.given[name]))
    return arguments


def _description(
    program: Program, numbers: Sequence[Variable], guid: str, files: Sequence[str]
) -> bytes:
    record, add = program.record, ElementTree.SubElement
    facts = {"fmiVersion": "2.0", "modelName": program.name, "guid": guid}
    facts["description"] = f"{program.forecaster.name}, exported by splitband"
    facts["generationTool"] = f"splitband {__version__}"
    facts |= {"variableNamingConvention": "flat", "numberOfEventIndicators": "0"}
    root = ElementTree.Element("fmiModelDescription", facts)
    facts = {"modelIdentifier": program.name, "canInterpolateInputs": "true"}
    facts |= {"canHandleVariableCommunicationStepSize": "false", "canGetAndSetFMUstate": "true"}
    simulation = add(root, "CoSimulation", facts)
    sources = add(simulation, "SourceFiles")
    for name in files:
        add(sources, "File", name=name)
    if units := sorted({variable.unit for variable in numbers} - {""}):
        defined = add(root, "UnitDefinitions")
        for unit in units:
            add(defined, "Unit", name=unit)
    add(root, "DefaultExperiment", stepSize=repr(record.sampling_time))
    _annotate(root, numbers, record.ny)
    variables = add(root, "ModelVariables")
    observe, empty = FLAGS
    begins = f", and not at the end of the {program.begins}" if program.begins else ""
    said = f"{empty.description}{begins}: {program.cleared}"
    if program.note:
        said += f". {program.note}"
    flags = observe, replace(empty, description=said)
    for kind, listed in (("Real", numbers), ("Boolean", flags)):
        for reference, variable in enumerate(listed):
            facts = {"name": variable.name, "valueReference": str(reference)}
            facts |= {"causality": variable.causality, "description": variable.description}
            scalar = add(variables, "ScalarVariable", facts)
            if variable.causality == "parameter":
                scalar.set("variability", "fixed")
            elif kind == "Boolean":
                scalar.set("variability", "discrete")
            start = {} if variable.start is None else {"start": str(variable.start).lower()}
            add(scalar, kind, start | ({"unit": variable.unit} if variable.unit else {}))
    structure = add(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = add(structure, part)
        for index in range(1, record.ny + 1):
            add(unknowns, "Unknown", index=str(index))
    for element in root.iter():
        for name, value in element.items():
            element.set(name, _NOT_XML.sub("\ufffd", value))
    ElementTree.indent(root)
    described: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return described


def _annotate(root: ElementTree.Element, numbers: Sequence[Variable], measured: int) -> None:
    """Add what `simulators.fmu_unit` reads: labels, and inputs that need not be driven."""
    add = ElementTree.SubElement
    ours = add(add(root, "VendorAnnotations"), "Tool", name="splitband")
    signals = add(ours, SIGNALS)  # FMI 2.0 allows one element of a tool
    free = {v.name for v in (*numbers[-measured:], FLAGS[0])}  # unless something is observed
    for variable in (*numbers, FLAGS[0]):
        facts = {"label": variable.label} if variable.label else {}
        facts |= {"optional": "true"} if variable.name in free else {}
        if facts:
            add(signals, "Signal", {"name": variable.name} | facts)
