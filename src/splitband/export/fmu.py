"""Write a program as a functional mock-up unit for co-simulation (FMI 2.0), around its C code."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from splitband import __version__
from splitband.data.signals import unit_of
from splitband.export import c
from splitband.export.program import Program
from splitband.runtime.errors import InputError
from splitband.runtime.system import split_command
from splitband.simulators.fmu_unit import OPTIONAL

COMPILERS = "cc", "gcc", "clang"
"""Compilers to look for if the environment variable CC names none."""


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
    """Return the FMU: a binary for this platform, and the sources for others."""
    try:
        import fmpy  # noqa: PLC0415  the optional extra
    except ImportError:
        raise InputError("an FMU needs FMPy: pip install 'splitband[fmu]'") from None
    headers = Path(fmpy.__file__).parent / "c-code"
    numbers = _numbers(program)
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
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        sources = folder / "sources"
        sources.mkdir()
        for name in ("fmi2Functions.h", "fmi2FunctionTypes.h", "fmi2TypesPlatform.h"):
            shutil.copy(headers / name, sources)
        (sources / f"{model}.h").write_text(header, encoding="ascii")
        (sources / f"{model}.c").write_text(source, encoding="ascii")
        (sources / "fmu.c").write_text(wrapper, encoding="ascii")
        described = _description(program, numbers, guid, (f"{model}.c", "fmu.c"))
        described.write(folder / "modelDescription.xml", encoding="utf-8", xml_declaration=True)
        binary = folder / "binaries" / fmpy.platform
        binary.mkdir(parents=True)
        _compile(sources, model, binary / f"{program.name}{fmpy.sharedLibraryExtension}")
        packed = BytesIO()
        with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
            for file in sorted(p for p in folder.rglob("*") if p.is_file()):
                archive.write(file, file.relative_to(folder))
        return packed.getvalue()


def _compile(sources: Path, model: str, library: Path) -> None:
    options = ["-std=c99", "-O2", "-fPIC", "-shared", "-o", str(library)]
    command = [*_compiler(), *options, f"{model}.c", "fmu.c", "-lm"]
    done = subprocess.run(command, cwd=sources, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError(f"the FMU could not be compiled by {command[0]}: {done.stderr[-300:]}")


def _compiler() -> list[str]:
    """Return the C compiler with its options: those of the environment variable CC, if set."""
    given = os.environ.get("CC", "").strip()
    whole = shutil.which(given) if given else None
    parts = split_command(given)  # such as "ccache gcc -m64"
    commands = [[whole]] if whole else [parts] if parts else [[word] for word in COMPILERS]
    for compiler, *options in commands:
        if found := shutil.which(compiler):
            return [found, *options]
    raise InputError(f"an FMU needs a C compiler: none of {given or ', '.join(COMPILERS)}")


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
) -> ElementTree.ElementTree[Any]:
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
    tree = ElementTree.ElementTree(root)
    ElementTree.indent(tree)
    return tree
