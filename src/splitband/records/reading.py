"""Read records from tables: choose the columns, find the time stamps, check every cell."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, get_args

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import is_numeric_dtype

from splitband.records.preparation import Periods, Reading
from splitband.records.record import Record
from splitband.records.remedies import Table, check_other_clock
from splitband.records.signals import (
    Column,
    Gaps,
    ReadingWarning,
    categories_of,
    category_names,
    has_number,
    indicators,
    is_text,
    numbers,
    require_finite,
    switch_of,
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
    time_name,
)
from splitband.records.tables import check_size, known, load, of_frame
from splitband.records.text import Layout
from splitband.records.timing import Spacing, same_sampling, spacing
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

_NAMELESS = "y"
"""Name of the channel of a file with a single column and no header."""
_EXPECTED = "expected"
"""Reason for leaving out row numbers, scalars and empty columns; these are not reported."""
_ROW_NUMBERS = "record index row sample scan number seq # no no. nr nr."
"""Names of columns that number the rows, in small letters."""
_Names: TypeAlias = str | int | Sequence[str | int]


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


def read(  # noqa: PLR0913
    path: str | os.PathLike[str] | pd.DataFrame | pd.Series[Any],
    *,
    columns: _Names | None = None,
    inputs: _Names | Callable[[Column], bool] | None = (),
    time_column: _Names | None = None,
    sampling_time: float | None = None,
    fallback_sampling_time: float | None = None,
    gaps: Gaps = "refuse",
    missing: str | Sequence[str] = (),
    categories: Mapping[str, Sequence[str]] | None = None,
    unwrap: Periods = (),
    skip_rows: int = 0,
    header_row: int | None = None,
) -> Record:
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
        columns that may have been meant. A function of a column, a Series, says whether it is one.
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
    gaps : "refuse" values that are not finite, and missing rows between the stamps; "mask" marks
        both as not measured, see `Record.with_gaps`.
    missing : words or numbers that stand for a missing value: ["Bad", "-9999"].
    categories : words of columns that are inputs, the first of which has no column of its own, by
        default all words of the file; those of another record: `record.reading.categories`.
    unwrap : angles and counters, with their periods: {"heading": 360}; see `Record.unwrap`.
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
    try:
        layout = Layout(skip_rows, header_row, words)
        if frame is None:
            table = load(path, layout)
        else:
            layout.check_no_lines(f"a {path}")
            table = known(of_frame(frame), layout)
        asked = {str(name) for names in (columns, inputs) for name in _as_list(names)}
        given = {c: tuple(map(str, of)) for c, of in (categories or {}).items() if c in table}
        table |= _indicators(table, {c: of for c, of in given.items() if is_text(table[c])}, asked)
        picked = _picked(table, columns, inputs, time_column)
        states = {
            c: given.get(c) or categories_of(table[c]) for c in picked.known if is_text(table[c])
        }
        states |= {c: switch_of(table[c]) for c in picked.measured}
        states = {c: of for c, of in states.items() if of}
        table |= _indicators(table, states)
        named_by = [category_names(c, states[c]) if c in states else (c,) for c in picked.known]
        picked = picked._replace(known=[name for names in named_by for name in names])
        spaced = _spacing(table, picked.stamps, sampling_time, fallback_sampling_time, gaps)
        if spaced.newest_first:
            table = {name: column.iloc[::-1] for name, column in table.items()}
        y = _matrix(table, picked.measured, gaps, spaced.grid_rows)
        u = _matrix(table, picked.known, gaps, spaced.grid_rows) if picked.known else None
        if time_column is None and picked.stamps:
            check_other_clock(table, picked.stamps[-1], spaced.step * (len(y) - 1))
        names = (_NAMELESS,) if list(table) == ["0"] else tuple(picked.measured)
        called = path.stem.removesuffix(".csv") if frame is None else ""
        named = {"columns": names, "inputs": tuple(picked.known), "name": called}
        taken = {*picked.known, *picked.measured}
        kept = {c: of for c, of in (given | states).items() if taken & {*category_names(c, of)}}
        how = {"start": spaced.start, "reading": Reading(words, kept, spaced.jitter)}
        record = Record.with_gaps(y, spaced.step, u=u, **named, **how)
        record = record.unwrap(unwrap) if unwrap else record
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error
    left_out = f"left out: {_listed(picked.left_out)}" if picked.left_out else ""
    read_as = [_read_as(c, of) for c, of in kept.items()]
    for note in filter(None, (spaced.note, *read_as, left_out, picked.forgotten)):
        warnings.warn(f"{path}: {note}", ReadingWarning, stacklevel=2)
    return record


def _as_list(names: _Names | Callable[[Column], bool] | None) -> Sequence[str | int]:
    """Return the names that were given."""
    if isinstance(names, str | int):
        return [names]
    return () if names is None or callable(names) else names


def _indicators(
    table: Table, words: Mapping[str, Sequence[str]], asked: Collection[str] | None = None
) -> Table:
    """Return the columns of 0 and 1 for columns of words, all of them or those asked for."""
    parts = [indicators(name, table[name], of) for name, of in words.items()]
    found = {name: part for each in parts for name, part in each.items()}
    return found if asked is None else {n: part for n, part in found.items() if n in asked}


def _read_as(name: str, words: Sequence[str]) -> str:
    """Return how the words of a column are read, in words."""
    first, *others = words
    if len(words) == 2:
        return f"words of column {name!r} are read as 0 ({first}) and 1 ({others[0]})"
    inputs = ", ".join(category_names(name, words))
    return (
        f"words of column {name!r} are read as {len(others)} inputs, {inputs}: 0 in all is {first}"
    )


def _picked(
    table: Table,
    columns: _Names | None,
    inputs: _Names | Callable[[Column], bool] | None,
    time_column: _Names | None,
) -> _Picked:
    """Choose the columns of a record by the options of `read`."""
    if callable(inputs):
        known = [c for c in table if not is_time(c) and inputs(table[c])]
    else:
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
    if 1 < len(categories_of(column)) < len(known) / 2:
        reason += "; its words can be an input: --inputs"
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


def _matrix(
    table: Table, names: Sequence[str], gaps: Gaps, grid_rows: NDArray[np.int_] | None
) -> Array:
    """Check every cell of some columns, and return them as a matrix, with NaN in missing rows."""
    matrix = np.column_stack([_values(name, table[name]) for name in names])
    for name, values in zip(names, matrix.T, strict=True):
        if not np.isfinite(values).any():
            raise ColumnError(f"column {name!r} must hold finite values: it has none")
    for name, values in zip(names if gaps == "refuse" else (), matrix.T, strict=False):
        try:
            require_finite(f"column {name!r}", values[:, None])
        except InputError as error:
            hint = "; gaps='mask' (--gaps mask) goes around them"
            raise InputError(f"{error}{'' if np.isfinite(matrix).all() else hint}") from None
    if grid_rows is None:
        return matrix
    rows = int(grid_rows[-1]) + 1
    check_size(8 * rows * len(names))
    spread = np.full((rows, len(names)), np.nan)
    spread[grid_rows] = matrix
    return spread


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
    for column in _as_list(wanted):
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


def _spacing(
    table: Table, stamps: Sequence[str], given: float | None, fallback: float | None, gaps: Gaps
) -> Spacing:
    """Return the grid of the time stamps; without stamps, the step from the caller or the file."""
    if stamps:
        what, column = f"time column {','.join(stamps)!r}", table[stamps[-1]]
        column = joined(table[stamps[0]], column) if len(stamps) == 2 else column
        spaced = spacing(what, column, gaps, given or fallback, table, [*stamps])
        if given is None:
            return spaced
        rows = len(column) if spaced.grid_rows is None else int(spaced.grid_rows[-1]) + 1
        if not (given > 0 and same_sampling(given, spaced.step, rows)):
            raise InputError(
                f"sampling_time (--sampling-time) is {given} s, but {what} steps by "
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
