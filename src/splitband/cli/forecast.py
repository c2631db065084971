"""Define `splitband forecast`: what comes after the end of a record."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import INTERRUPTED, options, showing
from splitband.cli.comparing import Request, planned
from splitband.cli.live import running, workers
from splitband.cli.usage import command_of, usage
from splitband.evaluation.forecast import Forecast, run_forecast
from splitband.report import results, words
from splitband.report.page import NAME as PAGE
from splitband.report.page.parts import Usage
from splitband.report.tables import of_forecast as tried_for
from splitband.runtime.outputs import MODEL_FOLDER


@options.with_groups
def forecast(
    context: typer.Context,
    record: options.RecordArgument,
    reading: options.RecordOptions,
    simulator: options.SimulatorOrBaseOptions,
    further: options.FurtherRecords,
    steps: Annotated[int, options.plain("Samples to forecast.", None, False, min=1)],
    method: Annotated[
        str | None,
        options.plain(
            "One of those that `splitband methods` lists.",
            None,
            "the one that forecasts the record's own last quarter best",
        ),
    ] = None,
    seeds: options.Seeds = None,
    jobs: options.Jobs = None,
    out: Annotated[Path, options.plain("Folder for the forecast.")] = Path("forecast"),
    future_inputs: options.FutureInputs = None,
    epochs: options.Epochs = None,
    budget: options.Budget = None,
    rounds: options.Rounds = None,
    seed: options.Seed = 0,
    device: options.Device = "cpu",
    like: options.Like = None,
    cluster: options.Cluster = None,
) -> None:
    """Forecast a record beyond its end, with a 90 % interval.

    Without --method, several are compared as by `compare`: each is trained on three quarters of the
    record and forecasts the last quarter; with --like, the model of that folder and the baselines.
    The best one is refitted to the whole record; its held-out errors give the interval. A simulator
    must reach --steps samples beyond the record; a record with known inputs needs --future-inputs.
    """
    asked = Request(
        record, reading, simulator, further, methods=method, seeds=seeds, like=like,
        model=options.ModelOptions(
            epochs=epochs, budget=budget, rounds=rounds, seed=seed, device=device
        ),
    )  # fmt: skip
    plan = planned(asked, steps, future_inputs)
    with workers(jobs, cluster) as where, running(plan, out) as how:
        result = run_forecast(plan, **where, **how)
    facts = command_of(context)
    used = usage(facts["command"], facts["arguments"], out, plan, result.model)
    results.save_forecast(result, out, facts, used)
    _show(result, out, used)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)


def _show(result: Forecast, out: Path, used: Usage) -> None:
    """Print the answer, then what was tried, then the time."""
    say, title = showing.console.print, result.model._title
    say(f"\n{len(result.prediction)} samples ahead by {title}", style="bold")
    for message in words.of_forecast(result):
        showing.warn(message)
    say(f"forecast: {out}/forecast.csv, trained model: {out / MODEL_FOLDER}/, page: {out / PAGE}\n")
    showing.table(tried_for(result))
    showing.use_of(used)
    say(result.clock.in_words())
    showing.facts_of(out)
