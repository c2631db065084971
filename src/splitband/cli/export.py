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
            help="File to write; its suffix is the format: `.c`, `.fmu`, `.onnx` or `.casadi`.",
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

    The exported model runs without Python, one sample at a time: it observes measured samples to
    estimate its state, and predicts where there are none, with the numbers of `simulate`. C is one
    source file and a header that need only math.h. An FMU is for co-simulation (FMI 2.0): with the
    extra `everywhere` for Windows, Linux and macOS, with a C compiler for this platform only; it
    contains its sources; set the inputs of a sample, read its outputs, then make the step. ONNX is
    the graph of one step, with a second one of a whole simulation. CasADi is the function of one
    step, with a second one of the state. It goes on from the end of --history. An equation that
    --simulator names is integrated in the exported model; any other simulator of a hybrid, and one
    that is not named, stays outside: its output is an input.
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
        elsewhere = f"{cleared}, and let it observe {needed} measured sample(s) or more"
    printing.console.print(
        f"It begins at the end of {history or 'the training record'}; to begin elsewhere, "
        f"{elsewhere}."
    )
    facts: dict[str, Any] = {"model": str(model_dir), "method": forecaster.name}
    facts |= {"precision": precision, "files": [str(file) for file in written]}
    if out.suffix.lower() == ".fmu":
        printing.console.print(ORDER)
        facts["platforms"] = platforms(out)
    printing.as_json(facts)
