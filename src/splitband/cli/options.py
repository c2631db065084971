"""Options that several commands share, and what they default to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer

from splitband.cli import showing
from splitband.data import Trajectory, read
from splitband.data.gaps import Gaps, places
from splitband.methods import Recipe, Setup, check_train, default_setup, recipe_settings
from splitband.paper.settings import RECORD_SETTINGS
from splitband.systems import RECORDS, SIMULATORS
from splitband.training import Settings, default_warmup

_RECORD, _SIMULATOR, _FILTER, _TRAINING = "Record", "Simulator", "Filter", "Training"


def names(text: str) -> list[str]:
    """The parts of a comma-separated option."""
    return [part.strip() for part in text.split(",") if part.strip()]


def _milestones(text: str) -> tuple[tuple[int, float], ...]:
    try:
        pairs = [part.split(":") for part in names(text)]
        return tuple((int(epoch), float(rate)) for epoch, rate in pairs)
    except ValueError:
        raise ValueError(f"--lr-milestones must be EPOCH:RATE,EPOCH:RATE,..., got {text}") from None


def _sizes(text: str) -> tuple[int, int]:
    try:
        high, low = (int(part) for part in names(text))
    except ValueError:
        raise ValueError(f"--hidden must be HIGH,LOW, two whole numbers, got {text}") from None
    return high, low


Record = Annotated[
    str,
    typer.Argument(
        metavar="RECORD",
        help="A file (CSV, TSV, Parquet, NPZ, NPY, MAT or plain text) or a named record: "
        f"{', '.join(RECORDS)}.",
        show_default=False,
    ),
]
Train = Annotated[
    int | None,
    typer.Option(
        "--train",
        help="Samples at the beginning to train on.",
        rich_help_panel=_RECORD,
        show_default="three quarters of a file, the paper's number for a named record",
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        help="Measured columns, by name or position, separated by commas.",
        rich_help_panel=_RECORD,
        show_default="all numeric",
    ),
]
Inputs = Annotated[
    str | None,
    typer.Option(
        help="Columns of known inputs (forces, set-points), separated by commas.",
        rich_help_panel=_RECORD,
        show_default=False,
    ),
]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        help="Column of time stamps, in seconds or as dates.",
        rich_help_panel=_RECORD,
        show_default="one called time or t",
    ),
]
SamplingTime = Annotated[
    float | None,
    typer.Option(
        help="Seconds between samples, where the file has no time column.",
        rich_help_panel=_RECORD,
        show_default=False,
    ),
]
GapsOption = Annotated[
    Gaps,
    typer.Option(
        "--gaps",
        help="A missing or infinite value, or a row that is missing between two time stamps: "
        "refuse the file, or mask it. What is masked counts in no error, and no simulation warms "
        "up on it.",
        rich_help_panel=_RECORD,
    ),
]
More = Annotated[
    list[str] | None,
    typer.Option(
        "--more",
        metavar="FILE",
        help="Another record of the same system, all of it to train on; give it once for each.",
        rich_help_panel=_RECORD,
        show_default=False,
    ),
]
MoreSimulators = Annotated[
    list[str] | None,
    typer.Option(
        "--more-simulator",
        metavar="FILE",
        help="The simulator of each --more, in their order.",
        rich_help_panel=_SIMULATOR,
        show_default=False,
    ),
]
FutureInputs = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Known inputs of the samples to come, where the record has any.",
        rich_help_panel=_RECORD,
        show_default=False,
    ),
]
SimulatorOption = Annotated[
    str | None,
    typer.Option(
        "--simulator",
        metavar="FILE|NAME",
        help="A simulator of the record: an exported trajectory (any file a record can be), an "
        ".fmu, FILE.py:FUNCTION (called with the times in s), or one of "
        f"{', '.join(SIMULATORS)}.",
        rich_help_panel=_SIMULATOR,
        show_default="a named record's own",
    ),
]
SimulatorColumns = Annotated[
    str | None,
    typer.Option(
        help="Columns of the trajectory, or outputs of the FMU, that correspond to --columns.",
        rich_help_panel=_SIMULATOR,
        show_default="those of the record's names, or all",
    ),
]
SimulatorTimeout = Annotated[
    float,
    typer.Option(
        min=0.0, help="Seconds after which a simulator is given up on.", rich_help_panel=_SIMULATOR
    ),
]
PATIENCE = 600.0
"""Of a simulator, in s."""
SimulatorCache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Keep what a slow FMU or function computes in this folder, by its content.",
        rich_help_panel=_SIMULATOR,
        show_default="not kept",
    ),
]
Calibrate = Annotated[
    bool,
    typer.Option(
        "--calibrate",
        help="Calibrate the simulator of hybrid methods on the training samples first: gain, "
        "offset, delay and clock, each kept only where it pays on held-out ones.",
        rich_help_panel=_SIMULATOR,
    ),
]
Conditioned = Annotated[
    bool,
    typer.Option(
        "--conditioned",
        help="Tell the network what the slower band or the simulator predicts.",
        rich_help_panel=_FILTER,
    ),
]


AUTO = -math.inf
"""A cut-off that is to be chosen, in place of the paper's for one of its records."""


