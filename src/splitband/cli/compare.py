"""`splitband compare` and `splitband demo`."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from splitband.cli import given, options, showing
from splitband.cli.simulators import each_with_simulator, with_simulator
from splitband.data import Trajectory
from splitband.evaluation.comparison import compare as run_comparison
from splitband.evaluation.comparison import inputs_beyond
from splitband.evaluation.defaults import default_methods, usual_methods
from splitband.evaluation.selection import HELD_OUT, TRIED, WORTH_TRAINING, check_trial, try_out
from splitband.filters.spectrum import periodogram
from splitband.forecasters.methods import (
    CALIBRATED,
    HYBRIDS,
    METHODS,
    TRAINED,
    Setup,
    check,
    with_variants,
)
from splitband.paper.settings import RECORD_SETTINGS, SAMPLE_FREQUENCY
from splitband.report import pictures, results
from splitband.runtime.files import CHECKPOINTS, output_folder, replacing, write_json
from splitband.runtime.threads import available_cores


def compare(
    context: typer.Context,
    record: options.Record,
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
            help=f"What to compare, separated by commas, out of {', '.join(METHODS)}.",
            show_default=f"{','.join(default_methods(False))}; with a simulator "
            f"{','.join(default_methods(True))}; with --inputs linear, too",
        ),
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(
            min=1, help="Trainings of each network; the mean of their predictions is handed out."
        ),
    ] = 3,
    jobs: options.Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder for results and pictures.")] = Path("out"),
    columns: options.Columns = None,
    inputs: options.Inputs = None,
    time_column: options.TimeColumn = None,
    sampling_time: options.SamplingTime = None,
    gaps: options.GapsOption = "refuse",
    more: options.More = None,
    simulator: options.SimulatorOption = None,
    simulator_columns: options.SimulatorColumns = None,
    simulator_timeout: options.SimulatorTimeout = options.PATIENCE,
    simulator_cache: options.SimulatorCache = None,
    more_simulator: options.MoreSimulators = None,
    calibrate: options.Calibrate = False,
    conditioned: options.Conditioned = False,
    cutoff: options.Cutoff = None,
    order: options.Order = None,
    downsampling: options.Downsampling = None,
    warmup: options.Warmup = None,
    window: options.Window = None,
    epochs: options.Epochs = None,
    recipe: options.RecipeOption = "default",
    learning_rate: options.LearningRate = None,
    lr_milestones: options.Milestones = None,
    hidden: options.Hidden = None,
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

    --calibrate and --conditioned add rows: each method that can be is also run that way.
    """
    trajectory = given.load_record(record, columns, inputs, time_column, sampling_time, gaps)
    hybrid = simulator is not None or trajectory.y_sim is not None
    by_default = default_methods(hybrid, trajectory.nu > 0)
    asked = by_default if methods is None else given.names(methods)
    chosen = with_variants(asked, calibrate, conditioned)
    trajectory = with_simulator(
        trajectory,
        simulator,
        simulator_columns,
        simulator_timeout,
        simulator_cache,
        beyond=any(CALIBRATED in method for method in chosen),
        time_column=time_column,
    )
    setup = given.setup(
        record,
        trajectory,
        train,
        recipe=recipe,
        methods=chosen,
        cutoff=cutoff,
        order=order,
        downsampling=downsampling,
        warmup=warmup,
        window=window,
        epochs=epochs,
        learning_rate=learning_rate,
        milestones=lr_milestones,
        hidden=hidden,
    )
    if methods is None:
        chosen = with_variants(usual_methods(trajectory, setup), calibrate, conditioned)
    if horizon is not None:
        if setup.train + horizon > len(trajectory):
            raise ValueError(
                f"--horizon must end within the record: at most {len(trajectory) - setup.train} "
                f"samples after the {setup.train} of --train, got {horizon}"
            )
        trajectory = trajectory[: setup.train + horizon]
    further = each_with_simulator(
        given.load_further(more, trajectory, inputs, time_column, gaps),
        chosen,
        more_simulator,
        simulator_columns,
        simulator_timeout,
        simulator_cache,
        time_column,
    )
    _compare(context, trajectory, chosen, setup, seeds, jobs, out, further)


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
    _compare(context, record, methods, given.setup(name, record, None), 1, jobs, out)


