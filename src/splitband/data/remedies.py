"""Tell what is wrong with time stamps that do not increase evenly, and what to do about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from splitband.data.signals import Column, has_number
from splitband.data.stamps import Reading, is_moment, is_time, readings
from splitband.runtime.errors import InputError

IGNORE = (
    "time_column='' (--time-column '') with sampling_time (--sampling-time) ignores the stamps and "
    "takes all rows to be even"
)
_HOUR = 3600.0


def remedy(table: Mapping[str, Column], names: Sequence[str], read: Reading, usual: str) -> str:
    """Return what to do about stamps that do not increase, or not evenly: then `usual`, if nothing
    else is wrong with them.

    Parameters
    ----------
    table : Columns of the file.
    names : Of the columns that hold the stamps.
    read : The stamps, one for each row.
    """
    seconds, time = read.seconds, f"table[{names[-1]!r}]"
    others = {c: v for c, v in table.items() if c not in names and len(v) == len(seconds)}
    steps = np.diff(seconds)
    back = np.flatnonzero(steps <= 0)
    if tag := next((c for c in others if _names_signals(others[c], read)), ""):
        return (
            f"column {tag!r} names several signals, one measurement a row: give each a column, "
            f"in pandas {_pivot(names, tag, others)}"
        )
    if clock := _clock_change(read):
        zoned = (
            f"{clock}: write the stamps in UTC or with their zone, in pandas "
            f"pd.to_datetime({time}).dt.tz_localize('Europe/Berlin', ambiguous='infer')"
        )
        return zoned if back.size else f"{zoned}; {usual}"
    if not back.size:
        return usual
    counts = np.diff(np.flatnonzero(np.concatenate([[True], steps != 0, [True]])))
    if steps.min() == 0 and np.median(counts) > 1 and np.ptp(counts[1:-1]) <= 1:
        return f"the stamps are coarser than the rows: {IGNORE}"
    runs = [c for c in others if np.array_equal(np.flatnonzero(_changes(others[c])), back)]
    if (day := next(filter(is_time, runs), "")) and has_number(others[day]):
        return (
            f"it begins again with each {day!r}: add both, in pandas table.assign("
            f"**{{{day!r}: table[{day!r}] + table.pop({names[-1]!r})}})"
        )
    begins = np.concatenate([[0], back + 1, [len(seconds)]])
    spans = seconds[begins[1:] - 1] - seconds[begins[:-1]]
    if np.diff(begins).min() > 2 and (-steps[back] > 0.5 * spans[:-1]).all():
        key, apart, drop = f"{time}.diff().lt(0).cumsum()", "", ""
        if runs:
            key, apart = repr(runs[0]), f", which column {runs[0]!r} tells apart"
            drop = f".drop(columns={key})"
            if not has_number(others[runs[0]]):
                apart += f" (if it names signals: {_pivot(names, runs[0], others)})"
        return (
            f"the clock begins again ({len(back)} times), the file holds several runs{apart}: save "
            f"each as a file of its own, in pandas [run{drop}.to_csv(f'run{{i}}.csv', index=False) "
            f"for i, run in table.groupby({key})], and give the others with --more"
        )
    if len(np.unique(seconds)) == len(seconds):
        return f"sort the rows, in pandas table.sort_values({names[-1]!r})"
    return (
        f"where such a row repeats another, leave it out, in pandas table.drop_duplicates("
        f"{names[-1]!r}); where it is a sample of its own, {IGNORE}"
    )


def _pivot(names: Sequence[str], tag: str, others: Mapping[str, Column]) -> str:
    """Return the line of pandas that makes a table of one measurement a row wide."""
    value = next((c for c in others if c != tag and has_number(others[c])), "value")
    return f"table.pivot(index={[*names]}, columns={tag!r}, values={value!r}).reset_index()"


def _changes(column: Column) -> NDArray[np.bool_]:
    """Return where a cell differs from the one before it, `(time - 1,)`."""
    return np.asarray(np.diff(pd.factorize(column)[0]) != 0)


def _names_signals(column: Column, read: Reading) -> bool:
    """Return whether a column names the signal that is measured in each row.

    The time increases, or decreases, from each measurement of a signal to the next. Signals alternate
    from row to row, or one follows another over the same dates.
    """
    codes, words = pd.factorize(column)
    if not 2 <= len(words) <= len(codes) // 3 or (codes < 0).any():
        return False
    order = np.argsort(codes, kind="stable")
    steps = np.diff(read.seconds[order])[np.diff(codes[order]) == 0]
    if not ((steps > 0).all() or (steps < 0).all()):
        return False
    alternates = _changes(column).mean() >= 0.5
    doubled = len(np.unique(read.seconds)) < 0.6 * len(codes)
    if has_number(column):  # which alternates by chance where it is a signal
        return bool(alternates and doubled and np.ptp(np.bincount(codes)) <= 1)
    return bool(alternates or (doubled and read.date is not None))


def _clock_change(read: Reading) -> str:
    """Return how the clock of local dates was changed by an hour, in words; empty if it was not."""
    if read.date is None or read.date.tzinfo is not None:
        return ""
    steps = np.diff(read.seconds)
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    odd = np.flatnonzero(np.abs(steps - step) > 0.01 * step + 1e-6)
    if not (np.abs(np.abs(steps[odd] - step) - _HOUR) < 0.01 * step + 1e-6).all():
        return ""
    if (steps[odd] < step).any():
        return "the clock goes back by an hour there, as at the end of summer time"
    # Europe, America and Australia change their clocks on Sundays.
    days = read.date + pd.to_timedelta(read.seconds[odd + 1], unit="s")
    return "if summer time began there" if (days.dayofweek == 6).all() else ""


def check_other_clock(table: Mapping[str, Column], name: str, length: float) -> None:
    """Raise ValueError where dates in another column last longer or shorter than numeric stamps.

    `length` is that of the stamps in column `name`, in s.
    """
    rows = np.unique(np.linspace(0, len(table[name]) - 1, 400).astype(int))
    for other, column in table.items() if has_number(table[name]) else ():
        if other == name or len(column) <= rows[-1] or not is_moment(column):
            continue
        try:
            seconds = readings(other, other, column.iloc[rows])[0].seconds
        except InputError:
            continue
        steps = np.abs(np.diff(seconds))
        told, unit = abs(seconds[-1] - seconds[0]), float(steps[steps > 0].min(initial=np.inf))
        if abs(told - length) > 0.02 * max(told, length) + 2 * unit:
            raise InputError(
                f"column {name!r} lasts {length:.6g} s, the dates of column {other!r} {told:.6g} "
                f"s: time_column={name!r} or time_column={other!r} (--time-column) says which of "
                "them holds the time stamps"
            )
