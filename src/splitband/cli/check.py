"""Define `splitband check`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from splitband.checks import model as checks
from splitband.checks.responses import of_stable_plant, respond_over_range
from splitband.cli import options, printing, records
from splitband.cli.usage import checking, command_of
from splitband.forecasters.loading import load
from splitband.report import results, tables
from splitband.report.page.parts import Usage
from splitband.runtime.errors import InputError


@options.with_groups
def check(
    context: typer.Context,
    model_dirs: Annotated[
        list[Path],
        typer.Argument(
            metavar="MODEL_DIR...",
            help="Folders of models that `fit`, `compare` or `forecast` saved.",
            show_default=False,
        ),
    ],
    record: Annotated[
        Path,
        options.plain(
            "Measured samples with the columns of the training record, preferably of another run.",
            "FILE",
        ),
    ],
    simulator: options.SimulatorOptions,
    files: options.FileOptions,
    ahead: Annotated[
        int | None,
        options.plain("Predict N samples ahead.", "N", "as the model was trained, or 10", min=1),
    ] = None,
    out: options.Out = Path("check"),
    device: options.Device = "cpu",
) -> None:
    """Check saved models on a record: fit, residual tests, stability, responses.

    The command prints the fit of a simulation, and of predictions 1, N/10 and N samples ahead, each
    from the measurements until then. It tests (at 99 %) whether the residuals of the simulation
    depend on the inputs and whether they are white noise, and whether a simulation of ten times the
    record, with its inputs repeated, stays in range. Inputs and outputs beyond their training
    ranges are named.

    OUT contains results.json and report.html, with plots and the step responses of the model. With
    several models, their simulations are drawn over the same record, and a table has their fits.
    """
    checked = dict[str, results.Checked]()
    models = {folder: load(folder) for folder in dict.fromkeys(model_dirs)}
    if ahead is None and len(models) > 1:  # alike for all
        ahead = min(map(checks.usual_ahead, models.values()))
    for folder, model in models.items():
        past = records.history_of(record, "--record", model, files)
        first = next((each.check.record for each in checked.values()), past)
        if past.columns != first.columns or not np.array_equal(past.y, first.y, equal_nan=True):
            raise InputError(
                f"MODEL_DIR must be models of the same outputs, prepared in the same way, got "
                f"{folder} beside {model_dirs[0]}: check them one by one"
            )
        if len(model_dirs) == 1 or "simulator" in model.needs or model.parameters:
            records.with_simulator(model, simulator, past, files)
        model.to(device)
        with printing.warnings_as_lines():
            found = checks.check(model, past, ahead)
            checked[str(folder)] = results.Checked(found, model, respond_over_range(model))
    facts = command_of(context)
    used = Usage(asked=checking(facts["arguments"]), files=[str(facts["arguments"]["record"])])
    results.save_check(checked, facts, out, used)
    if len(checked) > 1:
        printing.table(tables.of_checks({name: each.check for name, each in checked.items()}))
    for each in checked.values() if len(checked) == 1 else ():
        printing.console.print(str(each.check))
        for remark in each.responses[0].remarks if each.responses else ():
            printing.warn(remark)
        for gains in tables.of_gains(each.responses) if of_stable_plant(each.model) else ():
            printing.table(gains)
    printing.results_of(out)
