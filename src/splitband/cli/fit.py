"""Define `splitband fit`."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TimeRemainingColumn
from rich.progress import Progress as BarOfEpochs

from splitband.cli import showing
from splitband.cli.comparing import Request, planned, workers
from splitband.cli.live import running
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Conditioned, Jobs, Like, ModelOptions
from splitband.cli.options.records import FurtherRecords, RecordArgument, RecordOptions
from splitband.cli.options.simulators import Calibrate, SimulatorOrBaseOptions
from splitband.data.timing import as_json
from splitband.evaluation.run import fit as fit_planned
from splitband.forecasters import saving
from splitband.forecasters.backtest import first_origin, held_out_of
from splitband.forecasters.base import Forecaster
from splitband.metrics import rmse
from splitband.report.environment import environment
from splitband.runtime.errors import InputError
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.outputs import staged, write_facts
from splitband.training import Progress


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
            show_default="that of --like, or split-gru",
        ),
    ] = None,
    train: Annotated[
        int | None,
        typer.Option(help="Samples at the beginning to train on.", show_default="all"),
    ] = None,
    calibrate: Calibrate = False,
    conditioned: Conditioned = False,
    intervals: Annotated[
        bool,
        typer.Option(
            "--intervals",
            help="Also train on three quarters of the record, for the intervals of "
            "`simulate --level`.",
        ),
    ] = False,
    jobs: Jobs = None,
    like: Like = None,
) -> None:
    """Fit one method to a record and save it.

    How a network is trained is found on the last quarter of the samples first, as by `compare`, or
    as the model of --like was trained.

    MODEL_DIR gets the weights of networks (safetensors), everything else (JSON) and results.json.
    """
    asked = Request(
        record, reading, simulator, further, model=model, train=train, methods=method,
        calibrate=calibrate, conditioned=conditioned, like=like,
    )  # fmt: skip
    plan = planned(asked, fitting=True)
    with workers(jobs) as where, running(plan, out, {}, partly=False) as how, _bar() as progress:
        forecaster = fit_planned(plan, **where, **how, progress=progress)
    if intervals:
        _try_out(forecaster)
    training, settled = plan.training, plan.as_json()
    fitted, calibration = forecaster.require_fitted(), forecaster.calibration
    training_in_words = forecaster._training_in_words()
    if forecaster.settings is not None:
        settled |= {"settings": asdict(forecaster.settings)}
    facts = {
        "method": forecaster.name,
        "seed": plan.seed,
        "record": training.name,
        "more": [other.name for other in plan.others],
        "range": fitted.y_range.tolist(),
        "sampling_time": training.sampling_time,
        "start": as_json(training.start),
        "columns": list(training.columns),
        "inputs": list(training.inputs),
        "input_delays": list(forecaster.delays),
        "setup": settled,
        "training": training_in_words,
        "calibration": None if calibration is None else asdict(calibration),
        "parameters": forecaster.parameters,
    }
    error = _training_error(forecaster)
    outcome = {
        "final_loss": {name: losses[-1] for name, losses in fitted.report.losses.items()},
        "seconds": fitted.report.seconds,
        "notes": [*fitted.report.notes],
        "training_rmse": error,
    }
    with staged(out) as new:
        saving.save(forecaster, new, facts)
        write_facts(new, facts | outcome | {"environment": environment()})
    shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
    for note in fitted.report.notes:
        showing.warn(note)
    said = training_in_words or forecaster.describe()
    begin = max(forecaster.warmup, 2)
    showing.console.print(
        f"{forecaster.name} ({said}) fitted to {len(fitted.record)} samples in "
        f"{fitted.report.seconds:.1f} s"
        + (
            ""
            if error is None
            else f"; free run over them from the first {begin}: RMSE {error:.4g}"
        )
        + ("" if calibration is None else f"\nsimulator calibrated: {calibration}")
        + f"\nmodel: {out}/"
    )
    showing.results_of(out)


@contextmanager
def _bar() -> Iterator[Callable[[Progress], None]]:
    """Show the epochs of a training, if standard error is a terminal."""
    bar = BarOfEpochs(
        "[progress.description]{task.description}", BarColumn(), TaskProgressColumn(),
        TimeRemainingColumn(), console=Console(stderr=True), transient=True,
        disable=showing.console.quiet or not sys.stderr.isatty(),
    )  # fmt: skip
    with bar:
        task = bar.add_task("training", total=1.0)

        def update(at: Progress) -> None:
            said = f"{at.task}, epoch {at.epoch} of {at.epochs}, loss {at.loss:.4g}"
            bar.update(task, completed=at.share, description=said)

        yield update


def _try_out(forecaster: Forecaster) -> None:
    """Calibrate intervals; if that fails, warn, and the model is saved without them."""
    try:
        with showing.without_warnings():
            held_out_of(forecaster)
    except (InputError, FloatingPointError) as error:
        showing.warn(f"the model has no intervals: {error}")


def _training_error(forecaster: Forecaster) -> float | None:
    """Return the RMSE of a free run over the training record, if it is longer than the warm-up."""
    record = forecaster.require_fitted().record
    start = first_origin(record, len(record), forecaster.warmup).at
    if start == len(record):
        return None
    with showing.without_warnings():
        y = forecaster.predict(len(record) - start, record[:start]).y
    return rmse(record.y_with_gaps[start:], np.asarray(y))
