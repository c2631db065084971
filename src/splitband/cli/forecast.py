"""Define `splitband forecast`: what comes after the end of a record."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import INTERRUPTED, showing
from splitband.cli.comparing import Request, arguments, command_of, planned, workers
from splitband.cli.live import running
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import (
    Budget,
    Cluster,
    Device,
    Epochs,
    Jobs,
    Like,
    ModelOptions,
    Rounds,
    Seed,
    Seeds,
)
from splitband.cli.options.records import (
    FurtherRecords,
    FutureInputs,
    RecordArgument,
    RecordOptions,
)
from splitband.cli.options.simulators import SimulatorOrBaseOptions
from splitband.cli.usage import usage
from splitband.evaluation.forecast import Forecast, run_forecast
from splitband.report import results
from splitband.report.page.parts import Usage
from splitband.report.table import of_trial
from splitband.report.words import of_forecast
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
    rounds: Rounds = None,
    seed: Seed = 0,
    device: Device = "cpu",
    like: Like = None,
    cluster: Cluster = None,
) -> None:
    """Forecast a record beyond its end, with the interval that should hold nine tenths of it.

    Without --method, several are tried as `compare` tries them: each forecasts the last quarter of
    the record from the rest of it; with --like, the model of that folder and
    the baselines. What did well is fitted again, on the whole record, and should
    then still forecast the same. A simulator must reach --steps samples beyond the record; a
    record with known inputs needs --future-inputs.
    """
    asked = Request(
        record, reading, simulator, further, methods=method, seeds=seeds, like=like,
        model=ModelOptions(
            epochs=epochs, budget=budget, rounds=rounds, seed=seed, device=device
        ),
    )  # fmt: skip
    plan = planned(asked, steps, future_inputs)
    facts = command_of(context)
    with workers(jobs, cluster) as where, running(plan, out, facts, partly=False) as how:
        result = run_forecast(plan, **where, **how)
    used = usage("forecast", arguments(context.params), out, plan, result.model)
    results.save_forecast(result, out, used)
    _show(result, out, used)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
    shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)


def _show(result: Forecast, out: Path, used: Usage) -> None:
    showing.console.print(result.clock.in_words())
    showing.table(of_trial(result.trial, result.record))
    showing.console.print(
        f"{len(result.prediction)} samples ahead by {result.method}: {out}/forecast.csv"
    )
    for message in of_forecast(result):
        showing.warn(message)
    showing.results_of(out, used)
