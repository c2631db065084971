"""Define the options that several commands share: names, help and defaults stand here alone."""

from __future__ import annotations

import csv
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from splitband.records.named import RECORDS
from splitband.records.signals import Gaps
from splitband.records.stamps import TIME_NAMES
from splitband.runtime.arguments import LARGEST_SIZE, whole
from splitband.runtime.errors import InputError
from splitband.simulators.base import Hold
from splitband.simulators.named import SIMULATORS
from splitband.training.settings import Recipe


def panel(title: str | None) -> Callable[..., Any]:
    """Return a function that describes options in one panel of the help.

    It takes the help text, the name of the value, the default to show if it differs from the
    actual one, and further arguments of `typer.Option`.
    """

    def option(does: str, value: str | None = None, usual: str | bool = True, **more: Any) -> Any:
        shown: dict[str, Any] = {"metavar": value, "show_default": usual, "rich_help_panel": title}
        return typer.Option(help=does, **shown, **more)

    return option


def _fields(title: str) -> Callable[..., Any]:
    """Return a function that describes fields of a group, as `panel`, with their default."""
    described = panel(title)

    def option(*does: Any, default: Any = None, **more: Any) -> Any:
        return field(default=default, metadata={"option": described(*does, **more)})

    return option


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for typer in which each field of a dataclass parameter is an option.

    Thus options that several commands share are defined once. Groups may be nested.
    """
    # Parameters with a default come last, as in any signature.
    options = sorted(_options(command), key=lambda option: option.default is not option.empty)

    @wraps(command)
    def expanded(**given: Any) -> None:
        command(**_grouped(command, given))

    expanded.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in options}
    return expanded


def _options(owner: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    hints = get_type_hints(owner, include_extras=True)
    own = fields(owner) if is_dataclass(owner) else ()
    described = {each.name: each.metadata["option"] for each in own if each.metadata}
    for name, parameter in inspect.signature(owner).parameters.items():
        hint = hints[name]
        if is_dataclass(hint) and isinstance(hint, type):
            yield from _options(hint)
        else:
            hint = Annotated[hint, described[name]] if name in described else hint
            if get_origin(hint) is Annotated and get_args(hint)[0] is bool:  # without --no-...
                get_args(hint)[1].param_decls = (f"--{name.replace('_', '-')}",)
            yield parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY)


def _grouped(owner: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    hints = get_type_hints(owner)
    return {
        name: hints[name](**_grouped(hints[name], given))
        if is_dataclass(hints[name])
        else given[name]
        for name in inspect.signature(owner).parameters
    }


def names(text: str, blank: bool = False) -> list[str]:
    """Return the parts of a comma-separated option; one in double quotes may have commas.

    Empty parts are left out unless they may be `blank`.
    """
    line = " ".join(text.splitlines())
    parts = next(csv.reader([line], skipinitialspace=True))
    return [part.strip() for part in parts if blank or part.strip()]


def periods(given: list[str]) -> dict[str, float | None]:
    """Return the names of --unwrap and their periods, None where none is given."""
    parts = [each.partition("=") for each in given]
    try:
        return {name.strip(): float(period) if sign else None for name, sign, period in parts}
    except ValueError:
        raise InputError(f"--unwrap must be NAME or NAME=PERIOD, got {', '.join(given)}") from None


def joined(given: list[str]) -> dict[str, float | None]:
    """Return the files of --join and what to add to their stamps, None where nothing is given."""
    found = dict[str, float | None]()
    for each in given:
        file, _, offset = each.rpartition("@")
        try:
            found |= {file: float(offset)} if file else {each: None}
        except ValueError:
            found[each] = None  # a name with @
    return found


def seconds(duration: str, option: str = "--budget") -> float:
    """Return the length of a duration such as 90s, 10m or 1h; raises ValueError for other text."""
    number, unit = duration.strip()[:-1], duration.strip()[-1:].lower()
    try:
        length = float(number) * {"s": 1, "m": 60, "h": 3600}[unit]
    except (KeyError, ValueError):
        length = 0.0
    if not 0 < length < float("inf"):
        raise InputError(f"{option} must be a time such as 90s, 10m or 1h, got {duration}")
    return length


def hidden(text: str) -> tuple[int, int]:
    """Return the two sizes of --hidden, that of the low band first."""
    try:
        low, high = (whole("hidden", int(part), 1, LARGEST_SIZE) for part in names(text))
    except ValueError:
        raise InputError(
            f"--hidden must be LOW,HIGH, two whole numbers from 1 to {LARGEST_SIZE}, got {text}"
        ) from None
    return low, high


def _number_or(word: str, kind: type[float] | type[int], what: str) -> Callable[[str], Any]:
    """Return a parser of numbers that leaves one word as it is."""

    def parsed(value: str) -> float | str:
        try:
            return word if value == word else kind(value)
        except ValueError:
            raise typer.BadParameter(f"must be {what} or {word}") from None

    return parsed


_record, _simulator = _fields("Record"), _fields("Simulator")
_TIMES = ", ".join(TIME_NAMES)
_filter, _training = _fields("Filter"), _fields("Training")
_FILTER, _TRAINING, _TIME = panel("Filter"), panel("Training"), panel("Time")
plain = panel(None)
"""Describes an option in the first part of the help."""

RecordArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECORD",
        help="The measured record: a CSV, Parquet, NPZ, NPY, MAT or text file, or one of "
        f"{', '.join(RECORDS)}.",
        show_default=False,
    ),
]
ModelArgument = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL_DIR",
        help="Folder of a model that `fit`, `compare` or `forecast` saved.",
        show_default=False,
    ),
]
Train = Annotated[
    Any,  # int, "all" or None
    panel("Record")(
        "Train on the first N samples and predict the rest. With `all`, methods are compared by "
        "their held-out errors alone.",
        "N|all",
        "three quarters; with --test, all",
        parser=_number_or("all", int, "a whole number of samples"),
    ),
]
History = Annotated[
    Path | None,
    plain(
        "Measured samples up to now, with the columns of the training record.",
        "FILE",
        "the training record",
    ),
]
OtherRun = Annotated[
    bool,
    plain(
        "The history is from another run: its time stamps are not compared with those of the "
        "training record."
    ),
]
FutureInputs = Annotated[
    Path | None,
    panel("Record")(
        "Planned inputs of the samples to predict. They are found by their time stamps; if both "
        "files have none, the first row follows the last sample.",
        "FILE",
    ),
]
Cutoff = Annotated[
    float | None,
    _FILTER("Cut-off frequency between the two bands.", "HZ", "found from the record"),
]
Order = Annotated[
    int | None, _FILTER("Order of each Butterworth filter.", "N", "1 or 2, with the cut-off")
]
Epochs = Annotated[
    int | None, _TRAINING("Passes over all training windows.", "N", "about 1,000 steps")
]
Out = Annotated[Path, plain("Folder for the results and the page.", "DIR")]
Methods = Annotated[
    str | None,
    plain(
        "Methods to compare, separated by commas (`splitband methods` lists them).",
        "NAMES",
        "what suits the record",
    ),
]
_SEEDS = "Train each network (in a search: the best one) N times and predict the median."
Seeds = Annotated[int | None, _TRAINING(_SEEDS, "N", "1 to 8", min=1)]
Ahead = Annotated[
    int | None,
    plain(
        "Train and compare models for predictions N samples ahead, each from all measurements "
        "before it.",
        "N",
        "one long simulation",
        min=1,
    ),
]
Like = Annotated[
    Path | None,
    _TRAINING("Read the record and train with the settings of the model in DIR.", "DIR"),
]
Device = Annotated[str, _TRAINING("Device that trains networks: cpu, cuda, cuda:1, ...", "NAME")]
Budget = Annotated[
    str | None, _TIME("Time limit of the whole command: 90s, 10m, 1h.", "TIME", "2m")
]
Rounds = Annotated[
    int | None,
    _TIME(
        "Limit the search to N rounds instead of a time: every run gives the same result.",
        "N",
        min=1,
    ),
]
Seed = Annotated[int, _TIME("Seed of all random numbers.", "N", min=0)]
Jobs = Annotated[
    int | None, _TIME("Number of trainings that run in parallel.", "N", "all cores", min=1)
]
Cluster = Annotated[
    str | None, _TIME("Train on the workers of this Dask scheduler: tcp://...:8786.", "ADDRESS")
]
SkipDone = Annotated[
    bool,
    plain(
        "Do nothing if --out has a finished comparison already, whatever its record and options."
    ),
]


@dataclass(frozen=True)
class FileOptions:
    """Options on how files of samples are read."""

    time_column: str | None = _record(
        "Column of time stamps, in seconds or as dates. For two columns: DATE,TIME.",
        "NAME",
        _TIMES,
    )
    gaps: Gaps = _record(
        "Refuse missing values and rows, or mask them.", "refuse|mask", default="refuse"
    )
    missing: str | None = _record(
        "Words or numbers that stand for a missing value, such as Bad,-9999.", "WORDS"
    )
    step: Any = _record(  # float, "auto" or None
        "Interpolate samples at uneven times to this step, or average over it if it is longer. "
        "`auto` takes the usual step of the record.",
        "SECONDS|auto",
        "as measured",
        parser=_number_or("auto", float, "a number of seconds"),
    )
    hold: str | None = _record(
        "Inputs that hold their last value between samples and in gaps; others are interpolated.",
        "NAMES",
        "found from the record",
    )
    long: str | None = _record(
        "The file has one measurement in each row: name the columns of signal, time and value.",
        "TAG,TIME,VALUE",
    )
    skip_rows: int = _record(
        "Skip N lines at the top of a text file.", "N", False, default=0, min=0
    )
    header_row: int | None = _record(
        "Line of a text file that has the column names, counted from 1; 0 if there is none.",
        "N",
        "found",
        min=0,
    )


@dataclass(frozen=True)
class RecordOptions(FileOptions):
    """Options on how records are read, and what they hold."""

    columns: str | None = _record(
        "Measured outputs: columns by name, or by position from 0 if they have no names.",
        "NAMES",
        "all numeric",
    )
    inputs: str | None = _record("Known inputs, such as forces and set-points.", "NAMES")
    unwrap: list[str] | None = _record(
        "Unwrap an angle or a counter that jumps back by a period. May be repeated.",
        "NAME[=PERIOD]",
        "period found from the jumps",
    )
    clip_outliers: str | None = _record(
        "Clip outliers of these outputs: five robust standard deviations around the median.",
        "NAMES",
    )
    join: list[str] | None = _record(
        "Join another file of the same run by time stamps, to which SECONDS are added. May be "
        "repeated.",
        "FILE[@SECONDS]",
        "no offset, or the one found from a column that both files have",
    )
    runs: str | None = _record(
        "The file has several runs: name the column that numbers them, or the time column if it "
        "starts again with each run. The first run is the record; the others are added like "
        "--more.",
        "NAME",
    )
    detrend: bool = _record(
        "Subtract the means of outputs and inputs; results are then deviations from them.",
        default=False,
    )
    sampling_time: float | None = _record(
        "Time between samples, if the time column is missing or ambiguous.", "SECONDS"
    )


@dataclass(frozen=True)
class FurtherRecords:
    """Options that name other records of the same system, to train on."""

    more: list[str] | None = _record("Train on this record, too. May be repeated.", "FILE")
    more_simulator: list[str] | None = _simulator(
        "The simulator of each --more, in the same order.", "FILE"
    )


@dataclass(frozen=True)
class TestRecords:
    """Options that name other records of the same system, to test on."""

    __test__ = False  # for pytest: not a test class

    test: list[str] | None = _record("Test the models on this record. May be repeated.", "FILE")
    test_simulator: list[str] | None = _simulator(
        "The simulator of each --test, in the same order.", "FILE"
    )
    initial: int | None = _record(
        "Number of samples of a test record that are known before its simulation.",
        "N",
        "the warm-up",
        min=1,
    )


_SIMULATOR = (
    "A simulator of the plant: a file with its output, an .fmu, FILE.py:FUNCTION with a function "
    f"of the time in s or of (time, u), or one of {', '.join(SIMULATORS)}. The record's inputs "
    "drive it."
)
_OR_BASE = f"{_SIMULATOR} Or a fitted model that replaces it: linear, periodic or harmonic."


@dataclass(frozen=True)
class SimulatorOptions:
    """Options that name the simulator of the record, and say how it is run."""

    simulator: str | None = _simulator(_SIMULATOR, "FILE|NAME", "a named record's own")
    simulator_columns: str | None = _simulator(
        "The simulator's outputs that match --columns.", "NAMES", "those of the same names"
    )
    simulator_inputs: str | None = _simulator(
        "Variables of an FMU that take --inputs, in that order. Leave a place empty for an input "
        'that the FMU does not have (a,,c). Other variables keep their start values; with "" all '
        "do.",
        "NAMES",
        "those of the same names",
    )
    simulator_start: str | None = _simulator(
        "The simulator's time at the record's first sample; `record` takes the time stamp.",
        "SECONDS|record",
        "0",
    )
    simulator_step: float | None = _simulator(
        "Communication step of a co-simulation FMU; it must divide the sampling time.",
        "SECONDS",
        "what the FMU declares",
    )
    simulator_hold: Hold | None = _simulator(
        "Between samples, inputs of an equation or of an FMU for model exchange are held "
        "(zero-order hold, as by a D/A converter) or interpolated.",
        "zoh|linear",
        "linear",
    )
    simulator_timeout: float = _simulator(
        "Stop a simulator that takes longer than this.", "SECONDS", default=600.0, min=0.0
    )
    parameters: str | None = _simulator(
        "Parameters of the simulator: a range is fitted, a number is set. The simulator is an FMU, "
        "FILE.py:RHS with a right-hand side (t, x, u, p), FILE.py:FUNCTION with a function of "
        "(time, u, p), or FILE.py:NAME with an sb.Ode. A right-hand side starts at the states "
        "x0_1, x0_2, ..., and its first states are the measured ones.",
        "k=0.1:10,c=0.05",
    )
    unknown: list[str] | None = _simulator(
        "Learn an unknown term of the equation as a function of these states (x1, x2, ...) and "
        "inputs. FILE.py:RHS is then a function of (t, x, u, p, w), and w is the term. May be "
        "repeated.",
        "NAMES",
    )
    unknown_odd: bool = _simulator(
        "Unknown terms are odd functions, as friction is.", default=False
    )


@dataclass(frozen=True)
class SimulatorOrBaseOptions(SimulatorOptions):
    """Options that name a simulator, or a model that is fitted in its place."""

    simulator: str | None = _simulator(_OR_BASE, "FILE|NAME", "a named record's own")


@dataclass(frozen=True)
class ModelOptions:
    """The options of filters, networks and their training."""

    cutoff: Cutoff = None
    order: Order = None
    downsampling: int | None = _filter(
        "Keep every K-th sample of the low band.", "K", "as the low band allows"
    )
    warmup: int | None = _training(
        "Measured samples from which a simulation starts.", "R", "up to 50"
    )
    window: int | None = _training(
        "Samples in a training window, including the warm-up.", "N", "150 to 400"
    )
    own_warmup: Literal["yes", "no"] = _training(
        "Filter the warm-up of each window of split models alone; no: cut windows from the "
        "filtered record (paper, Eq. 10, training).",
        default="yes",
    )
    epochs: Epochs = None
    recipe: Recipe = _training(
        "Training settings not set by other options.", "default|constant-rate", default="default"
    )
    learning_rate: float | None = _training("Largest learning rate of Adam.", "RATE", "1e-2")
    hidden: str | None = _training(
        "Hidden units of the networks for the low and the high band; a single GRU has their sum.",
        "LOW,HIGH",
        "16,32",
    )
    budget: Budget = None
    rounds: Rounds = None
    seed: Seed = 0
    device: Device = "cpu"
