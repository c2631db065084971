"""Read records from tables: choose the columns, find the time stamps, check every cell."""

from __future__ import annotations

import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias, get_args, overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import is_numeric_dtype

from splitband.records.preparation import (
    Limits,
    Periods,
    Reading,
    going_on,
    limits_of,
    of_channels,
    periods_of,
)
from splitband.records.rates import (
    NEAR,
    Even,
    is_smooth,
    is_sparse,
    jitter,
    last_of_each,
    offset_of,
    own_step,
    regular,
)
from splitband.records.record import Record
from splitband.records.remedies import Table, check_other_clock
from splitband.records.signals import (
    Column,
    Gaps,
    ReadingWarning,
    has_number,
    is_text,
    numbers,
    positive_seconds,
    require_finite,
    switch_states,
    unit_of,
)
from splitband.records.stamps import (
    TIME_NAMES,
    also_time,
    is_clock_number,
    is_day,
    is_time,
    is_time_of_day,
    joined,
    readings,
    time_name,
)
from splitband.records.tables import check_size, known, load, of_frame
from splitband.records.text import Layout
from splitband.records.timing import (
    Spacing,
    Times,
    same_sampling,
    seconds_between,
    spacing,
    times_of,
    whole_multiple,
)
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

_NAMELESS = "y"
"""Name of the channel of a file with a single column and no header."""
_EXPECTED = "expected"
"""Reason for leaving out row numbers, scalars and empty columns; these are not reported."""
JOINED = "time [s]"
"""Name of the time column of joined files."""
_ROW_NUMBERS = "record index row sample scan number seq # no no. nr nr."
"""Names of columns that number the rows, in small letters."""
_Names: TypeAlias = str | int | Sequence[str | int]
Source: TypeAlias = "str | os.PathLike[str] | pd.DataFrame | pd.Series[Any]"
Joined: TypeAlias = Mapping[Any, float | None] | Sequence[str | os.PathLike[str]] | str
"""Files, with what to add to their stamps in s, or without."""


class ColumnError(InputError):
    """Report that a requested column is missing, or that no column is left to model."""


class _Picked(NamedTuple):
    """Hold the names of the columns of a record; `stamps` are one, none, or a date and a time."""

    stamps: list[str]
    known: list[str]
    measured: list[str]
    left_out: list[str]
    """Other columns with content, each with the reason for leaving it out."""
    forgotten: str
    """Columns that may be inputs, in words."""


