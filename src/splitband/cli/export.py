"""Define `splitband export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from splitband.cli import records, showing
from splitband.cli.options import (
    FileOptions,
    History,
    ModelArgument,
    OtherRun,
    SimulatorOptions,
    with_groups,
)
from splitband.export.fmu import platforms
from splitband.export.program import holds_equation
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
    files: FileOptions,
    history: History = None,
    other_run: OtherRun = False,
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
    whole simulation. For CasADi it is the function of a step, and beside it one of the state. It
    goes on from the end of --history. An equation that --simulator names is integrated in what is
    written. Any other simulator of a hybrid model, and one that is not named, stays outside: its
    output is an input.
    """
    forecaster = forecasters.load(model_dir)
    past = record = forecaster.require_fitted().record
    if history is not None:
        past = records.history_of(history, "--history", record, files)
    if simulator.simulator is not None:
        forecaster = records.with_simulator(
            forecaster, model_dir, simulator, past, 0, files.time_column
        )
    output_folder(out.parent, "OUT")
    with showing.warnings_as_lines():
        written = forecaster.export(out, precision, past if history else None, other_run)
    showing.console.print(f"{forecaster.name} is written to {', '.join(map(str, written))}")
    elsewhere = "export it with --history, as observed samples do not correct its equation's state"
    if not holds_equation(forecaster):
        needed = max(forecaster.warmup, 1)
        elsewhere = f"let it observe {needed} measured sample{'s' if needed > 1 else ''} first"
    showing.console.print(
        f"It begins at the end of {history or 'the training record'}; to begin elsewhere, "
        f"{elsewhere}."
    )
    facts: dict[str, Any] = {"model": str(model_dir), "method": forecaster.name}
    facts |= {"precision": precision, "files": [str(file) for file in written]}
    if out.suffix.lower() == ".fmu":
        facts["platforms"] = platforms(out)
    showing.as_json(facts)
