"""Define `splitband forecast`: `compare --train all`, then what comes after the record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import INTERRUPTED, options, records
from splitband.cli.compare import compared
from splitband.cli.requests import Request, planned
from splitband.cli.simulate import predicted
from splitband.comparison.recommendation import COVERAGE


@options.with_groups
def forecast(
    context: typer.Context,
    record: options.RecordArgument,
    reading: options.RecordOptions,
    simulator: options.SimulatorOrBaseOptions,
    further: options.FurtherRecords,
    steps: Annotated[int, options.plain("Number of samples to forecast.", "N", min=1)],
    ahead: options.Ahead = None,
    method: Annotated[
        str | None,
        options.plain(
            "The method to use (`splitband methods` lists them).", "NAME", "the best one"
        ),
    ] = None,
    seeds: options.Seeds = None,
    jobs: options.Jobs = None,
    out: Annotated[Path, options.plain("Folder for the forecast.", "DIR")] = Path("forecast"),
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

    The command runs `compare --train all`, then predicts with the recommended method from the end
    of the record on, and writes OUT/forecast.csv. A record with known inputs needs --future-inputs,
    and the output of a simulator must reach --steps samples beyond the record.
    """
    model = options.ModelOptions(
        epochs=epochs, budget=budget, rounds=rounds, seed=seed, device=device
    )
    asked = Request(record, reading, simulator, further, model=model, methods=method, like=like)
    plan = planned(replace(asked, train="all", ahead=ahead, seeds=seeds), context)
    u = records.inputs_ahead(future_inputs, plan.record, steps, reading)
    y_sim = records.simulator_ahead(simulator, plan.record, steps, u, reading)
    result = compared(context, plan, out, jobs, cluster)
    predicted(out / "forecast.csv", record, result.model, steps, u=u, y_sim=y_sim, level=COVERAGE)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)