@overload
def read(path: Source, *, runs: None = None, **options: Any) -> Record: ...
@overload
def read(path: Source, *, runs: str, **options: Any) -> list[Record]: ...
def read(  # noqa: PLR0913
    path: Source,
    *,
    columns: _Names | None = None,
    inputs: _Names | None = (),
    time_column: _Names | None = None,
    sampling_time: float | None = None,
    fallback_sampling_time: float | None = None,
    step: float | Literal["auto"] | None = None,
    hold: str | Sequence[str] | None = None,
    gaps: Gaps = "refuse",
    missing: str | Sequence[str] = (),
    unwrap: Periods = (),
    clip_outliers: str | Sequence[str] | Limits = (),
    long: Sequence[str] = (),
    join: Joined = (),
    runs: str | None = None,
    reading: Reading | None = None,
    skip_rows: int = 0,
    header_row: int | None = None,
) -> Record | list[Record]:
    """Read a record from CSV, TSV, Parquet, NPZ, NPY, MAT (up to v7.2), text, or from pandas.

    Columns are chosen by name, or by position from 0 in a text or NPY file without names; a single
    column without a name is called y. A variable of an NPZ or MAT file is a column, and so is a
    field of a structure, "out.time"; of a matrix `m`, "m" chooses all columns and "m[0]" the first.
    A file with one row of numbers is one channel over time. A DataFrame or a Series has its time
    stamps in a column, or in an index of dates, durations, periods or fractions, or with a name.

    Text may be separated by commas, semicolons, tabs or blanks, with comments after `#` or `%`. It
    has one decimal sign, a point or a comma, and may have thousands separators. Lines above the
    names are left out; a line of units below them, "mm", becomes part of the names, "x [mm]", which
    "x" finds too.

    Parameters
    ----------
    columns : measured channels; by default every column that holds a number, has a name, and is
        neither an input nor a time (in NPZ and MAT: among the longest variables). Other columns
        with content are left out, with a `ReadingWarning` that names them.
    inputs : known inputs `u`. With None there are none either, and a `ReadingWarning` names the
        columns that may have been meant.
    time_column : stamps in seconds, in another unit at the end of the name ("t [ms]", "time_min"),
        dates or times of the day, or two columns of dates and times of the day; by default a
        column called time, timestamp, datetime, t or date. "" ignores it. Rows may be in reverse
        order. Stamps that can be read in several ways, such as 10:05 (hours or minutes), are
        refused with all of them, unless `sampling_time` agrees with one.
        Steps may differ by 1 %, or by the rounding of the stamps: one unit in their last printed
        place, both from the mean step and from the straight line through the ends, as long as that
        unit is below a step: 0, 1, 3, 4, 6 s is every 1.5 s, while 1.1 s cut to whole seconds may
        be rows lost at even distances, which `sampling_time` decides. No stamp may be more than
        half a step away from an even grid. The record's `start` is that of the grid.
    sampling_time : seconds; by default from the stamps, otherwise a scalar `sampling_time`, `dt`
        or `Ts` of the file. It may deviate from the stamps by half a step over the record.
    fallback_sampling_time : seconds, for a file without any of these.
    step : seconds between the samples of the record, whatever the stamps are; "auto" takes the
        usual distance of the fastest column. Outputs are interpolated between samples that are at
        most 1.75 of their steps apart, and not measured elsewhere. Over a longer step than that of
        the stamps they are means, see `Record.resample`. Of rows of one time the last counts. A
        column that is slower than others is measured at its own stamps alone. Other files of the
        system are read by what `Record.reading` keeps of this.
    hold : inputs that are held from stamp to stamp, as commands are, where they have to be filled;
        others are interpolated. By default those that their neighbours do not tell better than the
        value before, with a `ReadingWarning` that names them. A held input has its mean over the
        step that begins at a sample. An input with a value in fewer than half of the rows, as if it
        is logged on change, is filled without `step`, too.
    gaps : "refuse" values that are not finite, and missing rows between the stamps; "mask" marks
        both as not measured, see `Record.with_gaps`.
    missing : words or numbers that stand for a missing value: ["Bad", "-9999"].
    unwrap : angles and counters, with their periods: {"heading": 360}; see `Record.unwrap`.
    clip_outliers : outputs that are limited; see `Record.clip_outliers`.
    long : columns of a table with one measurement a row: the name of the signal, its time stamps,
        its value: ("tag", "time", "value").
    join : further files of the same run, put beside this one by time stamps; step="auto" by
        default. {"pump.csv": 1.5} adds 1.5 s to its stamps. Without a number a column that both
        have shows the offset, if there is one.
    runs : column that names the run of each row, or the time stamps where they begin again: a list
        of records is returned, which are read as the first one is.
    reading : `Record.reading` of another record of the system, which decides `missing`, `step`,
        `hold` and `unwrap` where they are not given; then `Record.like` prepares alike.
    skip_rows : lines at the top of a text file that are left out.
    header_row : line of a text file with the names, from 1, also among `skip_rows`; 0 if there are
        no names.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, PermissionError
        If the file cannot be opened.
    ValueError
        If its content is invalid: the message names the file, the column and the data row,
        counted from 0 without the header, with the line of a text file. A `ColumnError` if a column
        is missing.

    Examples
    --------
    >>> rows = [[0.0, 1, 0.0], [0.5, 1, 0.2], [1.0, 1, 0.3]]
    >>> np.savetxt("rig.csv", rows, delimiter=",", header="time,force,x", comments="")
    >>> record = sb.read("rig.csv", inputs="force")
    >>> len(record), record.sampling_time, record.columns, record.inputs
    (3, 0.5, ('x',), ('force',))
    """
    kind = type(path).__name__
    path = path.to_frame(path.name or _NAMELESS) if isinstance(path, pd.Series) else path
    frame = path if isinstance(path, pd.DataFrame) else None
    path = Path(kind) if isinstance(path, pd.DataFrame) else Path(path)
    words = (missing,) if isinstance(missing, str) else tuple(map(str, missing))
    if gaps not in get_args(Gaps):
        raise InputError(f"gaps must be one of {', '.join(get_args(Gaps))}, got {gaps!r}")
    if step not in (None, "auto"):
        positive_seconds(step, "step")
    if reading is not None:
        words, hold = words or reading.missing, reading.hold if hold is None else hold
        step = reading.grid if step is None else step
        unwrap = unwrap or (reading if step is not None else ())
    how = _How(
        columns, inputs, time_column, sampling_time, fallback_sampling_time, step, hold, gaps,
        words, unwrap, clip_outliers,
    )  # fmt: skip
    try:
        layout = Layout(skip_rows, header_row, words)
        if frame is None:
            table = load(path, layout)
        else:
            layout.check_no_lines(f"a {path}")
            table = known(of_frame(frame), layout)
        notes = list[str]()
        table = _wide(table, long) if long else table
        if join:
            table, notes = _joined(table, join, path.parent if frame is None else Path(), how)
            how = replace(how, time_column=JOINED, step=how.step or "auto")
        parts = _runs(table, runs, time_column) if runs is not None else {"": table}
        called = path.stem.removesuffix(".csv") if frame is None else ""
        records = []
        for run, part in parts.items():
            try:
                record, more = _record(part, how, " ".join(filter(None, (called, run))))
            except InputError as error:
                raise type(error)(f"run {run}: {error}" if run else f"{error}") from error
            records.append(record)
            notes += more
            if how.step == "auto":
                how = replace(how, step=record.sampling_time)
            how = replace(how, hold=record.reading.hold, unwrap=record.reading)
            how = replace(how, clip_outliers=record.reading.limits)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error
    for note in dict.fromkeys(notes):
        warnings.warn(f"{path}: {note}", ReadingWarning, stacklevel=2)
    return records[0] if runs is None else records


