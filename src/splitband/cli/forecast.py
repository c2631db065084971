"""`splitband forecast`: what comes after the end of a record."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import naming, showing, timing
from splitband.cli.comparing import Request, arguments, planned
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import (
    Budget,
    Device,
    Effort,
    Epochs,
    ModelOptions,
    Seeds,
    SettingsFile,
)
from splitband.cli.options.records import (
    FurtherRecords,
    FutureInputs,
    RecordArgument,
    RecordOptions,
)
from splitband.cli.options.simulators import SimulatorOrBaseOptions
from splitband.cli.options.workers import Cluster, Jobs
from splitband.cli.usage import usage
from splitband.cli.worker_pool import worker_pool
from splitband.evaluation.forecast import Forecast, run_forecast
from splitband.forecasters.names import NAMES
from splitband.metrics import leaving
from splitband.report import page, results
from splitband.report.page.usage import Usage
from splitband.report.table import tried
from splitband.runtime.files import CHECKPOINTS


@with_groups
def forecast(
    context: typer.Context,
    record: RecordArgument,
    reading: RecordOptions,
    simulator: SimulatorOrBaseOptions,
    further: FurtherRecords,
    steps: Annotated[int, typer.Option(min=1, help="Samples to forecast.", show_default=False)],
    method: Annotated[
        str | None,
        typer.Option(
            help="One of those that `splitband methods` lists.",
            show_default="the one that forecasts the record's own last quarter best",
        ),
    ] = None,
    seeds: Seeds = None,
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder for the forecast.")] = Path("forecast"),
    future_inputs: FutureInputs = None,
    epochs: Epochs = None,
    budget: Budget = None,
    effort: Effort = None,
    device: Device = "cpu",
    settings: SettingsFile = None,
    cluster: Cluster = None,
) -> None:
    """Forecast a record beyond its end, with the interval that should hold nine tenths of it.

    Without --method, several are tried as `compare` tries them: each forecasts the last quarter of
    the record from the rest of it; with --settings, the network of that file and the
    baselines. What did well is fitted again, on the whole record, and should
    then still forecast the same. A simulator must reach --steps samples beyond the record; a
    record with known inputs needs --future-inputs.
    """
    if method is not None:
        naming.check_names("--method", [method], NAMES)
    request = Request(
        record, reading, simulator, further, methods=method, seeds=seeds, settings=settings,
        model=ModelOptions(epochs=epochs, budget=budget, effort=effort, device=device),
        future_inputs=future_inputs,
    )  # fmt: skip
    with worker_pool(jobs, cluster) as workers:
        plan = planned(request, workers.cores, steps)
        known = plan.record
        time = timing.planned(plan.setup, workers.cores, steps * known.ny * len(plan.methods))
        with showing.progress("forecasting", time, showing.kept(out / CHECKPOINTS)) as progress:
            result = run_forecast(plan, workers.work(progress, out, time))
    used = usage("forecast", arguments(context.params), out, plan, result.model)
    results.save_forecast(result, out, used)
    shutil.rmtree(out / CHECKPOINTS)
    _say(result, steps, out, used)
    showing.results_file(out / "results.json")


def _say(result: Forecast, steps: int, out: Path, used: Usage) -> None:
    showing.console.print(timing.in_words(result.time))
    trial, record = result.trial, result.record
    said = dict.fromkeys(trial.errors, "") | {
        name: f"could not be fitted: {reason}" for name, reason in trial.failed.items()
    }
    title = f"{record.name}: RMSE on its last quarter, fitted to the rest of it"
    listed = tried(trial, record, [*trial.errors])
    showing.methods(title, listed, said, result.method)
    showing.console.print(
        f"{steps} samples ahead by {result.method}: {out}/forecast.csv, forecast.png"
    )
    if result.leaves is not None:
        showing.console.print(leaving(result.leaves))
    showing.warn_of_inputs(result.inputs_beyond_training, result.record.inputs)
    for doubt in result.prediction.doubts:
        showing.warn(f"{result.method}: {doubt}")
    for what, command in used.commands[:1]:
        showing.console.print(f"{what}:\n    {command}", soft_wrap=True)
    showing.console.print(f"page: {out / page.NAME}")
