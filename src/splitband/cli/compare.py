"""`splitband compare` and `splitband demo`."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from splitband.cli import given, options, showing
from splitband.cli.simulators import each_with_simulator, tests_with_simulator, with_simulator
from splitband.data import Trajectory
from splitband.evaluation.api import Comparison
from splitband.evaluation.api import compare as compare_forecasters
from splitband.evaluation.comparison import check
from splitband.evaluation.runs import Work
from splitband.evaluation.selection import WORTH_TRAINING, check_trial
from splitband.evaluation.setup import Setup, default_names, usual_names
from splitband.filters.spectrum import periodogram
from splitband.forecasters.backtest import HELD_OUT
from splitband.forecasters.names import BASES, CALIBRATED, HYBRIDS, NAMES, with_base, with_variants
from splitband.paper.settings import RECORD_SETTINGS, SAMPLE_FREQUENCY
from splitband.report import results
from splitband.runtime.files import CHECKPOINTS, output_folder
from splitband.runtime.threads import available_cores


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
    trajectory = given.load_record(record, reading)
    hybrid = simulator.simulator is not None or trajectory.y_sim is not None
    by_default = default_names(hybrid, trajectory.nu > 0)
    asked = by_default if methods is None else given.method_names(methods)
    chosen = with_variants(asked, calibrate, conditioned)
    based = simulator.simulator in BASES
    if simulator.simulator in BASES:
        chosen = with_base(chosen, simulator.simulator)
    beyond = any(CALIBRATED in method for method in chosen)
    trajectory = with_simulator(trajectory, simulator, reading, beyond=beyond)
    tested = bool(testing.test)
    setup = given.setup(
        record, trajectory, train, model, chosen, 1 - tested, tested, jobs or available_cores()
    )
    if methods is None and not based:
        chosen = with_variants(usual_names(trajectory, setup), calibrate, conditioned)
    if horizon is not None:
        if setup.train + horizon > len(trajectory):
            raise ValueError(
                f"--horizon must end within the record: at most {len(trajectory) - setup.train} "
                f"samples after the {setup.train} of --train, got {horizon}"
            )
        trajectory = trajectory[: setup.train + horizon]
    others = given.load_further(further.more, "--more", trajectory, reading)
    others = each_with_simulator(others, chosen, further, simulator, reading)
    tests = tests_with_simulator(
        given.load_further(testing.test, "--test", trajectory, reading), testing, simulator, reading
    )
    task = Task(trajectory, chosen, setup, others, tests, model.device)
    _compare(context, task, seeds, jobs, out)


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


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be compared on what.

    Attributes
    ----------
    record, setup : See `evaluation.api.compare`.
    names : Of the methods.
    others : Further records to train on.
    tests : Records to test on.
    device : Of the networks.
    """

    record: Trajectory
    names: list[str]
    setup: Setup
    others: list[Trajectory]
    tests: list[Trajectory]
    device: str


def _compare(
    context: typer.Context, task: Task, seeds: int | None, jobs: int | None, out: Path
) -> None:
    record, setup, others, tests = task.record, task.setup, task.others, task.tests
    methods = [given.on_device(setup.forecaster(name), task.device) for name in task.names]
    given.check_needs(methods, record)
    check(record, methods, setup, others, tests)
    check_trial(record, methods, setup, others)
    output_folder(out)
    with showing.progress() as progress:
        work = Work(jobs or available_cores(), progress, out / CHECKPOINTS)
        result = compare_forecasters(
            record,
            methods=methods,
            others=others,
            tests=tests,
            seeds=seeds,
            setup=setup,
            work=work,
        )
    arguments = {k: str(v) if isinstance(v, Path) else v for k, v in context.params.items()}
    facts: dict[str, Any] = {"command": context.info_name, "arguments": arguments}
    results.save(result, out, facts)
    shutil.rmtree(out / CHECKPOINTS)
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
