"""Choose the columns of a record from a table: stamps, inputs, outputs."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

from pandas.api.types import is_numeric_dtype

from splitband.records.remedies import Table
from splitband.records.signals import (
    Column,
    bare_name,
    categories_of,
    common_unit,
    has_number,
    is_text,
    numbers,
    unit_of,
)
from splitband.records.stamps import (
    TIME_NAMES,
    also_time,
    holds_dates,
    is_clock_number,
    is_day,
    is_time,
    is_time_of_day,
    joined,
    time_name,
)
from splitband.records.timing import Times, times_of
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

NAMELESS = "y"
"""Name of the channel of a file with a single column and no header."""
_EXPECTED = "expected"
"""Reason for leaving out row numbers, scalars and empty columns; these are not reported."""
_ROW_NUMBERS = "record index row sample scan number seq # no no. nr nr."
"""Names of columns that number the rows, in small letters."""
Names: TypeAlias = str | int | Sequence[str | int]
InputNames: TypeAlias = Names | Callable[[Column], bool] | None


class ColumnError(InputError):
    """Report that a requested column is missing, or that no column is left to model."""


class Picked(NamedTuple):
    """Hold the names of the columns of a record; `stamps` are one, none, or a date and a time."""

    stamps: list[str]
    known: list[str]
    measured: list[str]
    left_out: list[str]
    """Other columns with content, each with the reason for leaving it out."""
    forgotten: str
    """Columns that may be inputs, in words."""


def pick(
    table: Table, columns: Names | None, inputs: InputNames, time_column: Names | None
) -> Picked:
    """Choose the columns of a record by the options of `read`."""
    known = [] if inputs is None else find(table, inputs)
    stamps = stamps_asked(table, time_column)
    picked = stamps + known + ([] if columns is None else find(table, columns))
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
        stamps = _dated(table, timed) or [c for c in [*table][:1] if holds_dates(table[c])]
    reasons = {c: _reason(c, table[c], rows) for c in table if c not in picked + stamps}
    usable = [c for c, reason in reasons.items() if not reason]
    if columns is not None:
        measured, left_out = find(table, columns) or known, []
    else:
        measured = usable
        ignored = timed if time_column == "" else []
        left_out = _in_words({c: r for c, r in reasons.items() if c not in ignored})
    if not measured:
        why = f"left out: {listed(left_out)}" if left_out else available(table)
        raise ColumnError(f"there is no numeric column to model: {why}")
    _check_orientation(known + measured, rows)
    forgotten = ""
    if inputs is None and usable and (columns is not None or len(usable) > 1):
        what = "taken as outputs" if columns is None else "not used"
        forgotten = f"{what}: {listed(usable)}; inputs (--inputs) names what acts on the system"
    return Picked(stamps, known, measured, left_out, forgotten)


def stamps_asked(table: Table, asked: Names | None) -> list[str]:
    """Return the keys of the time columns that were asked for; "Date,Time" names two."""
    if asked is None or asked == "":
        return []
    if isinstance(asked, str) and asked.strip() not in table and "," in asked:
        asked = asked.split(",")
    found = find(table, asked)
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
    if unit := common_unit(known.astype(str)):
        reason += f"; columns={name!r} (--columns {name}) says how to leave the unit {unit!r} out"
    if 1 < len(categories_of(column)) < len(known) / 2:
        reason += "; its words can be an input (--inputs)"
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


def values_of(name: str, column: Column) -> Array:
    """Return a column as numbers; the error for words says what helps."""
    try:
        return numbers(f"column {name!r}", column)
    except InputError as error:
        cells = column.dropna().astype(str).str.strip().unique() if is_text(column) else ()
        words = "; missing (--missing) names words for missing values"
        if unit := common_unit(cells):
            words = f"; in pandas table[{name!r}].str.replace({unit!r}, '') leaves the unit out"
        elif not has_number(column) and all(cell[:1].isalpha() for cell in cells):
            states = dict(zip(cells[:4], range(4), strict=False))
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
        raise InputError(f"a record must have at least 2 rows: it has {rows}; {available(table)}")
    return rows


def as_list(names: InputNames) -> Sequence[str | int]:
    """Return the names that were given."""
    if isinstance(names, str | int):
        return [names]
    return () if names is None or callable(names) else names


def find(table: Table, wanted: InputNames) -> list[str]:
    """Return the keys of the wanted columns; a matrix stands for all of its columns."""
    all_keys = []
    for column in as_list(wanted):
        name = str(column).strip()
        if name == NAMELESS and list(table) == ["0"]:
            name = "0"
        keys = [name] if name in table else []
        bare = [key for key in table if unit_of(key) and bare_name(key) == name]
        keys = keys or (bare if len(bare) == 1 else [])
        while name not in table and (key := f"{name}[{len(keys)}]") in table:
            keys.append(key)
        if not keys:
            raise ColumnError(f"column {name!r} is unknown: {available(table)}")
        if why := table[keys[0]].attrs.get("unread"):
            raise ColumnError(f"column {name!r} cannot be read: {why}")
        all_keys += keys
    return all_keys


def available(table: Table) -> str:
    """Return the names of all columns for a message."""
    return f"the columns are {listed([repr(name) for name in table]) or 'none'}"


def listed(names: Sequence[str]) -> str:
    """Return at most ten names for a message."""
    return ", ".join(names[:10]) + (", ..." if len(names) > 10 else "")


def times_in(table: Table, stamps: Sequence[str], expected: float | None) -> Times | None:
    """Return the times of the rows by their stamps; None without any."""
    if not stamps:
        return None
    what, column = f"time column {','.join(stamps)!r}", table[stamps[-1]]
    column = joined(table[stamps[0]], column) if len(stamps) == 2 else column
    return times_of(what, column, expected, table, [*stamps])
