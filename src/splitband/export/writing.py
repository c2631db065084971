"""Write a fitted forecaster in the format that the extension of a file's name asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from splitband.data import Record
from splitband.export import fmu
from splitband.export.c import render
from splitband.export.c_statements import Precision
from splitband.export.program import Program, program
from splitband.forecasters.base import Forecaster
from splitband.runtime.errors import InputError
from splitband.runtime.files import replacing

Renderer = Callable[[Program, Path, Precision], Mapping[Path, bytes]]
"""Returns the content of each file, the one that was asked for first."""


def export(
    forecaster: Forecaster,
    path: str | Path,
    precision: Precision = "double",
    history: Record | None = None,
) -> list[Path]:
    """Export a forecaster; return the files. See `Forecaster.export`."""
    path = Path(path)
    rendered = FORMATS.get(path.suffix.lower())
    if rendered is None:
        raise InputError(f"path must end with one of {', '.join(FORMATS)}, got {path}")
    if precision not in ("double", "float"):
        raise InputError(f"precision must be double or float, got {precision!r}")
    files = rendered(program(forecaster, path.stem, history), path, precision)
    for file, content in files.items():
        with replacing(file) as temporary:
            temporary.write_bytes(content)
    return [*files]


def _c(made: Program, path: Path, precision: Precision) -> dict[Path, bytes]:
    if path.stem != made.name:
        raise InputError(
            f"path must be named as functions of C are, such as {made.name}.c, got {path.name}"
        )
    header, source = render(made, precision)
    return {path: source.encode("ascii"), path.with_suffix(".h"): header.encode("ascii")}


def _onnx(made: Program, path: Path, precision: Precision) -> dict[Path, bytes]:
    from splitband.export import onnx_graph  # noqa: PLC0415  needs the extra `onnx`

    step, rollout = onnx_graph.render(made, precision)
    return {path: step, path.with_name(f"{path.stem}-rollout{path.suffix}"): rollout}


def _fmu(made: Program, path: Path, precision: Precision) -> dict[Path, bytes]:
    if precision != "double":
        raise InputError(f"precision must be double for an FMU, got {precision}")
    return {path: fmu.render(made)}


FORMATS: dict[str, Renderer] = {".c": _c, ".fmu": _fmu, ".onnx": _onnx}
"""What writes a format, by file extension."""
