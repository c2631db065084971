"""Define `splitband export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from splitband.cli import records, showing
from splitband.cli.options import ModelArgument, SimulatorOptions, with_groups
from splitband.export.fmu import platforms
from splitband.forecasters import saving as forecasters
from splitband.runtime.files import output_folder


@with_groups
def export(
    model_dir: ModelArgument,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="File to write; its suffix is the format: `.c`, `.fmu`, `.onnx` or `.casadi`.",
            show_default=False,
        ),
    ],
    simulator: SimulatorOptions,
    precision: Annotated[
        Literal["double", "float"],
        typer.Option(help="Of the numbers of C and ONNX; the others compute in double precision."),
    ] = "double",
) -> None:
    """Write a saved model as C, as an FMU, as ONNX or for CasADi.

    The exported model runs without Python, one sample at a time: it observes measured samples to
    estimate its state, and predicts where there are none, with the numbers of `simulate`. C is one
    source file and a header that need only math.h. An FMU is for co-simulation (FMI 2.0): with the
    extra `everywhere` for Windows, Linux and macOS, with a C compiler for this platform only; it
    contains its sources. ONNX is the graph of one step, with a second one of a whole simulation.
    CasADi is the function of one step, with a second one of the state. An equation that --simulator
    names is integrated in the exported model; any other simulator of a hybrid stays outside: its
    output is an input.
    """
    forecaster = forecasters.load(model_dir)
    if simulator.simulator is not None:
        past = forecaster.require_fitted().record
        forecaster = records.with_simulator(forecaster, model_dir, simulator, past, 0, None)
    output_folder(out.parent, "OUT")
    files = forecaster.export(out, precision)
    names = ", ".join(map(str, files))
    showing.console.print(f"{forecaster.name} is written to {names}")
    needed = max(forecaster.warmup, 1)
    showing.console.print(
        "It begins at the end of the training record; to begin elsewhere, let it observe "
        f"{needed} measured sample{'s' if needed > 1 else ''} first."
    )
    facts: dict[str, Any] = {"model": str(model_dir), "method": forecaster.name}
    facts |= {"precision": precision, "files": [str(file) for file in files]}
    if out.suffix.lower() == ".fmu":
        facts["platforms"] = platforms(out)
    showing.as_json(facts)
