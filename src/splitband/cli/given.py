"""What the options of a command come to: records, known inputs, settings."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, fields, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from splitband.cli import showing
from splitband.cli.options.models import AUTO, ModelOptions
from splitband.cli.options.records import RecordOptions
from splitband.data import Trajectory, aligned, read, resampled
from splitband.data.gaps import places
from splitband.data.reading import ColumnError
from splitband.data.timing import same_sampling
from splitband.evaluation.comparison import check_train
from splitband.evaluation.costs import reference_seconds
from splitband.evaluation.search import Search
from splitband.evaluation.setup import Setup, default_setup
from splitband.evaluation.tuned import Tuned
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import NAMES, Sizes
from splitband.forecasters.network import Network
from splitband.forecasters.simulation import Simulation
from splitband.models import Model
from splitband.paper.settings import RECORD_SETTINGS
from splitband.paper.systems import RECORDS
from splitband.simulators.calibration import Calibration
from splitband.training import Settings, default_warmup
from splitband.training.recipes import recipe_settings

AnyForecaster = TypeVar("AnyForecaster", bound=Forecaster)


def names(text: str) -> list[str]:
    """The parts of a comma-separated option."""
    return [part.strip() for part in text.split(",") if part.strip()]


def method_names(text: str) -> list[str]:
    """The names of an option that lists methods; raises ValueError for unknown ones."""
    asked = names(text)
    check_names("--methods", asked, NAMES)
    return asked


def check_names(option: str, asked: Sequence[str], possible: Iterable[str]) -> None:
    """Raise ValueError, with what may have been meant, unless all that is asked for is possible."""
    possible = [*possible]
    unknown = [name for name in asked if name not in possible]
    if not unknown and asked:
        return
    meant = [close for name in unknown for close in get_close_matches(name, possible, 1)]
    raise ValueError(
        f"{option} must be among those that `splitband methods` lists, "
        f"got {', '.join(unknown) or 'none'}"
        + (f"; {', '.join(meant)} is there" if meant else "")
        + ("" if len(possible) == len(NAMES) else f" (here {', '.join(possible)})")
    )


def check_needs(methods: Sequence[Forecaster], record: Trajectory) -> None:
    """Raise ValueError, which names the option, where a record lacks what a method needs."""
    for what, need, given in (
        ("a simulator", "simulator", record.y_sim),
        ("known inputs", "inputs", record.u),
    ):
        lacking = next((m for m in methods if need in m.needs and given is None), None)
        if lacking is not None:
            raise ValueError(f"{lacking.name} needs {what} (--{need}), {record.name} has none")


def on_device(forecaster: AnyForecaster, device: str) -> AnyForecaster:
    """A forecaster whose network, if it has one, is trained on a device."""
    if isinstance(forecaster, Network) and device != "cpu":
        _check_device(device)
        return forecaster.to(device)
    return forecaster


def model_on_device(model: Model, device: str) -> Model:
    """A model that is to be simulated on a device."""
    if device != "cpu":
        _check_device(device)
    return model.to(device)


def _check_device(device: str) -> None:
    import torch  # noqa: PLC0415  it has been loaded by now

    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"--device must be one that is there, got {device}: {reason}") from None


def calibration_of(forecaster: Forecaster) -> Calibration | None:
    """The calibration of a hybrid model's simulator, where it has been calibrated."""
    base = getattr(forecaster, "base", None)
    calibrated = isinstance(base, Simulation) and base.calibrated is not False
    return base.calibration if isinstance(base, Simulation) and calibrated else None


def calibration_facts(forecaster: Forecaster) -> dict[str, Any] | None:
    """The same for a JSON file."""
    calibration = calibration_of(forecaster)
    return None if calibration is None else asdict(calibration)


def _milestones(text: str) -> tuple[tuple[int, float], ...]:
    try:
        pairs = [part.split(":") for part in names(text)]
        return tuple((int(epoch), float(rate)) for epoch, rate in pairs)
    except ValueError:
        raise ValueError(f"--lr-milestones must be EPOCH:RATE,EPOCH:RATE,..., got {text}") from None


def _hidden(text: str) -> tuple[int, int]:
    try:
        high, low = (int(part) for part in names(text))
    except ValueError:
        raise ValueError(f"--hidden must be HIGH,LOW, two whole numbers, got {text}") from None
    return high, low


