"""`splitband forecast`: what comes after the end of a record."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import devices, naming, records, setups, showing, timing
from splitband.cli.comparing import arguments
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
from splitband.cli.simulators import each_with_simulator, with_simulator
from splitband.cli.usage import usage
from splitband.cli.worker_pool import worker_pool
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.forecast import forecast as forecast_record
from splitband.evaluation.protocols import check
from splitband.evaluation.selection import check_trial
from splitband.evaluation.setup import default_names, trying_bases, usual_names
from splitband.forecasters.names import BASES, NAMES, TRAINED, with_base
from splitband.metrics import leaving
from splitband.report import page, results
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
    model = ModelOptions(epochs=epochs, budget=budget, effort=effort)
    saved = setups.load_settings(settings, model)
    known = records.load_record(record, reading, saved)
    hybrid = simulator.simulator is not None or known.y_sim is not None
    names = default_names(hybrid, known.nu > 0) if method is None else [method]
    if method is None and saved is not None:
        names = [saved.method, *(name for name in names if name not in TRAINED)]
    naming.check_names("--method", names, NAMES)
    based = simulator.simulator in BASES
    if simulator.simulator in BASES:
        names, hybrid = with_base(names, simulator.simulator), False
    beyond = any(NAMES[name].calibrates for name in names)
    known = with_simulator(known, simulator, reading, steps if hybrid else 0, beyond)
    u = records.inputs_ahead(future_inputs, known, steps, reading.time_column)
    known = replace(known, u_beyond=u)
    with worker_pool(jobs, cluster) as workers:
        setup = setups.setup_ahead(known, names, model, workers.cores, saved)
        if method is None and saved is None and not based:
            names, setup = usual_names(known, setup), trying_bases(setup)
        others = records.load_further(further.more, "--more", known, reading)
        others = each_with_simulator(others, names, further, simulator, reading)
        methods = [devices.on_device(setup.forecaster(name), device) for name in names]
        naming.check_needs(methods, known)
        check(known, methods, setup, others, beyond=True)
        check_trial(known, methods, setup, others)
        numbers = steps * known.ny * len(methods)
        plan = timing.planned(setup, workers.cores, numbers)
        with showing.progress("forecasting", plan, showing.kept(out / CHECKPOINTS)) as progress:
            result = forecast_record(
                known, steps, methods,
                others=others, seeds=seeds, setup=setup, work=workers.work(progress, out, plan),
            )  # fmt: skip
    found = results.found_in(result.forecaster, out)
    given = arguments(context.params)
    used = usage("forecast", given, result.method, known.nu > 0, found=found)
    results.save_forecast(result, out, [other.name for other in others], used)
    shutil.rmtree(out / CHECKPOINTS)
    _say(result, steps, out)
    showing.results_file(out / "results.json")


def _say(result: Forecast, steps: int, out: Path) -> None:
    showing.console.print(timing.in_words(result.plan))
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
    showing.console.print(f"page: {out / page.NAME}")
