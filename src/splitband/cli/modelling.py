"""`splitband fit` and `splitband simulate`."""

from __future__ import annotations

import math
import shutil
import warnings
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer

from splitband import reporting, saving
from splitband.calibration import Calibration
from splitband.checkpoints import Checkpoint
from splitband.cli import given, options, showing
from splitband.cli.simulating import (
    each_with_simulator,
    opened_simulator,
    simulated_again,
    with_simulator,
)
from splitband.comparison import RunProgress, first_start, last_start, predict
from splitband.data import Trajectory, read
from splitband.data.timing import as_json, from_json
from splitband.files import CHECKPOINTS, output_folder, replacing, write_json
from splitband.methods import (
    CALIBRATED,
    TRAINED,
    as_seen,
    build,
    check_method,
    prepared,
    with_variants,
)
from splitband.metrics import ExtrapolationWarning, leaves_range, rmse
from splitband.models import Hybrid, Model
from splitband.training import Progress
from splitband.training import fit as train_model


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
    write_json(out / "results.json", facts | outcome | {"environment": reporting.environment()})
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


def simulate(
    model_dir: Annotated[
        Path, typer.Argument(metavar="MODEL_DIR", help="What `fit` wrote.", show_default=False)
    ],
    history: Annotated[
        Path,
        typer.Option(
            metavar="FILE",
            help="Measured samples up to now, with the columns of the training record; the last "
            "ones warm the model up.",
            show_default=False,
        ),
    ],
    steps: Annotated[
        int, typer.Option(min=1, help="Samples to simulate after them.", show_default=False)
    ],
    out: Annotated[
        Path,
        typer.Option(metavar="FILE.csv", help="Where to write the samples.", show_default=False),
    ],
    future_inputs: options.FutureInputs = None,
    gaps: options.GapsOption = "refuse",
    time_column: options.TimeColumn = None,
    simulator: options.SimulatorOption = None,
    simulator_columns: options.SimulatorColumns = None,
    simulator_timeout: options.SimulatorTimeout = options.PATIENCE,
    simulator_cache: options.SimulatorCache = None,
) -> None:
    """Simulate a saved model beyond a measured history.

    A hybrid model also needs --simulator, which reaches --steps samples beyond the history. Where
    training record and history have time stamps, the model knows how much later the history
    begins: a function or an FMU is run from the beginning of the training record on, and a
    calibrated delay or clock counts from there. Otherwise the history is taken to begin where the
    training record did. An exported trajectory has to cover the warm-up and what follows, by its
    time stamps. The CSV has a column `time`, which goes on with the time stamps of the history
    (without any: seconds after its last sample), and one for each measured channel.
    """
    model, facts = saving.load(model_dir)
    known = _Facts(model_dir, model, facts)
    if out.is_dir():
        raise ValueError(f"--out must be a file, got the folder {out}")
    past = read(
        history,
        columns=known.columns,
        inputs=known.inputs,
        time_column=time_column,
        fallback_sampling_time=known.sampling_time,
        gaps=gaps,
    )
    if given.differs(past.sampling_time, known.sampling_time):
        raise ValueError(
            f"--history must be sampled like the training record, every {known.sampling_time:g} s, "
            f"got every {past.sampling_time:g} s in {history}"
        )
    past = given.like(past, known.sampling_time, str(history))
    if len(past) < known.warmup:
        raise ValueError(
            f"--history must have at least the {known.warmup} samples of the model's warm-up, "
            f"got {len(past)}"
        )
    start = last_start(past, known.warmup, len(past))
    y_sim = None
    if isinstance(model, Hybrid):
        if simulator is None:
            raise ValueError(
                f"--simulator must be given for a hybrid model, this is {known.method}"
            )
        opened = opened_simulator(
            simulator, past, simulator_columns, simulator_timeout, time_column
        )
        y_sim = simulated_again(
            opened, simulator, past, start - known.warmup, steps, known.start, known.calibration,
            simulator_timeout, simulator_cache,
        )  # fmt: skip
    ahead = past.grid.after(steps)
    u = given.inputs_ahead(future_inputs, known.inputs, ahead, time_column)
    if u is not None and past.u is not None:
        u = np.concatenate([past.u[start - known.warmup :], u])
    since = len(past) - start
    with warnings.catch_warnings():  # said below, by the inputs' names
        warnings.simplefilter("ignore", ExtrapolationWarning)
        y = model.simulate(past.y[start - known.warmup : start], since + steps, u, y_sim)[since:]
    table = pd.DataFrame(y, columns=known.columns)
    table.insert(0, reporting.time_header(known.columns), reporting.time_ahead(past, steps))
    output_folder(out.parent)
    with replacing(out) as temporary:
        table.to_csv(temporary, index=False)
    showing.console.print(f"{steps} samples after {history}: {out}")
    left = leaves_range(known.range, y)
    if left is not None:
        showing.console.print(showing.leaving(left))
    if u is not None:
        ahead_only = model.extrapolations(u[known.warmup + since :])
        showing.warn_of_inputs(ahead_only, known.inputs)


class _Facts:
    """What `fit` saved with the model and `simulate` needs."""

    def __init__(self, folder: Path, model: Model, facts: dict[str, Any]) -> None:
        try:
            self.method = str(facts["method"])
            self.columns = [str(name) for name in facts["columns"]]
            self.inputs = [str(name) for name in facts["inputs"]]
            self.sampling_time = float(facts["sampling_time"])
            self.warmup = int(facts["setup"]["settings"]["warmup"])
            # Models from before these were kept have no start, and leave no range.
            self.start = from_json(facts.get("start"))
            nothing = [[0.0] * model.ny] * 2
            self.range = np.array(facts.get("range", nothing), dtype=np.float64)
            self.calibration = Calibration(**(facts["calibration"] or {}))
            self.calibration.check(model.ny)
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{folder} was not written by `splitband fit`: {error!r}") from None
        if self.range.shape != (2, model.ny) or not np.isfinite(self.range).all():
            raise ValueError(f"{folder} is damaged: its range is {facts['range']}")
        if not 0 < self.sampling_time < math.inf:
            raise ValueError(f"{folder} is damaged: its sampling time is {self.sampling_time}")
        if self.warmup < 1:
            raise ValueError(f"{folder} is damaged: its warmup is {self.warmup}")
        if (len(self.columns), len(self.inputs)) != (model.ny, model.nu):
            raise ValueError(
                f"{folder} is damaged: its columns {self.columns} and inputs {self.inputs} are not "
                f"the model's {model.ny} and {model.nu}"
            )