def load_record(record: str, reading: RecordOptions | None = None) -> Trajectory:
    """A named record, or a file."""
    reading = reading or RecordOptions()
    if record not in RECORDS:
        if not Path(record).exists():
            raise FileNotFoundError(
                f"RECORD must be a file or one of {', '.join(RECORDS)}, got {record}"
            )
        trajectory = read(
            record,
            columns=names(reading.columns) if reading.columns else None,
            inputs=names(reading.inputs or ""),
            time_column=reading.time_column,
            sampling_time=reading.sampling_time,
            gaps=reading.gaps,
        )
        if trajectory.measured is not None:
            missing = ~trajectory.complete
            showing.console.print(
                f"{record}: {missing.sum()} of {len(missing)} samples were not measured in whole, "
                f"and are masked: {places(missing)}"
            )
        return trajectory
    for option, value in (
        ("--columns", reading.columns),
        ("--inputs", reading.inputs),
        ("--time-column", reading.time_column),
        ("--sampling-time", reading.sampling_time),
    ):
        if value is not None:
            raise ValueError(f"{option} is for files; {record} is a named record, got {value}")
    return RECORDS[record]()


def read_beside(
    path: str | Path, sampling_time: float, time_column: str | None, **others: Any
) -> Trajectory:
    """Read a file that is put beside a record of that sampling time.

    Its time column is the record's, or one with a usual name where it has no such column.
    """
    others["fallback_sampling_time"] = sampling_time
    try:
        return read(path, time_column=time_column, **others)
    except ColumnError:
        if not time_column:
            raise
        return read(path, **others)


def like(record: Trajectory, sampling_time: float, what: str) -> Trajectory:
    """The record at a sampling time from which its own differs by 1 % at most.

    It is left as it is where both end within half a sample.
    """
    if same_sampling(record.sampling_time, sampling_time, len(record)):
        return record
    showing.console.print(
        f"{what}: sampled every {record.sampling_time:.7g} s, interpolated to every "
        f"{sampling_time:.7g} s"
    )
    return resampled(record, sampling_time)


def differs(sampling_time: float, other: float) -> bool:
    """Whether two sampling times are too different for records of the same model."""
    return abs(sampling_time - other) > 0.01 * other


def load_further(
    files: Sequence[str] | None, option: str, record: Trajectory, reading: RecordOptions
) -> list[Trajectory]:
    """The records of --more or --test, with the columns of `record`."""
    records = []
    for file in files or []:
        if not Path(file).exists():
            raise FileNotFoundError(f"{option} must be a file, got {file}")
        more = read_beside(
            file,
            record.sampling_time,
            reading.time_column,
            columns=record.columns,
            inputs=names(reading.inputs or ""),
            gaps=reading.gaps,
        )
        if not differs(more.sampling_time, record.sampling_time):  # otherwise refused by `check`
            more = like(more, record.sampling_time, file)
        records.append(replace(more, name=file if option == "--more" else Path(file).stem))
    return records


def inputs_ahead(
    file: Path | None, known: Trajectory, steps: int, reading: RecordOptions
) -> npt.NDArray[np.float64] | None:
    """Known inputs of the samples after a record, `(steps, nu)`, where there are any."""
    inputs = names(reading.inputs or "")
    if (file is not None) != bool(inputs):
        raise ValueError(
            f"--future-inputs must be given exactly where there are known inputs; there are "
            f"{', '.join(inputs) or 'none'}"
        )
    if file is None:
        return None
    ahead = known.grid.after(steps)
    coming = read_beside(file, ahead.step, reading.time_column, columns=inputs)
    # Straight lines, as inputs may jump.
    u = aligned(f"--future-inputs {file}", coming.y, coming.grid, ahead, smooth=False)
    if u.note:
        showing.console.print(f"{file}: {u.note}")
    return u.values


def setup(
    record: str,
    trajectory: Trajectory,
    train: int | None,
    options: ModelOptions,
    methods: Sequence[str] | None = None,
    ahead: int = 1,
    tested: bool = False,
    cores: int = 1,
    tuned: Tuned | None = None,
) -> Setup:
    """What the options say (`None`: nothing), the rest as `tuned`, or else by the recipe.

    The paper's recipe for its own records is the settings of its tables. `record` is the argument
    that `trajectory` comes from, `methods` what the setup is for; `ahead` samples at least must be
    left to predict. What is `tested` on other records is trained on all of this one by default.
    `cores` are what a budget is spent on.
    """
    column = RECORD_SETTINGS.get(record)
    if train is None:
        train = column.train if column else int(0.75 * len(trajectory))
        train = len(trajectory) if tested else train
    check_train(trajectory, train, ahead)
    bands = Bands(
        None if options.cutoff == AUTO else options.cutoff, options.order, options.downsampling
    )
    if tuned is not None:
        return _as_tuned(tuned, trajectory, train, options, bands, methods)
    if column is None or options.recipe != "paper":
        settings = _trained(recipe_settings(options.recipe, trajectory[:train]), options)
        by_recipe = default_setup(trajectory, train, options.recipe, settings, bands, methods)
        sizes = _with_hidden(by_recipe.sizes, options)
        return replace(by_recipe, sizes=sizes, search=_search(options, cores))
    papers = column.setup(trajectory.sampling_rate)
    settings = _trained(papers.settings, options)
    if options.cutoff == AUTO:
        bands = default_setup(trajectory, train, "paper", settings, bands, methods).bands
    else:
        given = {name: value for name, value in vars(bands).items() if value is not None}
        bands = replace(papers.bands, **given)
    return Setup(
        train,
        settings,
        bands,
        _with_hidden(papers.sizes, options),
        {name: _trained(other, options) for name, other in papers.overrides.items()},
    )


