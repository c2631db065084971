"""Read records from tables: check every cell, and put the samples on an even grid."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args, overload

import numpy as np
import pandas as pd

from splitband.records.columns import (
    NAMELESS,
    ColumnError,
    InputNames,
    Names,
    Picked,
    as_list,
    available,
    find,
    listed,
    pick,
    times_in,
    values_of,
)
from splitband.records.combining import JOINED, Joined, join_files, split_runs, wide
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
    own_step,
    regular,
)
from splitband.records.record import Record
from splitband.records.remedies import Table, check_other_clock
from splitband.records.signals import (
    Gaps,
    ReadingWarning,
    categories_of,
    category_names,
    indicators,
    is_text,
    numbers,
    positive_seconds,
    require_finite,
    switch_of,
)
from splitband.records.stamps import is_time
from splitband.records.tables import check_size, known, load, of_frame
from splitband.records.text import Layout
from splitband.records.timing import (
    Spacing,
    Stamp,
    Times,
    same_sampling,
    spacing,
    whole_multiple,
)
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

Source: TypeAlias = "str | os.PathLike[str] | pd.DataFrame | pd.Series[Any]"


@overload
def read(path: Source, *, runs: None = None, **options: Any) -> Record: ...
@overload
def read(path: Source, *, runs: str, **options: Any) -> list[Record]: ...
def read(  # type: ignore[misc]  # noqa: PLR0913
    path: Source,
    *,
    columns: Names | None = None,
    inputs: InputNames = (),
    time_column: Names | None = None,
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
    has one decimal sign, a point or a comma, and may have thousands separators (the other sign, a
    blank or an apostrophe) and Fortran's exponents, 1.5D+03. Lines above the
    names are left out; a line of units below them, "mm", becomes part of the names, "x [mm]", which
    "x" finds too.

    Parameters
    ----------
    columns : measured channels; by default every column that holds a number, has a name, and is
        neither an input nor a time (in NPZ and MAT: among the longest variables); () for a plan,
        whose outputs are its inputs. Other columns
        with content are left out, with a `ReadingWarning` that names them.
    inputs : known inputs `u`. None means that there are none, and a `ReadingWarning` names the
        columns that may be inputs. A function of a column, a Series, says whether it is one.
        Booleans and the words of a switch are 0 and 1. Other words become a column each but the
        first of them, "mode=heat" and "mode=cool" beside "auto", which is 0 in both.
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
        column that is slower than others is measured at its own stamps alone. `Record.reading`
        keeps these choices for other files of the system.
    hold : columns that are held from stamp to stamp and in gaps, as commands are, where they have
        to be filled; other inputs are interpolated. By default those inputs that mostly repeat
        their last value, or that their neighbours predict no better than that value. A held input
        has its mean over the step that begins at a sample. An input with a value in fewer than half
        of the rows, as one that is logged on change, is filled without `step`, too. A
        `ReadingWarning` names them; a model keeps the choice.
    gaps : "refuse" values that are not finite, and missing rows between the stamps; "mask" marks
        both as not measured, see `Record.with_gaps`.
    missing : words or numbers that stand for a missing value: ["Bad", "-9999"].
    unwrap : angles and counters, with their periods: {"heading": 360}; see `Record.unwrap`.
    clip_outliers : outputs that are limited; see `Record.clip_outliers`.
    long : columns of a table with one measurement a row: the name of the signal, its time stamps,
        its value: ("tag", "time", "value"); step="auto" by default.
    join : further files of the same run, put beside this one by time stamps; step="auto" by
        default. {"pump.csv": 1.5} adds 1.5 s to its stamps. Without a number a column that both
        have shows the offset, if there is one.
    runs : column that names the run of each row, or the time stamps where they begin again: a list
        of records is returned, which are read as the first one is.
    reading : `Record.reading` of another record of the system, which decides `missing`, `step`,
        `hold` and `unwrap` where they are not given, and the words of inputs; then `Record.like`
        prepares alike.
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
    path = path.to_frame(path.name or NAMELESS) if isinstance(path, pd.Series) else path
    frame = path if isinstance(path, pd.DataFrame) else None
    path = Path(kind) if isinstance(path, pd.DataFrame) else Path(path)
    words = (missing,) if isinstance(missing, str) else tuple(map(str, missing))
    if gaps not in get_args(Gaps):
        raise InputError(f"gaps must be one of {', '.join(get_args(Gaps))}, got {gaps!r}")
    if step not in (None, "auto"):
        step = positive_seconds(step, "step")
    if reading is not None:
        words, step = words or reading.missing, reading.grid if step is None else step
    by = reading if reading is not None and step is not None and not unwrap else unwrap
    held = reading if reading is not None and hold is None else hold
    how = _How(
        columns,
        inputs,
        time_column,
        sampling_time,
        fallback_sampling_time,
        step,
        held,
        gaps,
        words,
        by,
        clip_outliers,
        {} if reading is None else reading.categories,
    )
    try:
        layout = Layout(skip_rows, header_row, words)
        if frame is None:
            table = load(path, layout)
        else:
            layout.check_no_lines(f"a {path}")
            table = known(of_frame(frame), layout)
        written, how, notes = _combined(table, how, long, join)
        key = [] if runs is None else find(written, runs)
        table, how = _worded(written, how, key)
        notes += [_read_as(c, of) for c, of in how.categories.items()]
        parts, as_written = (
            split_runs(each, runs, how.time_column) if runs is not None else {"": each}
            for each in (table, written)
        )
        called = path.stem.removesuffix(".csv") if frame is None else ""
        records = []
        for run, part in parts.items():
            try:
                name = " ".join(filter(None, (called, run)))
                record, more = _record(part, how, name, as_written[run])
            except InputError as error:
                raise type(error)(f"run {run}: {error}" if run else f"{error}") from error
            records.append(record)
            notes += more
            if how.step == "auto":
                how = replace(how, step=record.sampling_time)
            decided = record.reading
            how = replace(how, unwrap=decided, clip_outliers=decided.limits)
            how = how if decided.hold is None else replace(how, hold=decided)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error
    for note in dict.fromkeys(notes):
        warnings.warn(f"{path}: {note}", ReadingWarning, stacklevel=2)
    return records[0] if runs is None else records


@dataclass(frozen=True)
class _How:
    """Hold the options of `read` that say how a table becomes a record."""

    columns: Names | None
    inputs: InputNames
    time_column: Names | None
    sampling_time: float | None
    fallback_sampling_time: float | None
    step: float | Literal["auto"] | None
    hold: str | Sequence[str] | Reading | None
    gaps: Gaps
    missing: tuple[str, ...]
    unwrap: Periods | Reading
    clip_outliers: str | Sequence[str] | Limits
    categories: Mapping[str, tuple[str, ...]]

    @property
    def expected(self) -> float | None:
        """Return the sampling time of the file, if the caller knows it."""
        return self.sampling_time or self.fallback_sampling_time


def _combined(
    table: Table, how: _How, long: Sequence[str], join: Joined
) -> tuple[Table, _How, list[str]]:
    """Return one table of a long one and of several files, how it is read, and what was done."""
    notes = list[str]()
    if long:
        table, notes = wide(table, long)
        stamps = how.time_column or list(long[1:-1])
        how = replace(how, time_column=stamps, step=how.step or "auto")
    if join:
        table, shifts = join_files(table, join, how.time_column, how.expected, how.missing)
        how = replace(how, time_column=JOINED, step=how.step or "auto")
        notes += shifts
    return table, how, notes


def _worded(table: Table, how: _How, runs: Sequence[str]) -> tuple[Table, _How]:
    """Return a table with numbers for words of inputs and switches, and what is to be read of it.

    This is done before runs are split: one of them may lack a word. `runs`: what names them.
    """
    asked = {str(name) for names in (how.columns, how.inputs) for name in as_list(names)}
    states = {c: of for c, of in how.categories.items() if c in table and is_text(table[c])}
    states = {c: of for c, of in states.items() if asked & {*category_names(c, of)}}
    found = _numbered(table, states)
    inputs: list[str] | None = None
    if callable(how.inputs):
        inputs = [c for c in found if c not in runs and not is_time(c) and how.inputs(found[c])]
    elif how.inputs is not None:
        inputs = find(found, how.inputs)
    texts = [c for c in inputs or () if is_text(found[c])]
    own = {c: how.categories.get(c) or categories_of(found[c]) for c in texts}
    if how.columns is not None:
        own |= {c: switch_of(found[c]) for c in find(found, how.columns)}
    own = {c: of for c, of in own.items() if of}
    named = {c: category_names(c, of) for c, of in own.items()}
    hold = how.hold
    if hold is not None and not isinstance(hold, Reading):
        hold = [each for c in as_list(hold) for each in named.get(str(c), (str(c),))]
    if inputs is not None:
        inputs = [each for c in inputs for each in named.get(c, (c,))]
    how = replace(how, inputs=inputs, hold=hold, categories=states | own)
    return _numbered(found, own), how


def _numbered(table: Table, words: Mapping[str, Sequence[str]]) -> Table:
    """Return a table with columns of 0 and 1 in place of columns of words."""
    parts = [indicators(name, table[name], of) for name, of in words.items()]
    rest = {name: column for name, column in table.items() if len(words.get(name, "12")) == 2}
    return rest | {name: part for each in parts for name, part in each.items()}


def _read_as(name: str, words: Sequence[str]) -> str:
    """Return how the words of a column are read, in words."""
    first, *others = words
    if len(words) == 2:
        return f"words of column {name!r} are read as 0 ({first}) and 1 ({others[0]})"
    inputs = ", ".join(category_names(name, words))
    return (
        f"words of column {name!r} are read as {len(others)} inputs, {inputs}: 0 in all is {first}"
    )


def _record(table: Table, how: _How, called: str, written: Table) -> tuple[Record, list[str]]:
    """Return the record of a table, and what a user should know of its reading.

    `written` is the table before words became numbers, which tell what is wrong with its stamps.
    """
    picked = pick(table, how.columns, how.inputs, how.time_column)
    names = picked.measured + picked.known
    times = times_in(written, picked.stamps, how.expected)
    spaced = _spacing(times, table, how)
    start: Stamp | None
    if times is not None and times.newest_first:
        table = {name: column.iloc[::-1] for name, column in table.items()}
    signals, found = _signals(table, picked, how)
    left_out = f"left out: {listed(picked.left_out)}" if picked.left_out else ""
    notes = ["" if times is None else times.note, left_out, picked.forgotten]
    sparse = [c for c, x in signals.items() if is_sparse(x)]
    outputs = [c for c in picked.measured if c not in picked.known]  # a plan's are its inputs
    notes += [_slower(c, signals[c]) for c in outputs if c in sparse]
    if spaced is None:
        assert times is not None
        even, signals, varies, said = _gridded(times, signals, len(picked.known), how.step)
        step, start = even.step, times.stamp(even.start)
        found, notes = replace(found, grid=step, jitter=varies), [*notes, said]
    else:
        step, start, rows = spaced.step, spaced.start, len(signals[names[0]])
        found = replace(found, jitter=spaced.jitter)
        if spaced.grid_rows is not None:
            rows = int(spaced.grid_rows[-1]) + 1
            check_size(8 * rows * len(names))
            on_grid = pd.DataFrame(signals, spaced.grid_rows).reindex(range(rows))
            signals = {c: on_grid[c].to_numpy() for c in signals}
        if times is not None and how.time_column is None:
            check_other_clock(table, picked.stamps[-1], step * (rows - 1))
        even = Even.of_rows(rows)
    held, between = _courses({c: signals[c] for c in picked.known}, how.hold)
    own, signals = signals, {**signals}
    lacking = [c for c in held + between if spaced is None or not np.isfinite(own[c]).all()]
    for what, which, put in ("held", held, even.held), ("interpolated", between, even.between):
        if which := [c for c in which if c in lacking and (spaced is None or c in sparse)]:
            signals |= {c: put(own[c]) for c in which}
            notes.append(
                f"inputs {what} between their values: {listed(which)}; hold (--hold) decides"
            )
    if spaced is None:
        signals |= {c: even.measured(own[c]) for c in outputs}
    record = Record.with_gaps(
        np.column_stack([signals[c] for c in picked.measured]),
        step,
        u=np.column_stack([signals[c] for c in picked.known]) if picked.known else None,
        columns=(NAMELESS,) if list(table) == ["0"] else tuple(picked.measured),
        inputs=tuple(picked.known),
        name=called,
        start=start,
        reading=replace(found, hold=tuple(held) if lacking else None),
    )
    if how.step is not None and how.step != "auto":
        record = record.resample(how.step)
    return record, [*filter(None, notes)]


def _signals(table: Table, picked: Picked, how: _How) -> tuple[dict[str, Array], Reading]:
    """Return the columns with NaN in gaps, unwrapped and limited, and by what."""
    signals = {c: values_of(c, table[c]) for c in picked.measured + picked.known}
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
    return signals, Reading(how.missing, how.categories, periods=periods, limits=limits)


def _check_finite(signals: Mapping[str, Array], refuse: bool, picked: Picked) -> None:
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


def _courses(inputs: Mapping[str, Array], hold: Any) -> tuple[list[str], list[str]]:
    """Return which inputs are held where they have no values, and which are interpolated."""
    asked = hold.hold if isinstance(hold, Reading) else hold
    chosen = [asked] if isinstance(asked, str) else asked
    if chosen is not None and not isinstance(hold, Reading):
        chosen = of_channels("hold", dict.fromkeys(chosen), [*inputs])
    if chosen is None:
        chosen = [c for c, x in inputs.items() if not is_smooth(x[np.isfinite(x)])]
    return [c for c in inputs if c in chosen], [c for c in inputs if c not in chosen]


def _gridded(
    times: Times, signals: Mapping[str, Array], inputs: int, asked: Any
) -> tuple[Even, dict[str, Array], float, str]:
    """Return an even grid for stamps that are not even, and the signals at different stamps.

    Then by how many s steps of the stamps differ, and what was done, in words.
    """
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
    off = jitter(fastest, usual)
    differ = f", and differ from that by up to {100 * off:.2g} %" if off > 1e-6 else ""
    notes = [
        f"put on an even grid of {step:g} s: steps of the stamps are about {usual:g} s{differ}"
    ]
    notes += [f"samples are means over {factor} steps"] if factor > 1 else []
    if not last.all():
        notes.append(f"of rows of one time the last counts ({(~last).sum()} are left out)")
    return even, signals, off * usual, "; ".join(notes)


def _spacing(times: Times | None, table: Table, how: _How) -> Spacing | None:
    """Return the grid of the stamps, of the caller or of the file; None for uneven stamps."""
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
        rising = [n for n, x in table.items() if x.is_monotonic_increasing and x.is_unique]
        increases = f", such as {rising[0]!r}, which increases" if rising else ""
        raise InputError(
            "there is no time column: pass sampling_time (--sampling-time) in seconds, "
            f"or time_column (--time-column){increases}; {available(table)}"
        )
    return Spacing(given)
