"""Write a fitted forecaster in the format that the extension of a file's name asks for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from splitband.data import Record
from splitband.export import fmu
from splitband.export.c import render
from splitband.export.c_statements import Precision
from splitband.export.program import Program, program
from splitband.forecasters.base import Forecaster
from splitband.runtime.errors import InputError
from splitband.runtime.files import replacing

Writer = Callable[[Program, Path, Precision], list[Path]]


def export(
    forecaster: Forecaster,
    path: str | Path,
    precision: Precision = "double",
    history: Record | None = None,
) -> list[Path]:
    """Export a forecaster; return the files. See `Forecaster.export`."""
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(f"path must end with one of {', '.join(WRITERS)}, got {path}")
    if precision not in ("double", "float"):
        raise InputError(f"precision must be double or float, got {precision!r}")
    return writer(program(forecaster, path.stem, history), path, precision)


def _c(made: Program, path: Path, precision: Precision) -> list[Path]:
    header, source = render(made, precision)
    if path.stem != made.name:
        raise InputError(
            f"path must be named as functions of C are, such as {made.name}.c, got {path.name}"
        )
    beside = path.with_suffix(".h")
    for file, text in ((beside, header), (path, source)):
        with replacing(file) as temporary:
            temporary.write_text(text, encoding="ascii")
    return [path, beside]


def _onnx(made: Program, path: Path, precision: Precision) -> list[Path]:
    from splitband.export import onnx_graph  # noqa: PLC0415  needs the extra `onnx`

    beside = path.with_name(f"{path.stem}-rollout{path.suffix}")
    contents = onnx_graph.render(made, precision)
    for file, content in zip((path, beside), contents, strict=True):
        with replacing(file) as temporary:
            temporary.write_bytes(content)
    return [path, beside]


def _fmu(made: Program, path: Path, precision: Precision) -> list[Path]:
    if precision != "double":
        raise InputError(f"precision must be double for an FMU, got {precision}")
    with replacing(path) as temporary:
        fmu.write(made, temporary)
    return [path]


WRITERS: dict[str, Writer] = {".c": _c, ".fmu": _fmu, ".onnx": _onnx}
"""Writers by file extension."""
