"""`splitband fit`."""

from __future__ import annotations

import shutil
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from splitband.cli import naming, setups, showing, timing
from splitband.cli.comparing import Request, planned
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Conditioned, ModelOptions, SettingsFile
from splitband.cli.options.records import FurtherRecords, RecordArgument, RecordOptions
from splitband.cli.options.simulators import Calibrate, SimulatorOrBaseOptions
from splitband.cli.options.workers import Jobs
from splitband.cli.simulators import with_own_parameters
from splitband.data.timing import as_json
from splitband.evaluation.run import fit as fit_planned
from splitband.evaluation.work import Work
from splitband.forecasters import saving
from splitband.forecasters.backtest import first_origin
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASES, GREY_BOX, with_base, with_variants
from splitband.metrics import rmse
from splitband.report import results
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.outputs import staged, write_facts
from splitband.runtime.threads import available_cores


@with_groups
def fit(
    record: RecordArgument,
    reading: RecordOptions,
    simulator: SimulatorOrBaseOptions,
    further: FurtherRecords,
    model: ModelOptions,
    out: Annotated[
        Path, typer.Option(metavar="MODEL_DIR", help="Folder for the model.", show_default=False)
    ],
    method: Annotated[
        str | None,
        typer.Option(
            help="What to fit, out of what `splitband methods` lists.",
            show_default="that of --settings, or split-gru",
        ),
    ] = None,
    train: Annotated[
        int | None,
        typer.Option(help="Samples at the beginning to train on.", show_default="all"),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="Of initial weights and order of windows.")
    ] = 0,
    calibrate: Calibrate = False,
    conditioned: Conditioned = False,
    jobs: Jobs = None,
    settings: SettingsFile = None,
) -> None:
    """Fit one method to a record and save it.

    How a network is trained is found on the last quarter of the samples first, as by `compare`, or
    said by --settings.

    MODEL_DIR gets the weights of networks (safetensors), everything else (JSON) and results.json.
    """
    if method is None:
        saved = setups.load_settings(settings, model)
        method = "split-gru" if saved is None else saved.method
    if calibrate or conditioned:
        method = with_variants([method], calibrate, conditioned)[-1]
    simulator = replace(simulator, parameters=with_own_parameters(simulator).parameters)
    if simulator.parameters is not None:
        (method,) = with_base([method], GREY_BOX)
    elif simulator.simulator in BASES:
        (method,) = with_base([method], simulator.simulator)
    naming.check_names("--method", [method], naming.FITTED)
    request = Request(
        record, reading, simulator, further, model=model, train=train, methods=method,
        settings=settings,
    )  # fmt: skip
    plan = planned(request, jobs or available_cores(), fitting=True)
    time = timing.planned(plan.setup, jobs or available_cores(), 0)
    with showing.progress("fitting", time, showing.kept(out / CHECKPOINTS)) as bar:
        work = Work(jobs or available_cores(), bar, out / CHECKPOINTS, time=time)
        forecaster = fit_planned(plan, seed, work)
    training, setup = plan.training, plan.setup
    fitted = forecaster.require_fitted()
    training_in_words = forecaster.training_in_words()
    if forecaster.settings is not None:
        setup = replace(setup, settings=forecaster.settings)
    calibration = forecaster.calibration
    facts = {
        "method": method,
        "seed": seed,
        "record": training.name,
        "more": [other.name for other in plan.others],
        "range": fitted.y_range.tolist(),
        "sampling_time": training.sampling_time,
        "start": as_json(training.start),
        "columns": list(training.columns),
        "inputs": list(training.inputs),
        "input_delays": list(forecaster.delays),
        "setup": setup.as_json(),
        "training": training_in_words,
        "calibration": None if calibration is None else asdict(calibration),
        "parameters": forecaster.parameters,
    }
    within = _training_error(forecaster)
    outcome = {
        "final_loss": {name: losses[-1] for name, losses in fitted.report.losses.items()},
        "seconds": fitted.report.seconds,
        "notes": [*fitted.report.notes],
        "training_rmse": within,
    }
    with staged(out) as new:
        saving.save(forecaster, new, facts)
        write_facts(new, facts | outcome | {"environment": results.environment()})
    shutil.rmtree(out / CHECKPOINTS)
    for note in fitted.report.notes:
        showing.warn(note)
    said = training_in_words or forecaster.describe()
    showing.console.print(
        f"{method} ({said}) fitted to {len(training)} samples in {fitted.report.seconds:.1f} s"
        f"{_free_run(forecaster, within)}\n"
        + ("" if calibration is None else f"simulator calibrated: {calibration}\n")
        + f"model: {out}/",
    )
    showing.results_file(out / "results.json")


def _training_error(forecaster: Forecaster) -> float | None:
    """RMSE of a free run over the training record from its first samples, if there are more."""
    record = forecaster.require_fitted().record
    start = first_origin(record, len(record), forecaster.warmup).at
    if start == len(record):
        return None
    with showing.without_warnings():
        y = forecaster.predict(len(record) - start, record[:start]).y
    return rmse(record.seen[start:], np.asarray(y))


def _free_run(forecaster: Forecaster, error: float | None) -> str:
    """The `_training_error` in words; empty where there is none."""
    begin = max(forecaster.warmup, 2)
    return "" if error is None else f"; free run over them from the first {begin}: RMSE {error:.4g}"
