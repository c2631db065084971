"""Define `splitband export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from splitband.cli import showing
from splitband.cli.options import ModelArgument
from splitband.export.fmu import platforms
from splitband.forecasters import saving as forecasters
from splitband.runtime.files import output_folder


def export(
    model_dir: ModelArgument,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="File to write; its ending says as what: `.c`, `.fmu` or `.onnx`.",
            show_default=False,
        ),
    ],
    precision: Annotated[
        Literal["double", "float"],
        typer.Option(help="Of the numbers of C and ONNX; an FMU computes in double precision."),
    ] = "double",
) -> None:
    """Write a saved model as C, as an FMU or as ONNX.

    What is written runs without Python, sample by sample: it observes measured samples while there
    are any and predicts where there are none, with the numbers of `simulate`. C is one source file
    and its header, which need nothing but math.h. An FMU is for co-simulation (FMI 2.0). With
    the extra `everywhere` it runs on Windows, Linux and macOS, with a C compiler alone on this
    platform; it holds the sources for others. ONNX is the graph of a step, and beside it that of a
    whole simulation. The simulator of a hybrid model stays outside: its output is an input.
    """
    forecaster = forecasters.load(model_dir)
    output_folder(out.parent, "OUT")
    files = forecaster.export(out, precision)
    names = ", ".join(map(str, files))
    showing.console.print(f"{forecaster.name} is written to {names}")
    facts: dict[str, Any] = {"model": str(model_dir), "method": forecaster.name}
    facts |= {"precision": precision, "files": [str(file) for file in files]}
    if out.suffix.lower() == ".fmu":
        facts["platforms"] = platforms(out)
    showing.as_json(facts)