@dataclass(frozen=True)
class _How:
    """Hold the options of `read` that say how a table becomes a record."""

    columns: _Names | None
    inputs: _Names | None
    time_column: _Names | None
    sampling_time: float | None
    fallback_sampling_time: float | None
    step: float | Literal["auto"] | None
    hold: str | Sequence[str] | None
    gaps: Gaps
    missing: tuple[str, ...]
    unwrap: Periods | Reading
    clip_outliers: str | Sequence[str] | Limits


def _record(table: Table, how: _How, called: str) -> tuple[Record, list[str]]:
    """Return the record of a table, and what a user should know of its reading."""
    picked = _picked(table, how.columns, how.inputs, how.time_column)
    names = picked.measured + picked.known
    switches = {c: switch_states(table[c]) for c in names}
    table = table | {c: table[c].map(states) for c, states in switches.items() if states}
    times = _times(table, picked.stamps, how.sampling_time or how.fallback_sampling_time)
    spaced, even = _spacing(times, table, how), None
    if times is not None and times.newest_first:
        table = {name: column.iloc[::-1] for name, column in table.items()}
    signals = {c: _values(c, table[c]) for c in names}
    _check_finite(signals, how.step is None and how.gaps == "refuse", picked)
    signals = {c: np.where(np.isfinite(x), x, np.nan) for c, x in signals.items()}
    if isinstance(how.unwrap, Reading):
        periods = {c: period for c, period in how.unwrap.periods.items() if c in signals}
    else:
        periods = periods_of(signals, how.unwrap)
    signals |= {c: going_on(signals[c], period) for c, period in periods.items()}
    limits = how.clip_outliers
    if not isinstance(limits, Mapping):
        limits = limits_of(
            signals, [limits] if isinstance(limits, str) else limits, picked.measured
        )
    signals |= {c: np.clip(signals[c], *pair) for c, pair in limits.items()}
    read_as = [f"words of column {c!r} are read as {s}" for c, s in switches.items() if s]
    left_out = f"left out: {_listed(picked.left_out)}" if picked.left_out else ""
    notes = ["" if times is None else times.note, *read_as, left_out, picked.forgotten]
    sparse = [c for c in names if is_sparse(signals[c])]
    notes += [_slower(c, signals[c]) for c in picked.measured if c in sparse]
    if spaced is None:
        assert times is not None
        even, signals, said = _gridded(times, signals, len(picked.known), how.step)
        step, start = even.step, times.stamp(even.start)
        notes += said
    else:
        rows = len(signals[names[0]])
        if spaced.grid_rows is not None:
            rows = int(spaced.grid_rows[-1]) + 1
            check_size(8 * rows * len(names))
            signals = {c: _spread(x, rows, spaced.grid_rows) for c, x in signals.items()}
        step, start = spaced.step, spaced.start
        if times is not None and how.time_column is None:
            check_other_clock(table, picked.stamps[-1], step * (rows - 1))
    to_fill = [c for c in picked.known if even is not None or c in sparse]
    held = _held(signals, to_fill, how.hold)
    fill = even or Even.of_rows(len(signals[names[0]]))
    own, signals = signals, {**signals}
    for c in to_fill:
        signals[c] = fill.held(own[c]) if c in held else fill.between(own[c])
    if even is not None:
        signals |= {c: even.measured(own[c]) for c in picked.measured}
    for what, which in (("held", held), ("interpolated", [c for c in to_fill if c not in held])):
        if which:
            notes.append(
                f"inputs {what} between their values: {_listed(which)} (--hold names them)"
            )
    names_of = (_NAMELESS,) if list(table) == ["0"] else tuple(picked.measured)
    reading = Reading(
        missing=how.missing,
        grid=None if even is None else step,
        hold=tuple(held) if to_fill else None,
        periods=periods,
        limits=limits,
    )
    record = Record.with_gaps(
        np.column_stack([signals[c] for c in picked.measured]),
        step,
        u=np.column_stack([signals[c] for c in picked.known]) if picked.known else None,
        columns=names_of,
        inputs=tuple(picked.known),
        name=called,
        start=start,
        reading=reading,
    )
    if how.step not in (None, "auto"):
        record = record.resample(how.step)
    return record, [*filter(None, notes)]


