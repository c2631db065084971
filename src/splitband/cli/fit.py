"""`splitband fit` and `splitband simulate`."""

from __future__ import annotations

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from splitband.cli import given, options, showing
from splitband.cli.simulators import (
    each_with_simulator,
    with_simulator,
)
from splitband.data import Trajectory
from splitband.data.timing import as_json
from splitband.evaluation.comparison import RunProgress, first_start, predict
from splitband.forecasters.methods import (
    CALIBRATED,
    TRAINED,
    as_seen,
    build,
    check_method,
    prepared,
    with_variants,
)
from splitband.metrics import rmse
from splitband.models import Model, saving
from splitband.report import results
from splitband.runtime.files import CHECKPOINTS, output_folder, write_json
from splitband.training import Progress
from splitband.training import fit as train_model
from splitband.training.checkpoints import Checkpoint


def fit(
    record: options.Record,
    out: Annotated[
        Path, typer.Option(metavar="MODEL_DIR", help="Folder for the model.", show_default=False)
    ],
    method: Annotated[
        str, typer.Option(help=f"What to train: {', '.join(TRAINED)}.")
    ] = "split-gru",
    train: Annotated[
        int | None,
        typer.Option(help="Samples at the beginning to train on.", show_default="all"),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=2**32 - 1, help="Of initial weights and order of windows.")
    ] = 0,
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
    """Train one model on a record and save it.

    MODEL_DIR gets the weights (safetensors), everything else (JSON) and results.json.
    """
    if calibrate or conditioned:
        method = with_variants([method], calibrate, conditioned)[-1]
    if method not in TRAINED:
        raise ValueError(f"--method must be one of {', '.join(TRAINED)}, got {method}")
    trajectory = given.load_record(record, columns, inputs, time_column, sampling_time, gaps)
    trajectory = with_simulator(
        trajectory, simulator, simulator_columns, simulator_timeout, simulator_cache,
        beyond=CALIBRATED in method, time_column=time_column,
    )  # fmt: skip
    setup = given.setup(
        record,
        trajectory,
        len(trajectory) if train is None else train,
        ahead=0,
        recipe=recipe,
        methods=[method],
        cutoff=cutoff,
        order=order,
        downsampling=downsampling,
        warmup=warmup,
        window=window,
        epochs=epochs,
        learning_rate=learning_rate,
        milestones=lr_milestones,
        hidden=hidden,
    ).only_for(method)
    further = each_with_simulator(
        given.load_further(more, trajectory, inputs, time_column, gaps),
        [method],
        more_simulator,
        simulator_columns,
        simulator_timeout,
        simulator_cache,
        time_column,
    )
    check_method(method, trajectory[: setup.train], setup, further)
    training, calibration = prepared(method, trajectory[: setup.train], setup.train)
    records = [training, *(as_seen(other, calibration) for other in further)]
    model = build(method, training, setup, seed)
    output_folder(out)
    networks = len(model.tasks(model.normalised(training)))
    with showing.progress(networks, f"training {method}") as bar:

        def update(at: Progress) -> None:
            bar(RunProgress(at.task, seed, at.epoch / at.epochs, at.loss))

        (out / CHECKPOINTS).mkdir(exist_ok=True)
        checkpoint = Checkpoint(out / CHECKPOINTS / f"{method}-{seed}.safetensors")
        history = train_model(model, records, setup.settings, seed, update, checkpoint)
    within = _training_error(model, training, setup.settings.warmup)
    seen = np.concatenate([each.seen for each in records])
    facts = {
        "method": method,
        "seed": seed,
        "record": training.name,
        "more": [other.name for other in further],
        "range": [np.nanmin(seen, axis=0).tolist(), np.nanmax(seen, axis=0).tolist()],
        "sampling_time": training.sampling_time,
        "start": as_json(training.start),
        "columns": list(training.columns),
        "inputs": given.names(inputs or ""),
        "setup": asdict(setup),
        "calibration": None if calibration is None else asdict(calibration),
    }
    saving.save(model, out, facts)
    outcome = {
        "final_loss": {name: losses[-1] for name, losses in history.losses.items()},
        "seconds": history.seconds,
        "notes": history.notes,
        "training_rmse": within,
    }
    write_json(out / "results.json", facts | outcome | {"environment": results.environment()})
    shutil.rmtree(out / CHECKPOINTS)
    for note in history.notes:
        showing.console.print(note)
    showing.console.print(
        f"{method} trained on {len(training)} samples in {history.seconds:.1f} s; free run over "
        f"them from the first {setup.settings.warmup}: RMSE {within:.4g}\n"
        + ("" if calibration is None else f"simulator calibrated: {calibration}\n")
        + f"model: {out}/",
    )


def _training_error(model: Model, training: Trajectory, warmup: int) -> float:
    """RMSE of a free run over the training record from its first samples."""
    start = first_start(training, warmup)
    y = np.sum([*predict(model, training, start - warmup, start).values()], axis=0)
    return rmse(training.seen[start:], y)
