"""Define `splitband fit`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TimeRemainingColumn
from rich.progress import Progress as BarOfEpochs

from splitband.checks.model import runs_free
from splitband.cli import options, printing
from splitband.cli.display import running, workers
from splitband.cli.requests import Request, planned
from splitband.comparison.backtest import first_origin
from splitband.comparison.run import fit as fit_planned
from splitband.forecasters import saving
from splitband.forecasters.base import Forecaster
from splitband.forecasters.held_out import after, held_out_of
from splitband.metrics import ExtrapolationWarning, rmse
from splitband.records.timing import as_json
from splitband.report.environment import environment
from splitband.runtime.errors import InputError
from splitband.runtime.outputs import staged, write_facts
from splitband.runtime.threads import without_warnings
from splitband.training import Progress


@options.with_groups
def fit(
    context: typer.Context,
    record: options.RecordArgument,
    reading: options.RecordOptions,
    simulator: options.SimulatorOrBaseOptions,
    further: options.FurtherRecords,
    model: options.ModelOptions,
    out: Annotated[Path, options.plain("Folder for the model.", "MODEL_DIR")],
    method: Annotated[
        str | None,
        options.plain(
            "The method to fit (`splitband methods` lists them).", "NAME", "that of --like"
        ),
    ] = None,
    train: Annotated[int | None, options.plain("Train on the first N samples.", "N", "all")] = None,
    ahead: options.Ahead = None,
    intervals: Annotated[
        bool,
        options.plain(
            "Also calibrate intervals for `simulate --level`; this trains the model a second time."
        ),
    ] = False,
    jobs: options.Jobs = None,
    like: options.Like = None,
) -> None:
    """Train one method on a record and save the model.

    The training settings of a network are searched on the last quarter of the samples, as
    `compare` does, or taken from the model of --like.

    MODEL_DIR contains the weights of networks (safetensors), the rest of the model (JSON) and
    results.json.
    """
    if method is None and like is None:
        raise InputError(
            "method must be named: `splitband compare` recommends one, `splitband methods` lists "
            "them, and --like takes that of an earlier result; got none"
        )
    asked = Request(record, reading, simulator, further, model=model, methods=method, like=like)
    asked = replace(asked, train=train, ahead=ahead)
    plan = planned(asked, context, fitting=True)
    with workers(jobs) as where, running(plan, out) as how, _bar() as progress:
        forecaster = fit_planned(plan, **where, **how, progress=progress)
    late = how["clock"].notes
    if intervals:
        _try_out(forecaster, plan.ahead)
    training, settled = plan.training, plan.as_json()
    fitted, calibration = forecaster.require_fitted(), forecaster.calibration
    training_in_words = forecaster.training_in_words()
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
    error, report = _training_error(forecaster), fitted.report
    outcome = {
        "final_loss": {name: losses[-1] for name, losses in report.losses.items()},
        "seconds": report.seconds,
        "warnings": plan.warnings,
        "notes": [*report.notes, *late],
        "training_rmse": error,
    }
    with staged(out) as new:
        saving.save(forecaster, new, facts)
        write_facts(new, facts | outcome | {"environment": environment()})
    doubts = filter(None, [forecaster.parameters.get("doubt")])
    described = training_in_words or forecaster.describe()
    for note in dict.fromkeys((*plan.warnings, *report.notes, *doubts, *late)):
        if note not in plan.warnings:
            printing.warn(note)
        described = described.replace(f"; {note}", "")  # it is said once
    said = f"{forecaster.title}: {described}\n"
    said += f"trained on {len(fitted.record)} samples in {report.seconds:.1f} s"
    if error is not None:
        begin = max(forecaster.warmup, 2)
        said += f"; RMSE of their simulation from the first {begin} on: {error:.4g}"
    if calibration is not None:
        said += f"\ncalibration of the simulator: {calibration}"
    printing.console.print(f"{said}\nmodel: {out}/")
    printing.results_of(out)


@contextmanager
def _bar() -> Iterator[Callable[[Progress], None]]:
    """Show the epochs of a training, if standard error is a terminal."""
    shown = "{task.description}", BarColumn(), TaskProgressColumn(), TimeRemainingColumn()
    unseen = printing.console.quiet or not sys.stderr.isatty()
    bar = BarOfEpochs(*shown, console=Console(stderr=True), transient=True, disable=unseen)
    with bar:
        task = bar.add_task("training", total=1.0)

        def update(at: Progress) -> None:
            said = f"{at.task}, epoch {at.epoch} of {at.epochs}, loss {at.loss:.4g}"
            bar.update(task, completed=at.share, description=said)

        yield update


def _try_out(forecaster: Forecaster, ahead: int | None) -> None:
    """Calibrate intervals; if that fails, warn, and the model is saved without them."""
    try:
        with without_warnings(ExtrapolationWarning):
            held_out_of(forecaster, ahead)
    except (InputError, FloatingPointError) as error:
        printing.warn(f"the model has no intervals: {error}")


def _training_error(forecaster: Forecaster) -> float | None:
    """Return the RMSE of a free run over the training record; None where it shows nothing.

    That is where a record is no longer than the warm-up, and of a model that does not run free.
    """
    fitted = forecaster.require_fitted()
    record = fitted.record
    start = first_origin(record, len(record), forecaster.warmup).at
    if start == len(record):
        return None
    with without_warnings(ExtrapolationWarning):
        y = forecaster.predict(**after(record, start)).y
    return rmse(record.y_with_gaps[start:], y) if runs_free(forecaster, y) else None