def _check_finite(signals: Mapping[str, Array], refuse: bool, picked: _Picked) -> None:
    """Raise ValueError for a column without values and, to `refuse`, for one with gaps."""
    gaps = any(not np.isfinite(x).all() for x in signals.values())
    hint = "; gaps='mask' (--gaps mask) goes around them" if gaps else ""
    for name, x in signals.items():
        known = np.isfinite(x)
        if not known.any():
            raise ColumnError(f"column {name!r} must hold finite values: it has none")
        if not refuse or (is_sparse(x) and (name in picked.known or regular(known))):
            continue
        try:
            require_finite(f"column {name!r}", x[:, None])
        except InputError as error:
            if is_sparse(x):
                hint += (
                    f", and inputs={name!r} (--inputs {name}) takes it for an input of which only "
                    "changes are logged"
                )
            raise InputError(f"{error}{hint}") from None


def _slower(name: str, x: Array) -> str:
    """Say that an output has values in few rows."""
    known = np.isfinite(x)
    every = f", every {regular(known)}" if regular(known) else ""
    return (
        f"column {name!r} has a value in {known.sum()} of {len(x)} rows{every}: it is measured "
        "there alone"
    )


def _held(signals: Mapping[str, Array], names: list[str], hold: Any) -> list[str]:
    """Return which of the inputs are held between their values."""
    if hold is not None:
        asked = [hold] if isinstance(hold, str) else [*hold]
        asked = of_channels("hold", dict.fromkeys(asked), [*signals])
        return [c for c in names if c in asked]
    return [c for c in names if not is_smooth(signals[c][np.isfinite(signals[c])])]


