"""Options that several commands share, and what they default to."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from splitband.data.gaps import Gaps
from splitband.paper.systems import RECORDS, SIMULATORS
from splitband.training.recipes import Recipe

_RECORD, _SIMULATOR, _FILTER, _TRAINING = "Record", "Simulator", "Filter", "Training"


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
Tests = Annotated[
    list[str] | None,
    typer.Option(
        "--test",
        metavar="FILE",
        help="Another record of the same system, to be simulated to its end from its first "
        "samples (--warmup) by what is fitted to all of RECORD, or to --train samples; give it "
        "once for each.",
        rich_help_panel=_RECORD,
        show_default=False,
    ),
]
TestSimulators = Annotated[
    list[str] | None,
    typer.Option(
        "--test-simulator",
        metavar="FILE",
        help="The simulator of each --test, in their order; without, hybrid models are not tested.",
        rich_help_panel=_SIMULATOR,
        show_default=False,
    ),
]
FutureInputs = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Known inputs of the samples to come, where the record has any: by their time stamps; "
        "without any, from the first of these samples on.",
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
        ".fmu, FILE.py:FUNCTION (called with the record's time stamps in s; with seconds from 0 "
        "where these are dates, or missing), or one of "
        f"{', '.join(SIMULATORS)}. For compare and forecast also linear (of the known inputs), "
        "periodic or harmonic: what is fitted to the training samples takes its place.",
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
Seeds = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        min=1,
        help="Trainings of each network; the mean of their predictions is handed out.",
        rich_help_panel=_TRAINING,
        show_default="1 to 8, as the budget allows and the method deserves; without a search 3",
    ),
]
Budget = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="What the whole command may take on the cores it has, such as 90s, 10m or 1h: more of "
        "it means longer trials, larger ones and more seeds. Windows, sizes and steps of networks "
        "are found on held-out training samples, unless --window, --epochs, --learning-rate, "
        "--lr-milestones or --recipe paper decides how to train.",
        rich_help_panel=_TRAINING,
        show_default="about two minutes of two cores",
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
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        metavar="FILE",
        help="Method, sizes, training and bands that `splitband tune` has found (settings.json), "
        "in place of a search; other options come before what it says.",
        rich_help_panel=_TRAINING,
        show_default=False,
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
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="A Dask scheduler, such as tcp://10.0.0.5:8786, whose workers train in place of this "
        "machine; one training a core.",
        show_default=False,
    ),
]
Device = Annotated[
    str,
    typer.Option(
        help="Where networks are trained: cpu, cuda, cuda:1, ...", rich_help_panel=_TRAINING
    ),
]


@dataclass(frozen=True)
class RecordOptions:
    """How files are read."""

    columns: Columns = None
    inputs: Inputs = None
    time_column: TimeColumn = None
    sampling_time: SamplingTime = None
    gaps: GapsOption = "refuse"


@dataclass(frozen=True)
class SimulatorOptions:
    """Which simulator stands beside the record, and how it is run."""

    simulator: SimulatorOption = None
    simulator_columns: SimulatorColumns = None
    simulator_timeout: SimulatorTimeout = PATIENCE
    simulator_cache: SimulatorCache = None


@dataclass(frozen=True)
class FurtherRecords:
    """Other records of the same system, to train on."""

    more: More = None
    more_simulator: MoreSimulators = None


@dataclass(frozen=True)
class TestRecords:
    """Other records of the same system, to test on."""

    __test__ = False  # for pytest, it is no test

    test: Tests = None
    test_simulator: TestSimulators = None


@dataclass(frozen=True)
class ModelOptions:
    """Filters, networks and their training."""

    cutoff: Cutoff = None
    order: Order = None
    downsampling: Downsampling = None
    warmup: Warmup = None
    window: Window = None
    epochs: Epochs = None
    recipe: RecipeOption = "default"
    learning_rate: LearningRate = None
    lr_milestones: Milestones = None
    hidden: Hidden = None
    budget: Budget = None
    device: Device = "cpu"


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """A command for typer: each field of a parameter that is a dataclass is an option of its own.

    Options that several commands share are so written down once, in the order above.
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name not in groups:
            parameters.append(parameter.replace(annotation=hints[parameter.name]))
            continue
        of_group = get_type_hints(groups[parameter.name], include_extras=True)
        parameters += [
            parameter.replace(
                name=field.name, default=field.default, annotation=of_group[field.name]
            )
            for field in fields(groups[parameter.name])
        ]

    @wraps(command)
    def expanded(**given: Any) -> None:
        for name, group in groups.items():
            assert isinstance(group, type)
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    # What has a default comes last, as in any signature.
    parameters.sort(key=lambda p: p.default is not inspect.Parameter.empty)
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    expanded.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    expanded.__annotations__ = {p.name: p.annotation for p in parameters}
    return expanded