def _hertz(value: str) -> float:
    """A cut-off, or `AUTO`."""
    if value == "auto":
        return AUTO
    try:
        hertz = float(value)
    except ValueError:
        hertz = math.nan
    if not math.isfinite(hertz):
        raise typer.BadParameter("must be a frequency in Hz or auto")
    return hertz


Cutoff = Annotated[
    float | None,
    typer.Option(
        parser=_hertz,
        metavar="HZ|auto",
        help="Frequency that parts the two bands. auto: by the training samples, from the spectrum "
        "or from where simulator and record agree.",
        rich_help_panel=_FILTER,
        show_default="auto",
    ),
]
Order = Annotated[
    int | None,
    typer.Option(
        help="Order of each Butterworth filter.",
        rich_help_panel=_FILTER,
        show_default="1 or 2, with the cut-off",
    ),
]
Downsampling = Annotated[
    int | None,
    typer.Option(
        help="The low band keeps every K-th sample.",
        metavar="K",
        rich_help_panel=_FILTER,
        show_default="as large as the low band allows, up to 10",
    ),
]
Warmup = Annotated[
    int | None,
    typer.Option(
        help="Measured samples before a simulation.",
        metavar="R",
        rich_help_panel=_TRAINING,
        show_default="up to 50",
    ),
]
Window = Annotated[
    int | None,
    typer.Option(
        help="Samples of a training window, warm-up included.",
        rich_help_panel=_TRAINING,
        show_default="two fifths of the training part, 150 to 400",
    ),
]
Epochs = Annotated[
    int | None,
    typer.Option(
        help="Passes over all windows.",
        rich_help_panel=_TRAINING,
        show_default="what makes about 1,000 steps",
    ),
]
RecipeOption = Annotated[
    Recipe,
    typer.Option(
        "--recipe",
        help="How networks are trained where no other option says so: long windows, one cycle of "
        "the learning rate and free runs that grow, or as in the paper.",
        rich_help_panel=_TRAINING,
    ),
]
LearningRate = Annotated[
    float | None,
    typer.Option(
        help="Of Adam: the highest, or the first one with --recipe paper.",
        rich_help_panel=_TRAINING,
        show_default="1e-2; with --recipe paper 1e-3",
    ),
]
Milestones = Annotated[
    str | None,
    typer.Option(
        "--lr-milestones",
        help="Later learning rates as EPOCH:RATE,...: 20:1e-4,500:1e-5. In place of one cycle.",
        rich_help_panel=_TRAINING,
        show_default=False,
    ),
]
Hidden = Annotated[
    str | None,
    typer.Option(
        help="Hidden units of the high- and the low-band network.",
        metavar="HIGH,LOW",
        rich_help_panel=_TRAINING,
        show_default="32,16, with --recipe paper 64,32; a single network has their sum",
    ),
]

Jobs = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Trainings at once, each a process on one core; the numbers do not depend on it "
        "but for rounding.",
        show_default="one a core",
    ),
]


