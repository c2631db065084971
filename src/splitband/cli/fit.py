"""`splitband fit`."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from splitband.cli import devices, naming, records, setups, showing, timing
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Conditioned, ModelOptions, SettingsFile
from splitband.cli.options.records import FurtherRecords, RecordArgument, RecordOptions
from splitband.cli.options.simulators import Calibrate, SimulatorOrBaseOptions
from splitband.cli.options.workers import Jobs
from splitband.cli.simulators import each_with_simulator, with_simulator
from splitband.data import Record
from splitband.data.timing import as_json
from splitband.evaluation.plan import SEARCH
from splitband.evaluation.runs import RunProgress, Work
from splitband.evaluation.search import Search, search
from splitband.forecasters import saving
from splitband.forecasters.backtest import first_origin
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASES, NAMES, TRAINED, with_base, with_variants
from splitband.forecasters.network import Network
from splitband.metrics import rmse
from splitband.report import results
from splitband.runtime import deadlines
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.outputs import staged, write_facts
from splitband.runtime.threads import available_cores
from splitband.training import Checkpoint, Progress

FITTED = tuple(name for name in NAMES if name in TRAINED or "simulator" not in NAMES[name].needs)
"""Methods whose saved models `simulate` reads: all that learn something of the record."""


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
    saved = setups.load_settings(settings, model)
    if method is None:
        method = "split-gru" if saved is None else saved.method
    if calibrate or conditioned:
        method = with_variants([method], calibrate, conditioned)[-1]
    if simulator.simulator in BASES:
        (method,) = with_base([method], simulator.simulator)
    naming.check_names("--method", [method], FITTED)
    trajectory = records.load_record(record, reading, saved)
    trajectory = with_simulator(trajectory, simulator, reading, beyond=NAMES[method].calibrates)
    samples = len(trajectory) if train is None else train
    cores = jobs or available_cores()
    setup = setups.setup(
        record, trajectory, samples, model, [method], ahead=0, cores=cores, saved=saved
    )
    others = records.load_further(further.more, "--more", trajectory, reading)
    others = each_with_simulator(others, [method], further, simulator, reading)
    forecaster: Forecaster = devices.on_device(setup.forecaster(method), model.device)
    training = trajectory[: setup.train]
    naming.check_needs([forecaster], training)
    forecaster.check(training, *others)
    plan = timing.planned(setup, cores, 0)
    with showing.progress("fitting", plan, showing.kept(out / CHECKPOINTS)) as bar:

        def update(at: Progress) -> None:
            overall = SEARCH + at.share * (1 - SEARCH)
            bar(RunProgress(f"{method}, {at.task}", seed, at.share, at.loss, overall=overall))

        if setup.search is not None:
            work = Work(cores, bar, out / CHECKPOINTS, plan=plan)
            forecaster = _searched(training, forecaster, setup.search, work, others)
        (out / CHECKPOINTS).mkdir(exist_ok=True)
        checkpoint = Checkpoint(out / CHECKPOINTS / f"{method}-{seed}.safetensors")
        with deadlines.within(plan.deadline):
            forecaster.fit(training, *others, seed=seed, progress=update, checkpoint=checkpoint)
    fitted = forecaster.require_fitted()
    training_in_words = ""
    if isinstance(forecaster, Network):
        assert forecaster.settings is not None
        setup = replace(setup, settings=forecaster.settings)
        training_in_words = forecaster.training_in_words()
    calibration = forecaster.calibration
    facts = {
        "method": method,
        "seed": seed,
        "record": training.name,
        "more": [other.name for other in others],
        "range": fitted.y_range.tolist(),
        "sampling_time": training.sampling_time,
        "start": as_json(training.start),
        "columns": list(training.columns),
        "inputs": list(training.inputs),
        "input_delays": list(forecaster.delays),
        "setup": setup.as_json(),
        "training": training_in_words,
        "calibration": None if calibration is None else asdict(calibration),
    }
    within = _training_error(forecaster)
    outcome = {
        "final_loss": {name: losses[-1] for name, losses in fitted.report.losses.items()},
        "seconds": fitted.report.seconds,
        "notes": [*fitted.report.notes],
        "training_rmse": within,
    }
    with staged(out) as new:
        write_facts(new, facts | outcome | {"environment": results.environment()})
        saving.save(forecaster, out, facts)  # which replaces a model as a whole by itself
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


def _searched(
    training: Record,
    forecaster: Forecaster,
    allowed: Search,
    work: Work,
    others: Sequence[Record],
) -> Forecaster:
    """The forecaster with the training that has been found for it."""
    with work.staffed() as staff:
        until = work.plan.share(SEARCH)
        stage = replace(staff, deadline=until, span=(0.0, SEARCH))
        return search(training, [forecaster], 0, allowed, stage, others).forecasters[0]


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
