"""Write a fitted forecaster in the format that the extension of a file's name asks for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from splitband.export import fmu
from splitband.export.c import render
from splitband.export.c_statements import Precision
from splitband.export.program import identifier, program
from splitband.forecasters.base import Forecaster
from splitband.records import Record
from splitband.runtime.errors import InputError
from splitband.runtime.files import replacing

if TYPE_CHECKING:
    from splitband.export.casadi_graph import CasadiStep

Begin = tuple[Record | None, bool]
"""A history, and whether it is of another record."""
Renderer = Callable[[Forecaster, Path, Precision, Begin], Mapping[Path, bytes]]
"""Returns the content of each file, the one that was asked for first."""


def export(
    forecaster: Forecaster,
    path: str | Path,
    precision: Precision = "double",
    history: Record | None = None,
    other_record: bool = False,
) -> list[Path]:
    """Export a forecaster; return the files. See `Forecaster.export`."""
    path = Path(path)
    rendered = renderer(path)
    if precision not in ("double", "float"):
        raise InputError(f"precision must be double or float, got {precision!r}")
    files = rendered(forecaster, path, precision, (history, other_record))
    for file, content in files.items():
        with replacing(file) as temporary:
            temporary.write_bytes(content)
    return [*files]


def renderer(path: Path) -> Renderer:
    """Return what writes the format of a file; raises ValueError for another one."""
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise InputError(f"path must end with one of {', '.join(FORMATS)}, got {path}")
    return found


def _c(forecaster: Forecaster, path: Path, precision: Precision, begin: Begin) -> dict[Path, bytes]:
    if path.stem != (name := identifier(path.stem)):
        raise InputError(
            f"path must be named as functions of C are, such as {name}.c, got {path.name}"
        )
    header, source = render(program(forecaster, path.stem, *begin), precision)
    return {path: source.encode("ascii"), path.with_suffix(".h"): header.encode("ascii")}


def _onnx(
    forecaster: Forecaster, path: Path, precision: Precision, begin: Begin
) -> dict[Path, bytes]:
    from splitband.export import onnx_graph  # noqa: PLC0415  needs the extra `onnx`

    step, rollout = onnx_graph.render(program(forecaster, path.stem, *begin), precision)
    return {path: step, path.with_name(f"{path.stem}-rollout{path.suffix}"): rollout}


def _fmu(
    forecaster: Forecaster, path: Path, precision: Precision, begin: Begin
) -> dict[Path, bytes]:
    _require_double(precision, "an FMU")
    return {path: fmu.render(program(forecaster, path.stem, *begin))}


def _casadi(
    forecaster: Forecaster, path: Path, precision: Precision, begin: Begin
) -> dict[Path, bytes]:
    from splitband.export import casadi_graph  # noqa: PLC0415  needs the extra `casadi`

    _require_double(precision, "CasADi")
    step, start = casadi_graph.files(casadi_graph.CasadiStep(forecaster, *begin))
    return {path: step, path.with_name(f"{path.stem}-start{path.suffix}"): start}


def casadi_step(
    forecaster: Forecaster, history: Record | None = None, other_record: bool = False
) -> CasadiStep:
    """Return the prediction of one sample as a CasADi function, for predictive control.

    After `step = casadi_step(model)`, call `state, y = step(state, u)` with numbers, or with
    CasADi's expressions, which have derivatives. `step.state()` is the state at the
    end of the history, a vector; `step.stream.observe(y, u)` takes what is measured next. The
    numbers are those of `Forecaster.stream`. The equation of an `Ode` is part of the function; the
    output of any other simulator is its third argument. It needs the extra `casadi`.

    Parameters
    ----------
    forecaster : Fitted.
    history, other_record : See `Forecaster.predict`; by default the training record.

    Raises
    ------
    ValueError
        For a part that has no such form, which it names: an EulerMLP, a cell of your own, a
        conditioned hybrid without inputs; where too few samples have been measured; without CasADi.
    """
    from splitband.export.casadi_graph import CasadiStep  # noqa: PLC0415  needs the extra `casadi`

    return CasadiStep(forecaster, history, other_record)


def _require_double(precision: Precision, what: str) -> None:
    if precision != "double":
        raise InputError(f"precision must be double for {what}, got {precision}")


FORMATS: dict[str, Renderer] = {".c": _c, ".fmu": _fmu, ".onnx": _onnx, ".casadi": _casadi}
"""What writes a format, by file extension."""
