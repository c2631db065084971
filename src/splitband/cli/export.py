"""Define `splitband export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from splitband.cli import printing, records
from splitband.cli.options import (
    FileOptions,
    History,
    ModelArgument,
    OtherRun,
    SimulatorOptions,
    with_groups,
)
from splitband.export.fmu import ORDER, platforms
from splitband.export.writing import renderer
from splitband.forecasters.loading import load
from splitband.runtime.files import output_folder


@with_groups
def export(
    model_dir: ModelArgument,
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT",
            help="File to write. Its suffix decides the format: `.c`, `.fmu`, `.onnx`, `.casadi`.",
            show_default=False,
        ),
    ],
    simulator: SimulatorOptions,
    files: FileOptions,
    history: History = None,
    other_run: OtherRun = False,
    precision: Annotated[
        Literal["double", "float"],
        typer.Option(
            metavar="double|float", help="Precision of C and ONNX; the others are always double."
        ),
    ] = "double",
) -> None:
    """Export a saved model as C, FMU, ONNX or CasADi.

    The exported model runs without Python, one sample at a time. It estimates its state from
    measured samples, and predicts where there are none, with the numbers of `simulate`. It starts
    at the end of the training record, or of --history.

    `.c`: a source file and a header that need only math.h.

    `.fmu`: an FMU for co-simulation (FMI 2.0) with its sources. The extra `everywhere` builds it
    for Windows, Linux and macOS, a C compiler for this platform only. For each sample, set the
    inputs, read the outputs, then make the step.

    `.onnx`: a graph of one step, and a second one of a whole simulation.

    `.casadi`: a function of one step, and a second one of the state.

    If the model contains a simulator, name its equation with --simulator to include it. Any other
    simulator stays outside, and its output becomes an input of the exported model.
    """
    renderer(out)
    forecaster = load(model_dir)
    past = forecaster.require_fitted().record
    if history is not None:
        past = records.history_of(history, "--history", forecaster, files)
    if simulator.simulator is not None:
        records.with_simulator(forecaster, simulator, past, files)
    output_folder(out.parent, "OUT")
    with printing.warnings_as_lines():
        written = forecaster.export(out, precision, past if history else None, other_run)
    printing.console.print(f"{forecaster.name} is written to {', '.join(map(str, written))}")
    needed, elsewhere = max(forecaster.warmup, 1), "export it with --history"
    cleared = {".c": f"call {out.stem}_clear", ".fmu": "set begin_empty"}.get(out.suffix.lower())
    if forecaster.step_form().note:
        elsewhere += ", as observed samples do not correct its equation's state"
    elif forecaster.anchored:
        elsewhere += ", as its periods count time"
    elif cleared:
        elsewhere = f"{cleared}, and let it observe at least {needed} measured sample(s)"
    printing.console.print(
        f"The exported model begins at the end of {history or 'the training record'}; to begin "
        f"elsewhere, {elsewhere}."
    )
    facts: dict[str, Any] = {"model": str(model_dir), "method": forecaster.name}
    facts |= {"precision": precision, "files": [str(file) for file in written]}
    if out.suffix.lower() == ".fmu":
        printing.console.print(ORDER)
        facts["platforms"] = platforms(out)
    printing.as_json(facts)
