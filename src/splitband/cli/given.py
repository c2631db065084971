"""What the options of a command come to: records, known inputs, settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.cli import showing
from splitband.cli.options import AUTO
from splitband.data import Grid, Trajectory, aligned, read, resampled
from splitband.data.gaps import Gaps, places
from splitband.data.reading import ColumnError
from splitband.data.timing import same_sampling
from splitband.evaluation.defaults import default_setup
from splitband.forecasters.methods import Setup, check_train
from splitband.paper.settings import RECORD_SETTINGS
from splitband.paper.systems import RECORDS
from splitband.training import Settings, default_warmup
from splitband.training.recipes import Recipe, recipe_settings


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
    files: Sequence[str] | None,
    record: Trajectory,
    inputs: str | None,
    time_column: str | None,
    gaps: Gaps,
) -> list[Trajectory]:
    """The records of --more, with the columns of `record`."""
    found = []
    for file in files or []:
        if not Path(file).exists():
            raise FileNotFoundError(f"--more must be a file, got {file}")
        more = read_beside(
            file,
            record.sampling_time,
            time_column,
            columns=record.columns,
            inputs=names(inputs or ""),
            gaps=gaps,
        )
        if not differs(more.sampling_time, record.sampling_time):  # otherwise refused by `check`
            more = like(more, record.sampling_time, file)
        found.append(replace(more, name=file))
    return found


def inputs_ahead(
    file: Path | None, inputs: list[str], ahead: Grid, time_column: str | None = None
) -> npt.NDArray[np.float64] | None:
    """Known inputs at the times to come, `(steps, nu)`, where there are any.

    `time_column` is the record's.
    """
    if (file is not None) != bool(inputs):
        raise ValueError(
            f"--future-inputs must be given exactly where there are known inputs; there are "
            f"{', '.join(inputs) or 'none'}"
        )
    if file is None:
        return None
    found = read_beside(file, ahead.step, time_column, columns=inputs)
    # Straight lines, as inputs may jump.
    u = aligned(f"--future-inputs {file}", found.y, found.grid, ahead, smooth=False)
    if u.note:
        showing.console.print(f"{file}: {u.note}")
    return u.values


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
    settings = trained(recipe_settings(recipe, trajectory[:train]))
    defaults = default_setup(trajectory, train, recipe, settings, **decided, methods=methods)
    return replace(defaults, **given)
