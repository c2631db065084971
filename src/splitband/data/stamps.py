"""Read time stamps, in seconds or as dates, and find the even step between them."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import is_timedelta64_dtype

from splitband.data.columns import Column, has_number, numbers
from splitband.data.gaps import Gaps
from splitband.data.signals import require_finite
from splitband.data.timing import Stamp, stamp_after
from splitband.runtime.arrays import Array

MOST_MISSING = 0.9
"""Share of a record's rows that may be missing between its time stamps. By eye."""
TIME_NAMES = ("time", "t", "timestamp", "datetime", "date")
_CLOCK_STEPS = (
    *(n * unit for unit in (1, 60) for n in (1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30)), 3600, 7200,
)  # fmt: skip
"""Common sampling times, in seconds, of loggers that count in minutes and hours."""
_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "min": 60.0, "h": 3600.0}
_UNITS |= {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_UNIT = re.compile(rf"[\s_/(\[]+({'|'.join(_UNITS)})[)\]]?$")
_TIME_OF_DAY = re.compile(r"\s*\d{1,2}:\d\d")
_ZONE = re.compile(r":\d\d(?:[.,]\d+)?\s*(?:Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)\s*$")
_DOTTED = re.compile(r"\s*\d{1,2}\.\d{1,2}\.\d")


@dataclass(frozen=True, eq=False)
class Spacing:
    """Describe the even grid that the rows of a file lie on.

    Attributes
    ----------
    step : In s.
    start : Time stamp of its first row; None for a file without time stamps.
    places : Grid index of each row of the file, `(time,)`; None if no rows are missing.
    note : Message about how the stamps were interpreted; empty if that is certain.
    """

    step: float
    start: Stamp | None = None
    places: NDArray[np.int_] | None = None
    note: str = ""


def time_name(column: str) -> tuple[str, float]:
    """Split a name such as "Time [ms]" into "time" and its unit in seconds."""
    name = column.strip().lower()
    unit = _UNIT.search(name)
    return (name[: unit.start()], _UNITS[unit[1]]) if unit else (name, 1.0)


def also_time(name: str, column: Column) -> bool:
    """Return whether a column such as "time_2" or "elapsed time" is another time column.

    Its name contains a word for time, and its values increase from row to row.
    """
    words = set(re.findall("[a-z]+", name.lower()))
    if not words & {*TIME_NAMES} - {"t"} or not has_number(column):  # T_1 is a temperature
        return False
    values = pd.to_numeric(column, errors="coerce").dropna().to_numpy(dtype=np.float64)
    return len(values) > 1 and bool((np.diff(values) > 0).all())


def spacing(what: str, name: str, column: Column, gaps: Gaps) -> Spacing:
    """Return the even grid of time stamps.

    Raises ValueError for cells that are not stamps, and for stamps that do not increase evenly;
    `reading.read` states the tolerance.
    """
    days = _serial_days(what, name, column)
    stamps, grain, date = _seconds(what, name, column) if days is None else _seconds_of_days(days)
    rows, joined = _on_grid(what, stamps) if gaps == "mask" else (np.arange(len(stamps)), stamps)
    unit = max(_last_place(stamps), grain)
    step, start = _even_grid(what, joined, unit, gaps == "mask")
    return Spacing(
        step,
        start if date is None else stamp_after(date, start),
        rows if len(rows) <= rows[-1] else None,
        _note(what, name, column, stamps, date),
    )


def _note(what: str, name: str, column: Column, stamps: Array, date: Stamp | None) -> str:
    """Return how numbers were read, if they could have been read otherwise."""
    if not has_number(column):
        return ""
    if date is not None:
        return f"{what} holds Excel's serial days, read as dates from {date}"
    unitless = time_name(name)[0] == name.strip().lower()
    if unitless and stamps[0] > 2e4 and stamps[-1] < 8e4 and not (4 * stamps % 1).any():
        return (
            f"{what} is read as seconds: call it 'date' where these are Excel's serial days, "
            "'t [s]' where they are not"
        )
    return ""


def _serial_days(what: str, name: str, column: Column) -> Array | None:
    """Return a column of Excel's serial days, since 1899-12-30; None for other stamps.

    They are numbers from 20,000 to 80,000 (1954 to 2119) in a column called date or datetime, or
    in another column without a unit whose steps are a common sampling time in days. Raises
    ValueError for numbers in a column of dates that cannot be seconds since 1970 either.
    """
    dated = name.strip().lower() in ("date", "datetime")
    if not has_number(column) or time_name(name)[0] != name.strip().lower():
        return None
    days = numbers(what, column)
    require_finite(what, days[:, None])
    if ((days > 2e4) & (days < 8e4)).all():
        return days if dated or _steps_in_days(days) else None
    if not dated or (days > 1e8).all():
        return None
    raise ValueError(
        f"{what} must hold dates, Excel's serial days or seconds since 1970, or name its unit as "
        f"in 'date [s]': row 0 holds {days[0]:.10g}"
    )


def _steps_in_days(stamps: Array) -> bool:
    """Return whether the step of stamps is a common sampling time in days: 0.0416667 is an hour.

    Stamps with four decimals or fewer are taken for seconds.
    """
    unit, steps = _last_place(stamps), np.diff(stamps)
    if unit > 1e-5 or steps.min() <= 0:
        return False
    span = 86400 * (stamps[-1] - stamps[0])
    count = np.rint(span / (86400 * np.median(steps)))
    uncertain = 1e-6 + 2 * 86400 * unit / span
    off = min(abs(span / count / step - 1) for step in _CLOCK_STEPS)
    return bool(off < uncertain < 1e-3)


def _seconds_of_days(days: Array) -> tuple[Array, float, pd.Timestamp]:
    """Convert serial days to the result of `_seconds`."""
    # Excel resolves milliseconds.
    first = pd.Timestamp("1899-12-30") + pd.Timedelta(round(8.64e7 * days[0]), unit="ms")
    grain = max(_last_place(days), 2 * float(np.spacing(days.max())))
    return (days - days[0]) * 86400, grain * 86400, first


def _seconds(what: str, name: str, column: Column) -> tuple[Array, float, pd.Timestamp | None]:
    """Return stamps in s, (time,), the resolution of their number type, and the date of 0 s."""
    if is_timedelta64_dtype(column):
        column = column.dt.total_seconds()
    if has_number(column):
        values, unit = numbers(what, column), time_name(name)[1]
        require_finite(what, values[:, None])
        if abs(values[0]) * unit > 1e11:
            raise ValueError(f"{what} must be in seconds, or name its unit as in 't [ms]'")
        kind = np.float32 if column.dtype == np.float32 else np.float64
        grain = 2 * float(np.spacing(kind(np.abs(values).max())))
        return values * unit, grain * unit, None
    _check_zones(what, column)
    dates = _dates(column)
    if (bad := np.flatnonzero(dates.isna())).size:
        cell = str(column.iloc[bad[0]])[:40]
        raise ValueError(f"{what} must hold numbers or dates: row {bad[0]} holds {cell!r}")
    first = dates.iloc[0].as_unit("ns")
    # pandas adds today's date to a time without a date; here it is counted from midnight.
    of_day = _TIME_OF_DAY.match(str(column.iloc[0])) is not None
    since = dates - (first.normalize() if of_day else first)
    seconds = np.asarray(since / pd.Timedelta(1, unit="s"), dtype=np.float64)
    return seconds, 0.0, None if of_day else _in_its_zone(first, column)


def _dates(column: Column) -> pd.Series:
    """Parse dates in UTC, NaT where that fails: day or month first, whichever parses more cells.

    If both parse, as in the first days of a month, the more even step decides. If that is equal
    too, dates written with dots are read day first, others month first.
    """
    dotted = _DOTTED.match(str(column.iloc[0])) is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tries = [pd.to_datetime(column, format="ISO8601", utc=True, errors="coerce")]
        tries += [
            pd.to_datetime(column, dayfirst=day_first, utc=True, errors="coerce")
            for day_first in (dotted, not dotted)
        ]

    def doubt(parsed: pd.Series) -> tuple[int, float]:
        """Return the number of missing dates, and the unevenness of the steps (relative)."""
        steps = parsed.dropna().diff().dropna().dt.total_seconds()
        usual = abs(steps.median()) or 1.0
        uneven = round(float((steps - usual).abs().max() / usual), 2) if len(steps) else 0.0
        return int(parsed.isna().sum()), uneven

    return min(tries, key=doubt)


def _check_zones(what: str, column: Column) -> None:
    """Raise ValueError where some dates have a time zone and others have none."""
    texts = column.astype(str)
    zoned = texts.str.contains(_ZONE)
    if zoned.any() and not zoned.all():
        row, other = int(zoned.argmax()), int(zoned.argmin())
        raise ValueError(
            f"{what} must have a time zone in all rows or in none: row {row} holds "
            f"{texts.iloc[row]!r}, row {other} {texts.iloc[other]!r}"
        )


def _in_its_zone(date: pd.Timestamp, column: Column) -> pd.Timestamp:
    """Convert a date that was read as UTC to the time zone of its column, if that has one.

    Tables and messages then show dates as the file does.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        zone = pd.to_datetime(column.iloc[:1]).dt.tz
    return date.tz_convert(zone) if zone is not None else date.tz_localize(None)


def _even_grid(what: str, stamps: Array, unit: float, masked: bool) -> tuple[float, float]:
    """Return the step and the first stamp of an even grid, in s; see `reading.read` for tolerances.

    `unit` is one unit in the last place of the stamps, in s.
    """
    steps = np.diff(stamps)
    if (back := np.flatnonzero(steps <= 0)).size:
        before, after = stamps[back[0] : back[0] + 2]
        raise ValueError(
            f"{what} must increase: row {back[0] + 1} ({after:.10g} s) follows {before:.10g} s"
        )
    median, mean = float(np.median(steps)), float(steps.mean())
    if unit > 0.99 * median:  # rounding this coarse could hide a missing row
        unit = 0.0
    line = np.abs(stamps - stamps[0] - mean * np.arange(len(stamps)))[1:]
    rounded = np.maximum(np.abs(steps - mean), line) < 0.999 * unit
    off = np.abs(steps - median)
    if (bad := np.flatnonzero((off > 0.01 * median) & ~rounded)).size:
        gaps = bad[off[bad] > 1.001 * unit]  # report true gaps first: they shift the other rows
        row = int((gaps if gaps.size else bad)[0]) + 1
        raise ValueError(
            f"{what} must be even: expected a step of {median:.6g} s at row {row}, found "
            f"{steps[row - 1]:.6g} s; time_column='' (--time-column '') ignores the stamps"
            + (", gaps='mask' (--gaps mask) allows for missing rows" if not masked else "")
        )
    centred = np.arange(len(stamps)) - 0.5 * len(steps)
    # The slope of a fitted line, which averages out the rounding of the stamps.
    slope = centred @ (stamps - stamps[0]) / (centred @ centred)
    step = float(f"{slope:.12g}")
    beside = stamps - stamps[0] - step * np.arange(len(stamps))
    first = float(beside.mean())  # where the grid begins, after the first stamp
    wander = np.abs(beside - first)
    if wander.max() > 0.5 * (step + unit):
        raise ValueError(
            f"{what} must be even: its stamps wander by {wander.max() / step:.2g} samples from an "
            f"even step of {step:.6g} s, at row {int(wander.argmax())}; time_column='' "
            "(--time-column '') ignores the stamps"
        )
    if abs(first) < 1e-6 * step:
        return step, float(stamps[0])
    # Rounded to a tenth of the last printed place, the resolution of the stamps.
    digits = 0.1 * unit or 1e-6 * step
    return step, float(np.rint((stamps[0] + first) / digits) * digits)


def _on_grid(what: str, stamps: Array) -> tuple[NDArray[np.int_], Array]:
    """Return each stamp's row on the grid without gaps, `(time,)`, and the stamps of all rows.

    For evenly rising stamps the rows are 0, 1, 2... A logger may restart at any time after a gap:
    its stamps are then moved to the closest rows of the grid that begins at the first stamp, so
    that rows do not drift away from the stamps over many gaps.

    Raises ValueError if more than `MOST_MISSING` of the rows are missing: a stamp is then probably
    wrong.
    """
    steps = np.diff(stamps)
    if not len(steps) or steps.min() <= 0:  # `_even_grid` raises an error that names the row
        return np.arange(len(stamps)), stamps
    usual = float(np.quantile(steps, 0.1))  # the smallest steps may be jitter
    usual = float(steps[steps < 1.75 * usual].mean())  # stamps may be rounded to few units
    missing = float(np.maximum(np.rint(steps / usual) - 1, 0).sum())
    if missing > MOST_MISSING * (missing + len(stamps)):
        worst = int(np.argmax(steps))
        raise ValueError(
            f"{what} must have a stamp for one row in ten at least: {missing:.0f} rows of "
            f"{usual:.6g} s are missing, most of them after row {worst}"
        )
    gap = np.rint(steps / usual) > 1
    index = np.arange(len(stamps))
    if not gap.any():
        return index, stamps
    begins = np.concatenate([[0], np.flatnonzero(gap) + 1])  # first rows of the stretches
    stretch = np.concatenate([[0], np.cumsum(gap)])
    closest = np.rint((stamps[begins] - stamps[0]) / usual).astype(int)
    rows = closest[stretch] + index - begins[stretch]
    rows = np.maximum.accumulate(rows - index) + index  # so that no two samples share a row
    even = np.where(gap, usual * np.diff(rows), steps)
    joined = stamps[0] + np.concatenate([[0.0], np.cumsum(even)])
    return rows, np.asarray(np.interp(np.arange(rows[-1] + 1), rows, joined))


def _last_place(stamps: Array) -> float:
    """Return the unit of the last printed decimal place; 0 if it is beyond 1e-9."""
    for places in range(10):
        scaled = stamps * 10.0**places
        tolerance = max(1e-6, 2 * np.spacing(np.abs(scaled).max()))
        if np.abs(scaled - np.rint(scaled)).max() < tolerance:
            return 10.0**-places
    return 0.0