def _spread(x: Array, rows: int, at: NDArray[np.int_]) -> Array:
    """Return a column with NaN in the missing rows."""
    spread = np.full(rows, np.nan)
    spread[at] = x
    return spread


def _gridded(
    times: Times, signals: Mapping[str, Array], inputs: int, asked: Any
) -> tuple[Even, dict[str, Array], list[str]]:
    """Return an even grid for stamps that are not even, and the signals at different stamps."""
    times.check_increasing(repeated=True)
    last = last_of_each(times.seconds)
    seconds, signals = times.seconds[last], {c: x[last] for c, x in signals.items()}
    fastest = max((seconds[np.isfinite(x)] for x in signals.values()), key=len)
    usual = own_step(fastest)
    step = usual if asked == "auto" else float(asked)
    factor = max(1, math.ceil(step / usual - 0.2))
    check_size(8 * len(signals) * int(np.ptp(seconds) * factor / step + 1))
    near = NEAR * max(step / factor, min(step, usual))
    even = Even.of(seconds, [*signals.values()], inputs, step / factor, near)
    off = 100 * jitter(fastest, usual)
    notes = [
        f"put on an even grid of {step:g} s: steps of the stamps are about {usual:g} s, and differ "
        f"from that by up to {off:.2g} %"
        + (f"; samples are means over {factor} steps" if factor > 1 else "")
    ]
    if not last.all():
        notes.append(f"of {(~last).sum()} rows that stand twice the last counts")
    return even, signals, notes


def _wide(table: Table, long: Sequence[str]) -> Table:
    """Return a table of one measurement a row with a column for each signal."""
    if len(long) not in (3, 4):
        raise InputError(f"long must name tag, time stamps and value, got {', '.join(long)}")
    tag, *stamps, value = (_find(table, each)[0] for each in long)
    what = f"time column {','.join(stamps)!r}"
    first = joined(table[stamps[0]], table[stamps[1]]) if len(stamps) == 2 else table[stamps[0]]
    seconds = readings(what, stamps[0], first)[0].seconds
    cells = pd.DataFrame(
        {"tag": table[tag].astype(str).array, "at": seconds, "value": table[value].array}
    )
    cells = cells.drop_duplicates(["at", "tag"], keep="last")
    wide = cells.pivot(index="at", columns="tag", values="value").infer_objects()
    rows = pd.Series(np.arange(len(seconds)), index=seconds).groupby(level=0).first()
    found = {c: table[c].iloc[rows.loc[wide.index]].reset_index(drop=True) for c in stamps}
    return found | {str(c): wide[c].reset_index(drop=True) for c in wide}


def _runs(table: Table, runs: str, time_column: _Names | None) -> dict[str, Table]:
    """Return the tables of the runs that a column names, or that begin where it goes back."""
    key = _find(table, runs)[0]
    column = table[key]
    clock = is_time(key) or (time_column not in (None, "") and key in _stamps(table, time_column))
    if clock:
        seconds = readings(f"time column {key!r}", key, column)[0].seconds
        column = pd.Series(np.cumsum(np.diff(seconds, prepend=seconds[0]) < 0))
    names = pd.Series(column.array).astype(str)
    rows = {str(name): np.flatnonzero(names == name) for name in pd.unique(names.dropna())}
    long = {c: x for c, x in table.items() if len(x) == len(column) and (clock or c != key)}
    return {name: {c: x.iloc[at] for c, x in long.items()} for name, at in rows.items()}


