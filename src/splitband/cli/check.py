"""Define `splitband check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from splitband.checks import model as checks
from splitband.checks.responses import respond_over_range
from splitband.cli import options, printing, records
from splitband.cli.usage import checking, command_of
from splitband.forecasters.loading import load
from splitband.report import results, tables
from splitband.report.page.parts import Usage


@options.with_groups
def check(
    context: typer.Context,
    model_dir: options.ModelArgument,
    record: Annotated[
        Path,
        options.plain("Measured samples, columns as in training, best of another run.", "FILE"),
    ],
    simulator: options.SimulatorOptions,
    files: options.FileOptions,
    ahead: Annotated[
        int | None,
        options.plain("Samples ahead of predictions.", "N", "as the model was made, or 10", min=1),
    ] = None,
    out: options.Out = Path("check"),
    device: options.Device = "cpu",
) -> None:
    """CHECKDOC"""
    model = load(model_dir)
    past = records.history_of(record, "--record", model, files)
    records.with_simulator(model, simulator, past, files)
    model.to(device)
    with printing.warnings_as_lines():
        found = checks.check(model, past, ahead)
        responses = respond_over_range(model)
    facts = command_of(context)
    used = Usage(asked=checking(facts["arguments"]))
    results.save_check(found, model, responses, facts, out, used)
    for line in str(found).splitlines():
        printing.console.print(line)
    for remark in responses[0].remarks if responses else ():
        printing.warn(remark)
    for gains in tables.of_gains(responses):
        printing.table(gains)
    printing.results_of(out)
