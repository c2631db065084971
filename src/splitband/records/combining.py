"""Make one table of long ones and of several files, and several of one with several runs."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from splitband.records.columns import Names, find, pick, stamps_asked, times_in
from splitband.records.rates import last_of_each, offset_of
from splitband.records.remedies import Table
from splitband.records.signals import categories_of, has_number
from splitband.records.stamps import is_time, joined, readings
from splitband.records.tables import load
from splitband.records.text import Layout
from splitband.records.timing import Times, seconds_between
from splitband.runtime.errors import InputError

JOINED = "time [s]"
"""Name of the time column of joined files."""
Joined: TypeAlias = Mapping[Any, float | None] | Sequence[str | os.PathLike[str]] | str
"""Files, with what to add to their stamps in s, or without."""


def wide(table: Table, long: Sequence[str]) -> tuple[Table, list[str]]:
    """Return a table of one measurement a row with a column for each signal, and what was done."""
    if len(long) not in (3, 4):
        raise InputError(f"long must name tag, time stamps and value, got {', '.join(long)}")
    tag, *stamps, value = (find(table, each)[0] for each in long)
    what = f"time column {','.join(stamps)!r}"
    first = joined(table[stamps[0]], table[stamps[1]]) if len(stamps) == 2 else table[stamps[0]]
    seconds = readings(what, stamps[0], first)[0].seconds
    cells = pd.DataFrame(
        {"tag": table[tag].astype(str).array, "at": seconds, "value": table[value].array}
    )
    every = len(cells)
    cells = cells.drop_duplicates(["at", "tag"], keep="last")
    twice = every - len(cells)
    notes = [f"of values of one signal at one time the last counts ({twice} are left out)"]
    wide = cells.pivot(index="at", columns="tag", values="value")[
        pd.unique(cells["tag"])
    ].infer_objects()
    rows = pd.Series(np.arange(len(seconds)), index=seconds).groupby(level=0).first()
    found: Table = {c: table[c].iloc[rows.loc[wide.index]].reset_index(drop=True) for c in stamps}
    found |= {str(c): wide[c].reset_index(drop=True) for c in wide}
    return found, notes if twice else []


def split_runs(table: Table, runs: str, time_column: Names | None) -> dict[str, Table]:
    """Return the tables of the runs that a column names, or that begin where it goes back."""
    key = find(table, runs)[0]
    column = table[key]
    clock = is_time(key) or (
        time_column not in (None, "") and key in stamps_asked(table, time_column)
    )
    if clock:
        seconds = readings(f"time column {key!r}", key, column)[0].seconds
        column = pd.Series(np.cumsum(np.diff(seconds, prepend=seconds[0]) < 0))
    names = pd.Series(column.array).astype(str)
    rows = {str(name): np.flatnonzero(names == name) for name in pd.unique(names.dropna())}
    long = {c: x for c, x in table.items() if len(x) == len(column) and (clock or c != key)}
    return {name: {c: x.iloc[at] for c, x in long.items()} for name, at in rows.items()}


def join_files(
    table: Table,
    join: Joined,
    time_column: Names | None,
    expected: float | None,
    missing: tuple[str, ...],
) -> tuple[Table, list[str]]:
    """Return a table with the columns of further files too, see `read`, and what was shifted."""
    files = [join] if isinstance(join, str | os.PathLike) else join
    offsets = dict(files) if isinstance(files, Mapping) else dict.fromkeys(files)
    main, times = _own(table, time_column, expected, "the record")
    parts, notes = [main], list[str]()
    for file, offset in offsets.items():
        path = Path(file)
        try:
            other, clock = _own(load(path, Layout(0, None, missing)), None, expected, str(path))
        except InputError as error:
            raise type(error)(f"{path}: {error}") from error
        both = [c for c in other.columns if c in main.columns]
        dated = times.date is not None, clock.date is not None
        begin = (
            seconds_between(times.stamp(0.0), clock.stamp(0.0)) if dated[0] == dated[1] else None
        )
        if offset is None and both:
            first, second = (frame[both[0]].dropna() for frame in (main, other))
            signals = (
                np.asarray(x, np.float64) for each in (first, second) for x in (each.index, each)
            )
            shift = offset_of(*signals)
            notes.append(
                f"{path.name}: {shift - (begin or 0.0):+.4g} s are added to its stamps, by column "
                f"{both[0]!r}, which both have"
            )
        elif begin is None:
            raise InputError(
                f"join must give {path} a column that the record has, too, to find the offset of "
                "their clocks: only one of them has dates"
            )
        else:
            shift = begin + (offset or 0.0)
        apart = other.index[0] + shift - main.index[-1], main.index[0] - other.index[-1] - shift
        if max(apart) >= 0:
            raise InputError(
                f"join must put {path} beside the record: their time stamps are {max(apart):.6g} s "
                f"apart; {path.name}@+1.5 (--join), {{{path.name!r}: 1.5}} in Python, adds 1.5 s "
                "to its stamps, and a column that both have shows the offset by itself"
            )
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
    table: Table, time_column: Names | None, expected: float | None, what: str
) -> tuple[pd.DataFrame, Times]:
    """Return the columns of a table over its times in s, and these times."""
    words = [c for c, x in table.items() if not is_time(c) and categories_of(x)]
    counted = any(has_number(x) for c, x in table.items() if not is_time(c))
    picked = pick(table, None if counted or not words else words, (), time_column)
    times = times_in(table, picked.stamps, expected)
    if times is None:
        raise InputError(f"{what} must have time stamps to be joined")
    times.check_increasing(repeated=True)
    columns = {c: table[c].array for c in picked.measured}
    columns |= {c: table[c].array for c in words if c not in picked.stamps}
    frame = pd.DataFrame(columns)
    frame = frame.iloc[::-1] if times.newest_first else frame
    return frame.set_axis(times.seconds)[last_of_each(times.seconds)], times