def _joined(table: Table, join: Joined, folder: Path, how: _How) -> tuple[Table, list[str]]:
    """Return a table with the columns of further files, at the stamps of all; see `read`."""
    files = [join] if isinstance(join, str | os.PathLike) else join
    offsets = dict(files) if isinstance(files, Mapping) else dict.fromkeys(files)
    expected = how.sampling_time or how.fallback_sampling_time
    main, times, notes = *_own(table, how.time_column, expected, "the record"), list[str]()
    parts = [main]
    for file, offset in offsets.items():
        path = Path(file)
        try:
            other, clock = _own(load(path, Layout(0, None, how.missing)), None, None, str(path))
        except InputError as error:
            raise type(error)(f"{path}: {error}") from error
        both = [c for c in other.columns if c in main.columns]
        try:
            begin = seconds_between(times.stamp(0.0), clock.stamp(0.0))
        except InputError:
            begin = None
        if offset is None and both:
            first, second = (frame[both[0]].dropna() for frame in (main, other))
            args = (
                each.to_numpy(np.float64) for each in (first.index, first, second.index, second)
            )
            shift = offset_of(*args)
            notes.append(
                f"{path.name}: {shift - (begin or 0.0):+.4g} s are added to its stamps, by column "
                f"{both[0]!r}, which both have"
            )
        elif begin is None:
            raise InputError(
                f"join must give the offset of {path}, or a column that both have: one file has "
                "dates, the other seconds"
            )
        else:
            shift = begin + (offset or 0.0)
        parts.append(other.drop(columns=both).set_axis(other.index + shift))
    whole = pd.concat(parts, axis=1).sort_index()
    named = {str(c): whole[c].reset_index(drop=True) for c in whole}
    seconds = whole.index.to_numpy(np.float64)
    if times.date is None:
        stamps: Any = seconds
    else:
        stamps = times.date + pd.to_timedelta(np.rint(1e9 * seconds).astype(np.int64), unit="ns")
    return {JOINED: pd.Series(stamps)} | named, notes


def _own(
    table: Table, time_column: _Names | None, expected: float | None, what: str
) -> tuple[pd.DataFrame, Times]:
    """Return the columns of a table over its times in s, and these times."""
    picked = _picked(table, None, (), time_column)
    times = _times(table, picked.stamps, expected)
    if times is None:
        raise InputError(f"{what} must have time stamps to be joined")
    times.check_increasing(repeated=True)
    columns = {c: table[c].array for c in picked.measured}
    words = {c: x.array for c, x in table.items() if c not in columns and switch_states(x)}
    frame = pd.DataFrame(columns | words, index=None)
    frame = frame.iloc[::-1] if times.newest_first else frame
    return frame.set_axis(times.seconds)[last_of_each(times.seconds)], times


def _picked(
    table: Table, columns: _Names | None, inputs: _Names | None, time_column: _Names | None
) -> _Picked:
    """Choose the columns of a record by the options of `read`."""
    known = [] if inputs is None else _find(table, inputs)
    stamps = _stamps(table, time_column)
    picked = stamps + known + ([] if columns is None else _find(table, columns))
    rows = _common_length(table, picked)
    timed = [c for c in table if c not in picked and len(table[c]) == rows and is_time(c)]
    timed = [c for c in timed if "abscissa" in table[c].attrs] or timed
    if time_column is None:
        if len(timed) > 1:  # T is a temperature then, unless it increases
            timed = [c for c in timed if also_time(c, table[c])]
        words = {c: time_name(c)[0] for c in timed}
        # Beside a date in each row, T is a temperature that happens to rise.
        dated = any(w == "date" and table[c].is_unique for c, w in words.items())
        timed.sort(key=lambda c: (dated and words[c] == "t", TIME_NAMES.index(words[c])))
        _check_alike(table, timed)
        stamps = _dated(table, timed)
    reasons = {c: _reason(c, table[c], rows) for c in table if c not in picked + stamps}
    usable = [c for c, reason in reasons.items() if not reason]
    if columns is not None:
        measured, left_out = _find(table, columns), []
    else:
        measured = usable
        ignored = timed if time_column == "" else []
        left_out = _in_words({c: r for c, r in reasons.items() if c not in ignored})
    if not measured:
        why = f"left out: {_listed(left_out)}" if left_out else _available(table)
        raise ColumnError(f"there is no numeric column to model: {why}")
    _check_orientation(known + measured, rows)
    forgotten = ""
    if inputs is None and usable and (columns is not None or len(usable) > 1):
        what = "taken as outputs" if columns is None else "not used"
        forgotten = f"{what}: {_listed(usable)}; --inputs names those that act on the system"
    return _Picked(stamps, known, measured, left_out, forgotten)