def load_record(
    record: str,
    columns: str | None = None,
    inputs: str | None = None,
    time_column: str | None = None,
    sampling_time: float | None = None,
    gaps: Gaps = "refuse",
) -> Trajectory:
    """A named record, or a file."""
    if record not in RECORDS:
        if not Path(record).exists():
            raise FileNotFoundError(
                f"RECORD must be a file or one of {', '.join(RECORDS)}, got {record}"
            )
        found = read(
            record,
            columns=names(columns) if columns else None,
            inputs=names(inputs or ""),
            time_column=time_column,
            sampling_time=sampling_time,
            gaps=gaps,
        )
        if found.measured is not None:
            missing = ~found.complete
            showing.console.print(
                f"{record}: {missing.sum()} of {len(found)} samples were not measured in whole, "
                f"and are masked: {places(missing)}"
            )
        return found
    for option, value in (
        ("--columns", columns),
        ("--inputs", inputs),
        ("--time-column", time_column),
        ("--sampling-time", sampling_time),
    ):
        if value is not None:
            raise ValueError(f"{option} is for files; {record} is a named record, got {value}")
    return RECORDS[record]()


def load_further(
    files: Sequence[str] | None,
    record: Trajectory,
    inputs: str | None,
    time_column: str | None,
    gaps: Gaps,
) -> list[Trajectory]:
    """The records of --more, read as `record` was."""
    found = []
    for file in files or []:
        if not Path(file).exists():
            raise FileNotFoundError(f"--more must be a file, got {file}")
        unnamed = record.columns[0] in ("y", "y0")
        more = read(
            file,
            columns=None if unnamed else record.columns,
            inputs=names(inputs or ""),
            time_column=time_column,
            fallback_sampling_time=record.sampling_time,
            gaps=gaps,
        )
        found.append(replace(more, name=file))
    return found


def inputs_ahead(
    file: Path | None, inputs: list[str], steps: int, sampling_time: float
) -> npt.NDArray[np.float64] | None:
    """Known inputs of the `steps` samples to come, `(steps, nu)`, where there are any."""
    if (file is not None) != bool(inputs):
        raise ValueError(
            f"--future-inputs must be given exactly where there are known inputs; there are "
            f"{', '.join(inputs) or 'none'}"
        )
    if file is None:
        return None
    found = read(file, columns=inputs, fallback_sampling_time=sampling_time).y
    if len(found) < steps:
        raise ValueError(
            f"--future-inputs must cover the {steps} samples of --steps, got {len(found)}"
        )
    return found[:steps]


def setup(
    record: str,
    trajectory: Trajectory,
    train: int | None,
    ahead: int = 1,
    recipe: Recipe = "default",
    methods: Sequence[str] | None = None,
    **options: Any,
) -> Setup:
    """What the options say (`None`: nothing), the rest by the recipe.

    The paper's recipe for its own records is the settings of its tables. `record` is the argument
    that `trajectory` comes from, `methods` what the setup is for; `ahead` samples at least must be
    left to predict.
    """
    column = RECORD_SETTINGS.get(record)
    if train is None:
        train = column.train if column else int(0.75 * len(trajectory))
    check_train(trajectory, train, ahead)
    given = {name: value for name, value in options.items() if value is not None}
    decided = {name: given.pop(name, None) for name in ("cutoff", "order", "downsampling")}
    papers = column is not None and recipe == "paper" and decided["cutoff"] != AUTO
    if decided["cutoff"] == AUTO:
        decided["cutoff"] = None
    if "hidden" in given:
        given["hidden_high"], given["hidden_low"] = _sizes(given.pop("hidden"))
    if "milestones" in given:
        given["milestones"] = _milestones(given["milestones"])
        given["one_cycle"] = False
    training = {f.name: given.pop(f.name) for f in fields(Settings) if f.name in given}

    def trained(settings: Settings) -> Settings:
        more = dict(training)
        if "window" in more:
            more.setdefault("warmup", default_warmup(more["window"], settings.warmup))
        return replace(settings, **more)

    if column and recipe == "paper":
        defaults = column.setup(trajectory.sampling_rate)
        settings = trained(defaults.settings)
        overrides = {name: trained(s) for name, s in defaults.overrides.items()}
        defaults = replace(defaults, train=train, settings=settings, overrides=overrides)
        if papers:
            given |= {name: value for name, value in decided.items() if value is not None}
            return replace(defaults, **given)
        found = default_setup(trajectory, train, recipe, settings, **decided, methods=methods)
        chosen = {name: getattr(found, name) for name in (*decided, "choice")}
        return replace(defaults, **chosen, **given)
    settings = trained(recipe_settings(recipe, train))
    defaults = default_setup(trajectory, train, recipe, settings, **decided, methods=methods)
    return replace(defaults, **given)
