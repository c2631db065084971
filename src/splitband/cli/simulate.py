"""Define `splitband simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import typer

from splitband.cli import options, printing, records
from splitband.forecasters.base import Forecaster
from splitband.forecasters.loading import load
from splitband.forecasters.prediction import Prediction
from splitband.metrics import ExtrapolationWarning, leaves_range
from splitband.report.results import write_csv
from splitband.runtime.errors import InputError
from splitband.runtime.files import is_stream, output_folder
from splitband.runtime.threads import without_warnings
from splitband.simulators.open_simulator import trajectory


@options.with_groups
def simulate(
    out: Annotated[Path, options.plain("File for the simulated samples.", "FILE.csv")],
    simulator: options.SimulatorOptions,
    files: options.RecordOptions,
    model_dir: Annotated[
        Path | None,
        typer.Argument(
            metavar="MODEL_DIR",
            help="Folder of a saved model; without it, give --record and --simulator.",
            show_default=False,
        ),
    ] = None,
    steps: Annotated[
        int | None, options.plain("Number of samples to simulate.", "N", min=1)
    ] = None,
    record: Annotated[
        str | None,
        options.plain(
            "Run --simulator at the samples of this record, in place of a model. Other commands "
            "then take the file as --simulator FILE.csv, so that a slow simulator runs once.",
            "RECORD",
        ),
    ] = None,
    history: options.History = None,
    future_inputs: options.FutureInputs = None,
    other_run: options.OtherRun = False,
    level: Annotated[
        float | None,
        options.plain(
            "Also write the interval that should contain this share of the samples, such as 0.9. "
            "The model must have been saved with intervals (fit --intervals, or compare).",
            "SHARE",
        ),
    ] = None,
    device: options.Device = "cpu",
) -> None:
    """Predict with a saved model from the end of a measured history.

    Give the history and --future-inputs as they were measured: they are unwrapped, clipped,
    resampled and detrended like the training record. The outputs have its units.

    The CSV file has a column `time` and a column for each output; --level adds the limits of the
    interval. The time continues that of the history; without time stamps it counts the seconds
    after the last sample.

    A model with a simulator also needs --simulator. Its output must reach --steps samples beyond
    the history; a file must cover the warm-up, too. If the training record and the history have
    time stamps, a function or an FMU runs from the start of the training record, and periods,
    trends and a calibrated delay or clock count from there. Otherwise, and with --other-run, both
    records are assumed to start at the same time.

    Without a model, --record and --simulator write the simulator's output at the samples of the
    record and, with --steps, at N samples after it.
    """
    if out.is_dir():
        raise InputError(f"--out must be a file, got the folder {out}")
    own = {field.name for field in fields(options.FileOptions)}
    reading = {f"--{k.replace('_', '-')}": v for k, v in vars(files).items() if k not in own}
    if model_dir is None:
        ahead = {"--future-inputs": future_inputs, "--level": level}
        _refuse({"--history": history, "--other-run": other_run, **ahead}, "without MODEL_DIR")
        _simulate_beside(record, simulator, files, steps or 0, out)
        return
    _refuse({"--record": record, **reading}, "with MODEL_DIR")
    if steps is None:
        raise InputError("--steps must be given: the samples to simulate")
    forecaster = load(model_dir)
    past = forecaster.require_fitted().record
    trained = len(past)
    if history is not None:
        past = records.history_of(history, "--history", forecaster, files)
    since = 0 if history else forecaster.require_fitted().begin + trained
    u = records.inputs_ahead(future_inputs, past, steps, files, since)
    records.with_simulator(forecaster, simulator, past, files, steps)
    fitted = forecaster.require_fitted()
    by_time = forecaster.anchored or simulator.simulator is not None
    if history and by_time and not other_run and (begins := fitted.beginning(past)):
        printing.console.print(begins)
    forecaster.to(device)
    _make_folder(out)
    known: dict[str, Any] = {"u": u, "level": level, "other_record": other_run}
    if history is not None:
        known["history"] = past
    if unstable := fitted.report.unstable():
        printing.warn(f"{forecaster.name} is {unstable}")
    found = predicted(out, history or "the training record", forecaster, steps, **known)
    written = {"model": str(model_dir), "method": forecaster.name, "steps": steps, "file": str(out)}
    printing.as_json(written | {"leaves_range_after": leaves_range(fitted.y_range, found.y)})


def _simulate_beside(
    name: str | None,
    how: options.SimulatorOptions,
    reading: options.RecordOptions,
    steps: int,
    out: Path,
) -> None:
    """Write what a simulator returns at the samples of a record, and after them."""
    if name is None or how.simulator is None:
        raise InputError(
            "MODEL_DIR must be given, or --record and --simulator: a saved model, or a simulator "
            f"to run beside a record; got --record {name or 'none'}, --simulator "
            f"{how.simulator or 'none'}"
        )
    record = records.load_record(name, reading)
    simulator = records.runnable(how, record, reading.time_column)
    with printing.warnings_as_lines():
        found = trajectory(record, simulator, steps)
    _make_folder(out)
    write_csv(out, found.to_frame())
    printing.console.print(f"{len(found)} samples of {how.simulator}: {out}")
    written = {"simulator": how.simulator, "record": name, "samples": len(found)}
    printing.as_json({**written, "file": str(out)})


def _refuse(given: Mapping[str, Any], where: str) -> None:
    """Raise InputError for an option that is given, although it is for another use."""
    for option, value in given.items():
        if value not in (None, False):
            raise InputError(f"{option} must be left out {where}, got {value}")


def _make_folder(out: Path) -> None:
    if not is_stream(out):
        output_folder(out.parent, "--out")


def predicted(
    file: Path, after: Path | str, model: Forecaster, steps: int, **known: Any
) -> Prediction:
    """Write what a model predicts `after` a record; `known`: further arguments of `predict`."""
    with without_warnings(ExtrapolationWarning):
        found = model.predict(steps, **known)
    write_csv(file, found.to_frame())
    outputs, _ = model.require_fitted().record.labels
    units = "" if outputs == [*found.columns] else f"of {', '.join(outputs)} "
    printing.console.print(f"{steps} samples {units}after {after}: {file}")
    for reason in found.warnings:
        printing.warn(reason)
    return found
