"""Write a program as a functional mock-up unit for co-simulation (FMI 2.0), around its C code."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from splitband import __version__
from splitband.data.signals import unit_of
from splitband.export import c
from splitband.export.compiling import libraries
from splitband.export.program import Program
from splitband.runtime.errors import InputError
from splitband.simulators.fmu_unit import OPTIONAL

HEADERS = "fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"


@dataclass(frozen=True)
class Variable:
    """Hold a variable of an FMU; its value reference is its position among those of its type."""

    name: str  # as FMI defines them
    causality: str
    description: str
    start: float | bool | None = None  # value before it is set; None for a computed variable
    unit: str = ""  # unit of a number; empty if unknown


FLAGS = (
    Variable("observe", "input", "take the measured samples in place of predicting", False),
    Variable("begin_empty", "parameter", "begin with nothing measured, and not at the end of the "
             "training record", False),
)  # fmt: skip


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
        raise InputError('an FMU needs FMPy: pip install "splitband[fmu]"') from None
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


def _numbers(program: Program) -> list[Variable]:
    """Return the real variables: outputs, inputs, the simulator's output, measured samples."""
    record = program.record
    y, u = program.usual()

    def channels(ending: str, description: str) -> list[Variable]:
        return [
            Variable(f"{name}{ending}", "input", description, float(start), unit)
            for name, start, unit in zip(record.columns, y, record.units, strict=True)
        ]

    found = [
        Variable(name, "output", "predicted, or as observed", None, unit)
        for name, unit in zip(record.columns, record.units, strict=True)
    ]
    if "u" in program.given:
        found += [
            Variable(name, "input", "known input", float(start), unit_of(name))
            for name, start in zip(record.inputs, u, strict=True)
        ]
    if "y_sim" in program.given:
        for ending in ["_simulated", "_simulated_next"][: program.given["y_sim"][0]]:
            found += channels(ending, "output of the simulator")
    return _unique([*found, *channels("_measured", "what is observed")])


def _unique(variables: Sequence[Variable]) -> list[Variable]:
    taken = {flag.name for flag in FLAGS}
    unique = []
    for variable in variables:
        name = variable.name
        while name in taken:
            name += "_"
        taken.add(name)
        unique.append(replace(variable, name=name))
    return unique


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
    root = ElementTree.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=program.name, guid=guid,
        description=f"{program.forecaster.name}, exported by splitband",
        generationTool=f"splitband {__version__}", variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )  # fmt: skip
    simulation = add(
        root, "CoSimulation", modelIdentifier=program.name, canInterpolateInputs="true",
        canHandleVariableCommunicationStepSize="false", canGetAndSetFMUstate="true",
    )  # fmt: skip
    sources = add(simulation, "SourceFiles")
    for name in files:
        add(sources, "File", name=name)
    if units := sorted({variable.unit for variable in numbers} - {""}):
        defined = add(root, "UnitDefinitions")
        for unit in units:
            add(defined, "Unit", name=unit)
    add(root, "DefaultExperiment", stepSize=repr(record.sampling_time))
    ours = add(add(root, "VendorAnnotations"), "Tool", name="splitband")
    optional = add(ours, OPTIONAL)
    for variable in (*numbers[-record.ny :], FLAGS[0]):  # unless something is observed
        add(optional, "Input", name=variable.name)
    variables = add(root, "ModelVariables")
    for kind, listed in (("Real", numbers), ("Boolean", FLAGS)):
        for reference, variable in enumerate(listed):
            scalar = add(
                variables, "ScalarVariable", name=variable.name, valueReference=str(reference),
                causality=variable.causality, description=variable.description,
            )  # fmt: skip
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
    ElementTree.indent(root)
    described: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return described
