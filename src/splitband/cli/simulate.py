"""Define `splitband simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from splitband.cli import options, records, showing
from splitband.forecasters.loading import load
from splitband.metrics import leaves_range
from splitband.report.results import write_csv
from splitband.runtime.errors import InputError
from splitband.runtime.files import is_stream, output_folder


@options.with_groups
def simulate(
    model_dir: options.ModelArgument,
    steps: Annotated[int, options.plain("Samples to simulate after them.", None, False, min=1)],
    out: Annotated[Path, options.plain("Where to write the samples.", "FILE.csv", False)],
    simulator: options.SimulatorOptions,
    files: options.FileOptions,
    history: options.History = None,
    future_inputs: options.FutureInputs = None,
    other_run: options.OtherRun = False,
    level: Annotated[
        float | None,
        options.plain(
            "Also write the interval that should hold this share of the samples, 0 to 1. The model "
            "must have been saved with intervals (fit --intervals, compare).",
            None,
            False,
        ),
    ] = None,
    device: options.Device = "cpu",
) -> None:
    """Simulate a saved model beyond a measured history, or beyond its training record.

    A model with a simulator also needs --simulator, which must reach --steps samples beyond the
    history. If training record and history have time stamps, the offset between them is known: a
    function or an FMU runs from the start of the training record, and periods, trends and a
    calibrated delay or clock count from there. Otherwise, and with --other-run, both are taken to
    start together. An exported trajectory must cover the warm-up and the simulation, by its time
    stamps. The CSV has a column `time`, which continues the time stamps of the history (without
    any: seconds after its last sample), and one for each output; with --level also the limits of
    its interval.
    """
    if out.is_dir():
        raise InputError(f"--out must be a file, got the folder {out}")
    forecaster = load(model_dir)
    record = forecaster.require_fitted().record
    past = record
    if history is not None:
        past = records.history_of(history, "--history", forecaster, files)
    since = 0 if history else forecaster.require_fitted().begin + len(record)
    u = records.inputs_ahead(future_inputs, past, steps, files, since)
    forecaster = records.with_simulator(
        forecaster, model_dir, simulator, past, steps, files.time_column
    )
    fitted = forecaster.require_fitted()
    by_time = forecaster.anchored or simulator.simulator is not None
    if history and by_time and not other_run and (begins := fitted.beginning(past)):
        showing.console.print(begins)
    forecaster.to(device)
    with showing.without_warnings():
        found = forecaster.predict(
            steps, past if history else None, u, level=level, other_record=other_run
        )
    if not is_stream(out):
        output_folder(out.parent, "--out")
    write_csv(out, found.to_frame())
    showing.console.print(f"{steps} samples after {history or 'the training record'}: {out}")
    for reason in found.warnings:
        showing.warn(reason)
    written = {"model": str(model_dir), "method": forecaster.name, "steps": steps, "file": str(out)}
    showing.as_json(written | {"leaves_range_after": leaves_range(fitted.y_range, found.y)})
