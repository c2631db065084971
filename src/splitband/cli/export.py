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
            help="File to write; its ending says as what: `.c`, `.fmu`, `.onnx` or `.casadi`.",
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

    What is written runs without Python, sample by sample: it observes measured samples while there
    are any and predicts where there are none, with the numbers of `simulate`. C is one source file
    and its header, which need nothing but math.h. An FMU is for co-simulation (FMI 2.0). With
    the extra `everywhere` it runs on Windows, Linux and macOS, with a C compiler alone on this
    platform; it holds the sources for others. ONNX is the graph of a step, and beside it that of a
    whole simulation. For CasADi it is the function of a step, and beside it one of the
    state. An equation that --simulator names is integrated in what is written. Any other simulator
    of a hybrid model, and one that is not named, stays outside: its output is an input.
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