def _stamps(table: Table, asked: _Names | None) -> list[str]:
    """Return the keys of the time columns that were asked for; "Date,Time" names two."""
    if asked is None or asked == "":
        return []
    if isinstance(asked, str) and asked.strip() not in table and "," in asked:
        asked = asked.split(",")
    found = _find(table, asked)
    if len(found) > 2:
        raise InputError(f"time_column must be one column, or a date and a time: got {len(found)}")
    return found[::-1] if len(found) == 2 and is_time_of_day(table[found[0]]) else found


def _dated(table: Table, timed: Sequence[str]) -> list[str]:
    """Return the first of the time columns, after one with the dates of its times of the day."""
    days = [c for c in timed[1:] if time_name(c)[0] == "date" and is_day(table[c])]
    if days and is_clock_number(timed[0], table[timed[0]]):
        raise InputError(
            f"{timed[0]!r} beside {days[0]!r} can be read as seconds or as times of the day (930 "
            f"as 09:30): time_column={timed[0]!r} (--time-column) takes seconds; write times of "
            "the day as 09:30"
        )
    if not timed or not is_time_of_day(table[timed[0]]):
        return list(timed[:1])
    return [*days[:1], timed[0]]


def _check_alike(table: Table, timed: Sequence[str]) -> None:
    """Raise ValueError for structures with time stamps of their own: they are several records."""
    for other in timed[1:]:
        if "." in timed[0] + other and not table[other].equals(table[timed[0]]):
            raise InputError(
                f"{timed[0]!r} and {other!r} are different time stamps: time_column "
                "(--time-column) and columns (--columns) choose one record"
            )


def _reason(name: str, column: Column, rows: int) -> str:
    """Return the reason why a column is not a channel; empty if it is one."""
    if why := column.attrs.get("unread", column.attrs.get("left out", "")):
        return str(why)
    if len(column) != rows:
        return _EXPECTED if len(column) == 1 else f"{len(column)} rows instead of {rows}"
    unnamed = name.startswith("Unnamed: ")  # an index or a trailing separator
    numbered = unnamed or re.sub(r".*\.(?=.)| \[.*", "", name.lower()) in _ROW_NUMBERS.split()
    if numbered and is_numeric_dtype(column) and (column.diff().iloc[1:].abs() == 1).all():
        return _EXPECTED
    if unnamed:
        return "no name" if column.notna().any() else _EXPECTED
    if also_time(name, column):
        return "another time column"
    known = column.dropna()
    reason = f"no numbers: {str(known.iloc[0])[:40]!r}" if len(known) else "empty"
    return "" if has_number(column) else reason


def _in_words(reasons: Mapping[str, str]) -> list[str]:
    """Return the columns that are left out, each with its reason; those of a matrix are one."""
    by_matrix: dict[tuple[str, str], list[str]] = {}
    for name, reason in reasons.items():
        if reason and reason != _EXPECTED:
            by_matrix.setdefault((re.sub(r"\[\d+\]$", "", name), reason), []).append(name)
    return [
        f"{names[0]!r} ({reason})"
        if len(names) == 1
        else f"{matrix!r} ({reason} in each of its {len(names)} columns: transpose it if rows are "
        "its channels)"
        for (matrix, reason), names in by_matrix.items()
    ]


def _check_orientation(names: Sequence[str], rows: int) -> None:
    """Raise ValueError for more unnamed columns than rows: the table may be transposed."""
    numbered = [name for name in names if re.fullmatch(r"\d+|.*\[\d+\]", name)]
    if len(numbered) > rows:
        raise InputError(
            f"it must have more samples than channels: it has {rows} rows of {len(numbered)} "
            "columns without names; transpose it"
        )


