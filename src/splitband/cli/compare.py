"""`splitband compare` and `splitband demo`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli import given, options, showing
from splitband.cli.comparing import Request, Task, arguments, carried_out, prepared, save
from splitband.data import Trajectory
from splitband.evaluation.api import Comparison
from splitband.evaluation.selection import WORTH_TRAINING
from splitband.evaluation.setup import Setup, default_names
from splitband.filters.spectrum import periodogram
from splitband.forecasters.backtest import HELD_OUT
from splitband.forecasters.names import HYBRIDS, NAMES
from splitband.paper.settings import RECORD_SETTINGS, SAMPLE_FREQUENCY


@options.with_groups
def compare(
    context: typer.Context,
    record: options.Record,
    reading: options.RecordOptions,
    simulator: options.SimulatorOptions,
    further: options.FurtherRecords,
    testing: options.TestRecords,
    model: options.ModelOptions,
    train: options.Train = None,
    horizon: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Samples to predict beyond the training part.",
            show_default="all",
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            help=f"What to compare, separated by commas, out of {', '.join(NAMES)}.",
            show_default=f"{','.join(default_names(False))}; with a simulator "
            f"{','.join(default_names(True))}; with --inputs linear, too",
        ),
    ] = None,
    seeds: options.Seeds = None,
    jobs: options.Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder for results and pictures.")] = Path("out"),
    calibrate: options.Calibrate = False,
    conditioned: options.Conditioned = False,
) -> None:
    """Compare models of a record with each other and with naive baselines.

    Every method is fitted on the first --train samples only and predicts under two protocols:
    "from the start" warms up on the first samples and simulates to the end of the record;
    "forecast" warms up on the last training samples and simulates beyond them. The table shows the
    RMSE of the free run over everything after the warm-up, in the record's unit.

    The recommended method is chosen on training samples only. Fitted on three quarters of them, it
    forecasts the rest best, from several beginnings (the table shows that error as "held out"); and
    what it forecast then of the time after the training part has not changed by more than that
    error once it is fitted on all of them (the table shows by how much it "changed"). The held-out
    errors also give each forecast an interval in which nine tenths of the measured samples should
    lie; the table says how many do.

    With --test every method is fitted to all of RECORD and warmed up on the first samples of the
    test record, to simulate it to its end; the table shows the RMSE of the seeds' mean there.

    --calibrate and --conditioned add rows: each method that can be is also run that way.
    """
    request = Request(
        record, reading, simulator, further, testing, model,
        train, horizon, methods, seeds, jobs, calibrate, conditioned,
    )  # fmt: skip
    _compare(context, prepared(request), seeds, jobs, out)


@options.with_groups
def demo(
    context: typer.Context,
    out: Annotated[Path, typer.Option(help="Folder for results and pictures.")] = Path("demo"),
    jobs: options.Jobs = None,
) -> None:
    """Show what the package does, in under a minute: the paper's system (i).

    Two superposed oscillations under noise; 250 samples to learn from, 750 to predict. A split
    GRU against a single GRU of the same size and against naive baselines.
    """
    name = "double-mass-spring"
    record = given.load_record(name)
    methods = ["gru", "split-gru", "persistence", "seasonal-naive", "harmonic"]
    setup = replace(given.setup(name, record, None, options.ModelOptions(), methods), search=None)
    _compare(context, Task(record, methods, setup, [], [], "cpu"), 1, jobs, out)


def _compare(
    context: typer.Context, task: Task, seeds: int | None, jobs: int | None, out: Path
) -> None:
    result = carried_out(task, seeds, jobs, out)
    facts = {"command": context.info_name, "arguments": arguments(context.params)}
    save(result, out, facts)
    _say(result, task.names, out)


def _say(result: Comparison, names: list[str], out: Path) -> None:
    record, setup, trial = result.record, result.setup, result.require_trial()
    best = result.recommended
    showing.console.print(showing.comparison(_title(record, setup), result))
    changed = (
        f" and for how little its forecast of what follows changed once these were known "
        f"({trial.change(best):.3g})"
        if setup.train < len(record)
        else ""
    )
    showing.console.print(
        f"recommended: {best}, for its forecast of the last {HELD_OUT:.0%} of the training part "
        f"(held out: RMSE {trial.errors[best]:.3g}){changed}; a network has to be "
        f"{WORTH_TRAINING:.0%} better than what needs no training"
    )
    if result.left_out:
        showing.console.print(
            f"not tested: {', '.join(result.left_out)}; they go on from the training record, or "
            "need a simulator of the test record (--test-simulator)"
        )
    if record.ny > 1:
        showing.console.print(f"{best}: {showing.channels(result, best)}")
    bands = setup.bands
    if bands.cutoff is not None and bands.downsampling is not None:
        below = periodogram(record[: setup.train].y, record.sampling_rate).share_below(bands.cutoff)
        showing.console.print(
            f"cut-off {bands.cutoff:g} Hz{_papers_cutoff(record, setup)}, order {bands.order}, the "
            f"low band kept at every {showing.ordinal(bands.downsampling)} sample: "
            + (bands.choice.reason if bands.choice else f"{below:.0%} below")
        )
    unhelpful = bands.choice is not None and bands.choice.simulator_helps is False
    if unhelpful and not set(names) & set(HYBRIDS):
        showing.console.print("hybrid models are left out; --methods brings them back")
    showing.warn_of_trainings(result.runs)
    showing.warn_of_inputs(result.inputs_beyond_training, record.inputs)
    for test, prediction in zip(result.tests, result.means[best].tests, strict=False):
        for message in prediction.warnings:
            showing.console.print(f"warning: {test.name}: {message}", style="yellow")
    showing.console.print(f"results and pictures: {out}/")


def _title(record: Trajectory, setup: Setup) -> str:
    truth = "the noise-free signal" if record.y_true is not None else "the measurement"
    return (
        f"{record.name}: free-run RMSE against {truth}, {setup.train} samples to train on, "
        f"{len(record) - setup.train} beyond"
    )


def _papers_cutoff(record: Trajectory, setup: Setup) -> str:
    """The number in the paper's table, where the cut-off is the paper's."""
    column = RECORD_SETTINGS.get(record.name)
    if column is None or column.setup(record.sampling_rate).bands.cutoff != setup.bands.cutoff:
        return ""
    return f" (the paper's w = {column.cutoff:g} at f = {SAMPLE_FREQUENCY:g})"
