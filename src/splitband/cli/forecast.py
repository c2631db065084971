"""`splitband forecast`: what comes after the end of a record."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import given, options, showing
from splitband.cli.simulators import each_with_simulator, with_simulator
from splitband.evaluation.comparison import ahead_of, compare, inputs_beyond
from splitband.evaluation.defaults import default_methods, usual_methods
from splitband.evaluation.selection import TRIED, Trial, check_trial, try_out
from splitband.forecasters.methods import CALIBRATED, FIXED, METHODS, TRAINED, check
from splitband.report import pictures, results
from splitband.runtime.files import CHECKPOINTS, output_folder, replacing, write_json
from splitband.runtime.threads import available_cores


def forecast(
    record: options.Record,
    steps: Annotated[int, typer.Option(min=1, help="Samples to forecast.", show_default=False)],
    method: Annotated[
        str | None,
        typer.Option(
            help=f"Out of {', '.join(METHODS)}.",
            show_default="the one that forecasts the record's own last quarter best",
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=1, help="Trainings of a network; their mean is the forecast.")
    ] = 3,
    jobs: options.Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder for the forecast.")] = Path("forecast"),
    columns: options.Columns = None,
    inputs: options.Inputs = None,
    future_inputs: options.FutureInputs = None,
    time_column: options.TimeColumn = None,
    sampling_time: options.SamplingTime = None,
    gaps: options.GapsOption = "refuse",
    more: options.More = None,
    simulator: options.SimulatorOption = None,
    simulator_columns: options.SimulatorColumns = None,
    simulator_timeout: options.SimulatorTimeout = options.PATIENCE,
    simulator_cache: options.SimulatorCache = None,
    more_simulator: options.MoreSimulators = None,
    epochs: options.Epochs = None,
) -> None:
    """Forecast a record beyond its end, with the interval that should hold nine tenths of it.

    Without --method, several are tried as `compare` tries them: each forecasts the last quarter of
    the record from the rest of it. What did well is fitted again, on the whole record, and should
    then still forecast the same. A simulator must reach --steps samples beyond the record; a
    record with known inputs needs --future-inputs.
    """
    known = given.load_record(record, columns, inputs, time_column, sampling_time, gaps)
    hybrid = simulator is not None or known.y_sim is not None
    methods = default_methods(hybrid, known.nu > 0) if method is None else [method]
    if methods[0] not in METHODS:
        raise ValueError(f"--method must be one of {', '.join(METHODS)}, got {method}")
    known = with_simulator(
        known,
        simulator,
        simulator_columns,
        simulator_timeout,
        simulator_cache,
        ahead=steps if hybrid else 0,
        beyond=any(CALIBRATED in name for name in methods),
        time_column=time_column,
    )
    ahead = known.grid.after(steps)
    u = given.inputs_ahead(future_inputs, given.names(inputs or ""), ahead, time_column)
    longer = ahead_of(known, steps, u)
    setup = given.setup("", longer, len(known), methods=methods, epochs=epochs)
    methods = usual_methods(longer, setup) if method is None else methods
    further = each_with_simulator(
        given.load_further(more, known, inputs, time_column, gaps),
        methods,
        more_simulator,
        simulator_columns,
        simulator_timeout,
        simulator_cache,
        time_column,
    )
    check(longer, methods, setup, further)
    check_trial(longer, methods, setup, further)
    output_folder(out)
    jobs = jobs or available_cores()
    tried = len(set(methods) & set(TRAINED))
    with showing.progress(min(seeds, TRIED) * tried, "training on three quarters") as progress:
        folder = out / CHECKPOINTS / "three quarters"
        trial = try_out(
            longer, methods, setup, range(seeds)[:TRIED], jobs, progress, folder, further
        )
    # Of the networks just the best one is worth its training on all of the record.
    fitted = [name for name in trial.errors if name in FIXED or name == trial.best_network]
    with showing.progress(seeds * bool(trial.best_network), "training") as progress:
        folder = out / CHECKPOINTS / "whole"
        found = compare(
            longer, fitted, setup, range(seeds), jobs, progress, checkpoints=folder, more=further
        )
    trial = trial.settled(found)
    best = trial.recommended
    runs = found[best]
    left = min((run.leaves for run in runs if run.leaves is not None), default=None)
    beyond = inputs_beyond([known, *further], u)
    table = results.forecast(known, runs, trial.intervals[best])
    with replacing(out / "forecast.csv") as temporary:
        table.to_csv(temporary, index=False)
    facts = {
        "record": known.name,
        "samples": len(known),
        "gaps": int((~known.complete).sum()),
        "more": [other.name for other in further],
        "leaves_training_range_after": left,
        "inputs_beyond_training": [asdict(each) for each in beyond],
        "steps": steps,
        "method": best,
        "description": runs[0].description,
        "held_out_rmse": dict(trial.errors),
        "failed": dict(trial.failed),
        "change": {name: trial.change(name) for name in trial.final},
        "interval": asdict(trial.intervals[best]),
        "seeds": [run.seed for run in runs],
        "environment": results.environment(),
    }
    write_json(out / "results.json", facts)
    pictures.save(pictures.forecast(known, table, best), out / "forecast.png")
    shutil.rmtree(out / CHECKPOINTS)
    _say(trial, best, steps, out)
    if left is not None:
        showing.console.print(showing.leaving(left))
    showing.warn_of_inputs(beyond, given.names(inputs or ""))


def _say(trial: Trial, best: str, steps: int, out: Path) -> None:
    others = sorted(trial.errors.items(), key=lambda pair: pair[1])
    listed = ", ".join(f"{name} {error:.3g}" for name, error in others)
    showing.console.print(f"RMSE on the record's last quarter, from the rest of it: {listed}")
    for name, reason in trial.failed.items():
        showing.console.print(f"{name} could not be fitted: {reason}")
    showing.console.print(f"{steps} samples ahead by {best}: {out}/forecast.csv, forecast.png")