def _compare(
    context: typer.Context,
    record: Trajectory,
    methods: list[str],
    setup: Setup,
    seeds: int,
    jobs: int | None,
    out: Path,
    more: Sequence[Trajectory] = (),
) -> None:
    check(record, methods, setup, more)
    check_trial(record, methods, setup, more)
    output_folder(out)
    networks = len(set(methods) & set(TRAINED))
    jobs = min(jobs or available_cores(), max(seeds * networks, 1))
    chosen = range(seeds)
    with showing.progress(min(seeds, TRIED) * networks, "training on three quarters") as progress:
        folder = out / CHECKPOINTS / "three quarters"
        trial = try_out(record, methods, setup, chosen[:TRIED], jobs, progress, folder, more)
    with showing.progress(seeds * networks, "training") as progress:
        folder = out / CHECKPOINTS / "whole"
        runs = run_comparison(
            record, [*trial.errors], setup, chosen, jobs, progress, checkpoints=folder, more=more
        )
    trial = trial.settled(runs)
    found = periodogram(record[: setup.train].y, record.sampling_rate)
    arguments = {k: str(v) if isinstance(v, Path) else v for k, v in context.params.items()}
    facts: dict[str, Any] = {"command": context.info_name, "arguments": arguments}
    ahead = None if record.u is None else record.u[setup.train :]
    beyond = inputs_beyond([record[: setup.train], *more], ahead)
    facts["inputs_beyond_training"] = [asdict(each) for each in beyond]
    write_json(out / "results.json", facts | results.results(record, setup, runs, trial))
    with replacing(out / "predictions.csv") as temporary:
        results.predictions(record, setup, runs, trial).to_csv(temporary, index=False)
    pictures.save(pictures.rollouts(record, setup, runs, trial), out / "rollouts.png")
    pictures.save(pictures.errors(record, setup, runs), out / "error.png")
    pictures.save(
        pictures.spectrum(record, found, setup.cutoff, setup.choice), out / "spectrum.png"
    )
    if any(of_method[0].components for of_method in runs.values()):
        pictures.save(pictures.components(record, setup, runs), out / "components.png")
    shutil.rmtree(out / CHECKPOINTS)
    showing.console.print(showing.comparison(_title(record, setup), record, setup, runs, trial))
    best = trial.recommended
    showing.console.print(
        f"recommended: {best}, for its forecast of the last {HELD_OUT:.0%} of the training part "
        f"(held out: RMSE {trial.errors[best]:.3g}) and for how little its forecast of what "
        f"follows changed once these were known ({trial.change(best):.3g}); a network has to be "
        f"{WORTH_TRAINING:.0%} better than what needs no training"
    )
    if record.ny > 1:
        showing.console.print(f"{best}: {showing.channels(record, setup, runs[best])}")
    showing.console.print(
        f"cut-off {setup.cutoff:g} Hz{_papers_cutoff(record, setup)}, order {setup.order}, the low "
        f"band kept at every {showing.ordinal(setup.downsampling)} sample: "
        + (setup.choice.reason if setup.choice else f"{found.share_below(setup.cutoff):.0%} below")
    )
    if setup.choice and setup.choice.simulator_helps is False and not set(methods) & set(HYBRIDS):
        showing.console.print("hybrid models are left out; --methods brings them back")
    showing.warn_of_inputs(beyond, given.names(context.params.get("inputs") or ""))
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
    if column is None or column.setup(record.sampling_rate).cutoff != setup.cutoff:
        return ""
    return f" (the paper's w = {column.cutoff:g} at f = {SAMPLE_FREQUENCY:g})"
