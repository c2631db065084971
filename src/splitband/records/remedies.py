"""Tell what is wrong with time stamps that do not increase evenly, and what to do about it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from splitband.records.signals import Column, has_number
from splitband.records.stamps import Reading, is_time, readings
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

Table: TypeAlias = dict[str, Column]
"""Columns by name; in NPZ and MAT files they may differ in length."""
_MOMENT = re.compile(r"\s*\d{1,4}([-/.])\d{1,2}\1\d{1,4}[ T]+\d{1,2}:\d\d")
IGNORE = (
    "time_column='' (--time-column '') with sampling_time (--sampling-time) ignores the stamps and "
    "takes all rows to be even"
)


def remedy(table: Table, names: Sequence[str], read: Reading, usual: str) -> str:
    """Return what to do about stamps that are not even; `usual` where nothing else is wrong."""
    time, seconds = names[-1], read.seconds
    others = {c: v for c, v in table.items() if c not in names and len(v) == len(seconds)}
    if np.median(np.diff(seconds)) < 0:  # newest first
        seconds, others = seconds[::-1], {c: v.iloc[::-1] for c, v in others.items()}
    steps = np.diff(seconds)
    back = np.flatnonzero(steps <= 0)
    codes = {c: pd.factorize(v.astype(str))[0] for c, v in others.items()}
    values = [c for c in others if has_number(others[c])]
    tags = [c for c in codes if _names_signals(codes[c], seconds, c in values, read.date)]
    runs = [c for c in codes if np.array_equal(np.flatnonzero(np.diff(codes[c])), back)]
    tag, value = [*tags, *runs, ""][0], next((c for c in values if c not in tags + runs), "value")
    long = tag, *names, value
    wide = f"long={long} (--long {','.join(long)}) gives each its column"
    if tags:
        return f"column {tag!r} names several signals, one measurement a row: {wide}"
    if not usual:
        usual = f"in pandas table.sort_values({time!r}, kind='stable') puts rows in order"
        if not (steps < 0).any():
            usual = "step='auto' (--step auto) takes the last of rows that stand twice"
        usual += f"; where each is a sample of its own, {IGNORE}"
    step = np.median(steps[steps > 0]) if len(back) < len(steps) else 0.0
    off = np.abs(steps - step)[np.abs(steps - step) > 0.01 * step]
    if read.date is not None and not read.date.tzinfo and (abs(off - 3600) < 0.01 * step).all():
        return (
            f"if summer time began or ended there, name the zone, in pandas table[{time!r}] = "
            f"pd.to_datetime(table[{time!r}]).dt.tz_localize('Europe/Berlin', ambiguous='infer'); "
            f"otherwise {usual}"
        )
    parts = np.split(seconds, back + 1)
    again = [b[0] < a[-1] - 0.5 * np.ptp(a) and len(a) > 2 for a, b in pairwise(parts)]
    if not (again and all(again)):
        return usual
    if is_time(tag) and tag in values:
        days = f"{{{tag!r}: table[{tag!r}] + table.pop({time!r})}}"
        return f"it begins again with each {tag!r}: in pandas table.assign(**{days}) adds them"
    key, apart = time, ""
    if runs:
        key, apart = tag, f", which column {tag!r} tells apart"
        apart += "" if tag in values else f" (if it names signals, {wide})"
    return (
        f"the clock begins again ({len(back)} times), so the file holds several runs{apart}: "
        f"runs={key!r} (--runs {key}) reads each as a record of its own"
    )


def _names_signals(
    codes: NDArray[np.int_], seconds: Array, numeric: bool, date: pd.Timestamp | None
) -> bool:
    """Return whether the words of a column, as codes, name the signal that each row measures.

    Signals alternate from row to row, one follows another over the same dates, or rows of one are
    logged among those of another.
    """
    steps = pd.Series(seconds).groupby(codes).diff().dropna()
    if not 2 <= codes.max() + 1 <= len(codes) // 3 or not ((steps > 0).all() or (steps < 0).all()):
        return False
    alternates = np.count_nonzero(np.diff(codes)) >= 0.5 * len(codes)
    doubled = len(np.unique(seconds)) < 0.6 * len(codes)
    if numeric:  # a signal may alternate by chance
        return bool(alternates and doubled and np.ptp(np.bincount(codes)) <= 1)
    # Rows of the other signals stand between those of the most frequent one, and push none apart.
    own = np.flatnonzero(codes == np.bincount(codes).argmax())
    apart, between = np.diff(seconds[own]), np.diff(own) > 1
    among = 0 < between.sum() < len(between)
    among = among and bool(np.median(apart[between]) < 1.5 * np.median(apart[~between]))
    return bool(alternates or among or (doubled and date is not None))


def check_other_clock(table: Table, name: str, length: float) -> None:
    """Raise ValueError where dates of another column do not last `length` s as numeric stamps do.

    The stamps, in column `name`, may be in another unit than they seem to be.
    """
    rows = np.unique(np.linspace(0, len(table[name]) - 1, 400).astype(int))
    for other, column in table.items() if has_number(table[name]) else ():
        if len(column) != len(table[name]) or not _MOMENT.match(str(column.iloc[0])):
            continue
        try:
            seconds = np.unique(readings(other, other, column.iloc[rows])[0].seconds)
        except InputError:
            continue
        told, unit = float(np.ptp(seconds)), np.diff(seconds).min(initial=np.inf)
        if abs(told - length) > 0.02 * max(told, length) + 2 * unit:
            raise InputError(
                f"column {name!r} lasts {length:.6g} s, dates in column {other!r} {told:.6g} s: "
                f"time_column={name!r} or {other!r} (--time-column) says which are the time stamps"
            )