def load_settings(path: Path | None, options: ModelOptions) -> Tuned | None:
    """What --settings names; raises ValueError for options that it leaves nothing to."""
    if path is None:
        return None
    if not path.is_file():
        raise FileNotFoundError(f"--settings must be a file that `tune` wrote, got {path}")
    if options.budget is not None:
        raise ValueError(
            f"--budget is for finding out how to train, which --settings decides, got "
            f"{options.budget}"
        )
    if options.recipe != "default":
        raise ValueError(f"--recipe and --settings exclude each other, got {options.recipe}")
    return Tuned.read(path)


def _as_tuned(
    tuned: Tuned,
    trajectory: Trajectory,
    train: int,
    options: ModelOptions,
    bands: Bands,
    methods: Sequence[str] | None,
    ahead: int | None = None,
) -> Setup:
    """What the options say, the rest as it has been found before."""
    said = {name: value for name, value in vars(bands).items() if value is not None}
    # What was found for one cut-off is not for another one.
    bands = bands if options.cutoff is not None else replace(tuned.bands, **said)
    settings = _trained(tuned.settings, options)
    chosen = default_setup(trajectory, train, "default", settings, bands, methods, ahead)
    return replace(chosen, sizes=_with_hidden(tuned.sizes, options))


def setup_ahead(
    known: Trajectory,
    steps: int,
    methods: Sequence[str],
    options: ModelOptions,
    cores: int,
    tuned: Tuned | None = None,
) -> Setup:
    """For a forecast of `steps` samples beyond the end of a record."""
    if tuned is not None:
        return _as_tuned(tuned, known, len(known), options, Bands(), methods, steps)
    settings = _trained(recipe_settings("default", known), options)
    chosen = default_setup(known, len(known), "default", settings, None, methods, steps)
    return replace(chosen, search=_search(options, cores))


def _search(options: ModelOptions, cores: int) -> Search | None:
    """How much goes into finding out how to train; None where the options say how."""
    said = {
        "--window": options.window,
        "--epochs": options.epochs,
        "--learning-rate": options.learning_rate,
        "--lr-milestones": options.lr_milestones,
        "--recipe": None if options.recipe == "default" else options.recipe,
    }
    decided = [option for option, value in said.items() if value is not None]
    if decided:
        if options.budget is not None:
            raise ValueError(
                f"--budget is for finding out how to train, which {decided[0]} decides, got "
                f"{options.budget}"
            )
        return None
    search = Search(sizes=options.hidden is None)
    if options.budget is None:
        return search
    return replace(search, core_seconds=reference_seconds(seconds(options.budget), cores))


def check_model_options(options: ModelOptions) -> None:
    """Raise ValueError for what would be wrong with any record."""
    _search(options, 1)
    _with_hidden(Sizes(), options)
    if options.lr_milestones is not None:
        _milestones(options.lr_milestones)
    if options.device != "cpu":
        _check_device(options.device)


def seconds(duration: str) -> float:
    """Of a duration such as 90s, 10m or 1h; raises ValueError for another text."""
    number, unit = duration.strip()[:-1], duration.strip()[-1:].lower()
    try:
        length = float(number) * {"s": 1, "m": 60, "h": 3600}[unit]
    except (KeyError, ValueError):
        length = 0.0
    if not 0 < length < float("inf"):
        raise ValueError(f"--budget must be a time such as 90s, 10m or 1h, got {duration}")
    return length


def _trained(settings: Settings, options: ModelOptions) -> Settings:
    """Settings with what the options say about training."""
    said: dict[str, Any] = {
        field.name: getattr(options, field.name)
        for field in fields(Settings)
        if getattr(options, field.name, None) is not None
    }
    if "window" in said:
        said.setdefault("warmup", default_warmup(said["window"], settings.warmup))
    if options.lr_milestones is not None:
        said |= {"milestones": _milestones(options.lr_milestones), "one_cycle": False}
    return replace(settings, **said)


def _with_hidden(sizes: Sizes, options: ModelOptions) -> Sizes:
    if options.hidden is None:
        return sizes
    high, low = _hidden(options.hidden)
    return replace(sizes, hidden_high=high, hidden_low=low)