def _values(name: str, column: Column) -> Array:
    try:
        return numbers(f"column {name!r}", column)
    except InputError as error:
        words = "; missing (--missing) names words for missing values"
        if is_text(column) and not has_number(column):
            states = dict(zip(column.dropna().astype(str).unique()[:4], range(4), strict=False))
            words = f"; numbers may stand for words, in pandas table[{name!r}].map({states})"
        raise InputError(f"{error}{words if is_text(column) else ''}") from None


def _common_length(table: Table, picked: Sequence[str]) -> int:
    """Return the number of rows of the picked columns, by default of the longest column."""
    if twice := [column for column in picked if picked.count(column) > 1]:
        raise InputError(f"column {twice[0]!r} is asked for twice, in columns, inputs or time")
    lengths = {column: len(table[column]) for column in picked or table}
    rows = lengths[picked[0]] if picked else max(lengths.values(), default=0)
    if other := [column for column in picked if lengths[column] != rows]:
        raise InputError(
            f"columns must have the same length: {picked[0]!r} has {rows} rows, "
            f"{other[0]!r} has {lengths[other[0]]}"
        )
    if rows < 2:
        raise InputError(f"a record must have at least 2 rows: it has {rows}; {_available(table)}")
    return rows


def _find(table: Table, wanted: _Names) -> list[str]:
    """Return the keys of the wanted columns; a matrix stands for all of its columns."""
    all_keys = []
    for column in [wanted] if isinstance(wanted, str | int) else wanted:
        name = str(column).strip()
        if name == _NAMELESS and list(table) == ["0"]:
            name = "0"
        keys = [name] if name in table else []
        bare = [key for key in table if unit_of(key) and key.rpartition(" ")[0] == name]
        keys = keys or (bare if len(bare) == 1 else [])
        while name not in table and (key := f"{name}[{len(keys)}]") in table:
            keys.append(key)
        if not keys:
            raise ColumnError(f"column {name!r} is unknown: {_available(table)}")
        if why := table[keys[0]].attrs.get("unread"):
            raise ColumnError(f"column {name!r} cannot be read: {why}")
        all_keys += keys
    return all_keys


def _available(table: Table) -> str:
    return f"the columns are {_listed([repr(name) for name in table]) or 'none'}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


def _times(table: Table, stamps: Sequence[str], expected: float | None) -> Times | None:
    """Return the times of the rows by their stamps; None without any."""
    if not stamps:
        return None
    what, column = f"time column {','.join(stamps)!r}", table[stamps[-1]]
    column = joined(table[stamps[0]], column) if len(stamps) == 2 else column
    return times_of(what, column, expected, table, [*stamps])


def _spacing(times: Times | None, table: Table, how: _How) -> Spacing | None:
    """Return the grid of the time stamps; without stamps, the step from the caller or the file.

    None for uneven stamps that are to be put on a grid.
    """
    given, fallback = how.sampling_time, how.fallback_sampling_time
    if times is not None and how.step is not None:
        try:
            spaced = spacing(times, "refuse", given or fallback)
        except InputError:
            return None
        longer = how.step == "auto" or whole_multiple(how.step, spaced.step)
        return spaced if longer else None
    if times is not None:
        spaced = spacing(times, how.gaps, given or fallback)
        if given is None:
            return spaced
        rows = len(times.seconds) if spaced.grid_rows is None else int(spaced.grid_rows[-1]) + 1
        if not (given > 0 and same_sampling(given, spaced.step, rows)):
            raise InputError(
                f"sampling_time (--sampling-time) is {given} s, but {times.what} steps by "
                f"{spaced.step} s; time_column='' (--time-column '') ignores the stamps"
            )
        return replace(spaced, step=given)
    for name in ("sampling_time", "dt", "Ts"):
        if given is None and len(table.get(name, ())) == 1:
            given = float(numbers(f"variable {name!r}", table[name])[0])
    given = fallback if given is None else given
    if given is None:
        raise InputError(
            "there is no time column: pass sampling_time (--sampling-time) in seconds, "
            f"or time_column (--time-column); {_available(table)}"
        )
    return Spacing(given)
