"""Define `splitband inspect`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from splitband.checks.inspection import Inspection, as_found
from splitband.checks.inspection import inspect as inspected
from splitband.cli import options, printing, records
from splitband.cli.usage import command_of, comparing, usage
from splitband.forecasters.bands import Bands
from splitband.records.named import RECORDS
from splitband.records.signals import listed
from splitband.report import results
from splitband.report.tables import of_oracle
from splitband.report.words import sentence
from splitband.simulators.open_simulator import open_simulator, simulated


@options.with_groups
def inspect(
    context: typer.Context,
    record: options.RecordArgument,
    reading: options.RecordOptions,
    simulator: options.SimulatorOptions,
    train: Annotated[
        int | None,
        options.plain("Choose the cut-off from the first N samples.", "N", "three quarters"),
    ] = None,
    out: Annotated[
        Path | None, options.plain("Folder for results.json and a page with the spectrum.", "DIR")
    ] = None,
    cutoff: options.Cutoff = None,
    order: options.Order = None,
) -> None:
    """Show what a record holds and which command to run.

    The command prints the columns with their ranges, which of them are probably inputs and why,
    dead times, the strongest frequencies, whether there are two bands to split, and warnings; then
    the command that compares models of the record. Nothing is trained. Missing values are masked,
    samples at uneven times put on an even grid. Of several runs (--runs), the longest one is shown.

    With a simulator, it also prints the coherence of simulator and record, and the oracle check:
    the RMSE that a hybrid could reach at each cut-off. The cut-off is the one that `compare`
    chooses with the same --train.
    """
    runs = records.load_records(record, reading, reader=as_found)
    whole = max(runs, key=len)
    if len(runs) > 1:
        shortest, longest = min(map(len, runs)), len(whole)
        lengths = f"{longest}" if shortest == longest else f"{shortest} to {longest}"
        printing.console.print(f"{len(runs)} runs of {lengths} samples, of which {whole.name}:")
    opened = records.runnable(simulator, whole, reading.time_column)
    if opened is None and whole.y_sim is not None:  # a named record's own can run for longer
        opened = open_simulator(record, whole)
    if opened is not None:
        whole = simulated(whole, opened, longer=True)
    trained = RECORDS[record].train if train is None and record in RECORDS else train
    found = inspected(whole, trained, Bands(cutoff, order))
    asked = command_of(context)
    reads = {name: value for name, value in vars(reading).items() if name != "gaps"}
    named = {of: listed(v) if isinstance(v, list) else v for of, v in found.options.items()}
    command = comparing(record, reads | vars(simulator) | named)
    _show(found, command)
    if out is None:
        printing.as_json(asked | found.as_json() | {"run": command})
        return
    used = replace(usage(asked["command"], asked["arguments"]), commands=[("Run", command)])
    results.save_inspection(found, asked | {"run": command}, out, used)
    printing.results_of(out)


def _show(found: Inspection, command: str) -> None:
    """Print the columns, sentences, warnings and the command."""
    shown = Table("column", "likely", "range", "missing", "why", title=found.record.name)
    for each in shown.columns:
        each.overflow = "fold"
    for column in found.columns:
        missing = str(column.missing or "")
        shown.add_row(column.name, column.role, column.range, missing, ", ".join(column.reasons))
    printing.console.print(shown)
    if found.simulator is not None:
        printing.table(of_oracle(found.simulator))
    for line in found.in_words():
        printing.console.print(sentence(line))
    for warning in found.warnings:
        printing.warn(warning)
    printing.console.print(f"run:\n    {command}", soft_wrap=True)
