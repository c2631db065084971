"""Read time stamps, as numbers, dates or times of the day, and tell what else they may mean."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype, is_timedelta64_dtype

from splitband.records.signals import (
    Column,
    below_samples,
    has_number,
    hint_for,
    in_file,
    is_text,
    numbers,
    require_finite,
)
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

TIME_NAMES = ("time", "timestamp", "datetime", "t", "date")
_PARTS, _HOURS = (1, 2, 3, 4, 5, 6, 10, 12, 15, 20, 30, 45), (1, 2, 3, 6, 12, 24)
_SHORT = 0.01, 0.02, 0.05, 0.1, 0.2, 0.25, 0.5
_CLOCK_STEPS = (*_SHORT, *_PARTS, *(60 * n for n in _PARTS), *(3600 * n for n in _HOURS))
"""Common sampling times, in seconds, of loggers that count in days."""
_DAY = 86400.0
_YEAR = 365.25 * _DAY
_UNITS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nanos", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
    **dict.fromkeys(("h", "hr", "hrs", "hour", "hours"), 3600.0),
    **dict.fromkeys(("day", "days"), _DAY),
}
_UNIT = re.compile(rf"(?:^|[\s_./({{\[-]+)({'|'.join(_UNITS)})[)\]}}._]*$")
_AROUND = re.compile(r"^(?:[\w\[\]]+\.)+(?=\w+$)|^[%#_\s]+|[\s,(\[]+(?:utc|gmt)[\d:+-]*[)\]]?$")
"""What a name has around the word for time: fields of structures, marks, a time zone."""
_TIME_OF_DAY = re.compile(
    r"\s*\d{1,2}:\d\d(?::\d\d)?(?:[.,]\d+)?"
    r"(?:\s*[AaPp]\.?[Mm]\.?)?(?:\s*(?:Z|UTC|GMT|[+-]\d\d:?\d\d))?\s*"
)
_ZONE = re.compile(r":\d\d(?:[.,]\d+)?\s*(?:Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)\s*$")
_DOTTED = re.compile(r"\s*\d{1,2}\.\d{1,2}\.\d")
_DOTTED_TIME = re.compile(r"^([01]?\d|2[0-3])\.([0-5]\d)\.([0-5]\d)\b(?!\.\d*\.)")
_BRACKETS = re.compile(r"[(\[]([^()\[\]]*[^()\[\]\d][^()\[\]]*)[)\]]$")
_DECIMAL = re.compile(r"(?<=:\d\d),(?=\d)|(?<=:\d\d:\d\d):(?=\d{3})")
"""A comma or a third colon before the fraction of a second."""
_SHORT_YEAR = re.compile(r"\s*\d\d([-/])\d\d\1\d\d\b")
_EITHER_SIGN = re.compile(r"(?:UTC|GMT)\s*[+-]\d")
"""A zone that some write as hours east of Greenwich, and others, as POSIX does, west of it."""
_DURATION = re.compile(
    r"[-+]?(?:\d+ days?,? [-+]?)?\d+:\d\d(?::\d\d)?(?:\.\d*)?"
    r"|(?:[-+]?\d+(?:\.\d+)?\s*[a-zµμ]+\s*)+|[-+]?P[\dTDHMS.]+",
    re.IGNORECASE,
)
_NO_TIME = re.compile(r"[ T]00:00(:00)?(\.0+)?$")
_DAY_END = re.compile(r"(?<![\d:.])24(?=(?::00)+(?:\.0+)?(?![:.\d]))")
"""The hour of the midnight that ends a day, 24:00."""
_NO_YEAR = re.compile(r"^\s*(\d{1,2})([-/.])(\d{1,2})\.?\s+(?=\d{1,2}:\d\d)")
_SERIAL_DAYS = {
    "Excel's serial days": 25569.0,
    "MATLAB's serial days": 719529.0,
    "Julian days": 2440587.5,
}
"""Number of the first of January 1970."""
_FINER = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_STEPS_IN_MS = (8, 10, 16, 17, 20, 25, 33, 40, 50, 100, 125, 200, 250, 500)
"""Common sampling times of loggers in whole milliseconds, other than usual ones in seconds."""
_SHOWING = 100
"""Cells that show what a column holds. Bounds the time."""
_DIGITS = "%Y%m", "%Y%m%d", "%y%m%d%H%M", "%Y%m%d%H", "%Y%m%d%H%M", "%Y%m%d%H%M%S"
"""Dates that are written as one number."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Hold one meaning of a column of time stamps, `words`: as `seconds` since a `date`, if any.

    `grain`: resolution of their number type, in s; `note`: what a user should know of the reading;
    `certain`: whether it leaves no room for seconds.
    """

    words: str
    seconds: Array
    grain: float = 0.0
    date: pd.Timestamp | None = None
    note: str = ""
    certain: bool = False

    @property
    def step(self) -> float:
        """Return the median step in s."""
        return float(np.median(np.diff(self.seconds)))


def time_name(column: str) -> tuple[str, float | None]:
    """Split a name such as "Time [ms]" into "time" and its unit in seconds, None without one."""
    name = _AROUND.sub("", column.strip().lower())
    unit = _UNIT.search(name)
    word = name[: unit.start()] if unit else name
    return re.sub(r"(?<=date|time)[\s_/&-]+(?=time|stamp)", "", word), unit and _UNITS[unit[1]]


def is_time(column: str) -> bool:
    """Return whether a column is called time, timestamp, datetime, t or date."""
    return time_name(column)[0] in TIME_NAMES


def also_time(name: str, column: Column) -> bool:
    """Return whether a column beside the time stamps tells the time, too.

    Its name is one of a time column, or contains a word for time ("time_2", "elapsed time") and its
    values increase from row to row: T may also be a temperature.
    """
    word, words = time_name(name)[0], set(re.findall("[a-z]+", name.lower()))
    if word in TIME_NAMES and word != "t":
        return True
    if not (word == "t" or words & {*TIME_NAMES, "stamp"} - {"t"}) or not has_number(column):
        return False
    values = pd.to_numeric(column, errors="coerce").dropna().to_numpy(dtype=np.float64)
    return len(values) > 1 and bool((np.diff(values) > 0).all())


def holds_dates(column: Column) -> bool:
    """Return whether the first cells of a column are dates in order, in words."""
    first = column.iloc[:_SHOWING]
    if not len(first) or not is_text(first) or has_number(first) or first.isna().any():
        return False
    with suppress(InputError):
        found = _of_dates("", first)
        return found.date is not None and bool((np.diff(found.seconds) > 0).all())
    return False


def is_day(column: Column) -> bool:
    """Return whether a column begins with a date without a time."""
    return ":" not in _NO_TIME.sub("", str(column.iloc[0]))


def is_time_of_day(column: Column) -> bool:
    """Return whether a column holds times without a date: 20:00, 8.00.00 PM."""
    first = str(column.iloc[0]).strip()
    return bool(_TIME_OF_DAY.fullmatch(first) or _DOTTED_TIME.match(first))


def is_clock_number(name: str, column: Column) -> bool:
    """Return whether numbers without a unit can be times of the day, such as 930 or 93000."""
    if time_name(name)[1] is not None or not is_numeric_dtype(column):
        return False
    digits = (column % 100 < 60) & (column // 100 % 100 < 60) & column.between(0, 240000)
    return bool(((column % 1 == 0) & digits).all())


def joined(date: Column, time: Column) -> Column:
    """Return the dates of one column with the times of the day of another."""
    missing = date.isna() | time.isna()
    days = date.astype(str).str.strip().str.replace(_NO_TIME, "", regex=True)
    times = time.astype(str).str.strip().str.replace(_DOTTED_TIME, r"\1:\2:\3", regex=True)
    return (days + " " + times).mask(missing)


def readings(what: str, name: str, column: Column) -> list[Reading]:
    """Return what time stamps may mean; one reading if that is certain."""
    if is_timedelta64_dtype(column):
        column = column.dt.total_seconds()
        return [Reading("seconds", numbers(what, column))]
    if has_number(column):
        values = numbers(what, column)
        if hint := below_samples(np.flatnonzero(~np.isfinite(values)), len(values)):
            raise InputError(f"{what} is empty in the last rows{hint}")
        require_finite(what, values[:, None])
        kind = np.float32 if column.dtype == np.float32 else np.float64
        return _of_numbers(what, name, values, 2 * float(np.spacing(kind(np.abs(values).max()))))
    if time_name(name)[0] not in ("date", "datetime") and (dotted := _of_dotted(what, column)):
        return dotted
    return _of_clock(column) or [_of_dates(what, column)]


def _of_numbers(what: str, name: str, values: Array, grain: float) -> list[Reading]:
    word, unit = time_name(name)
    scale = 1.0 if unit is None else unit
    dated = word in ("date", "datetime")
    others = list(_beside_seconds(values, grain, dated)) if unit is None else []
    days = 1e-6 * values  # from 2000 on: WinCC calls millionths of a day ms
    if unit == 1e-3 and days.min() > 36525 and days.max() < 80000:
        return [_of_days("millionths of Excel's serial days", days, 25569.0, True)]
    if certain := [each for each in others if each.certain]:
        return certain[:1]
    if unit is None and (found := _BRACKETS.search(_AROUND.sub("", name.strip().lower()))):
        raise InputError(
            f"{what} has a unit that is not known, {found[1]!r}, other than 't [ms]': "
            "time_column='' (--time-column '') with sampling_time (--sampling-time) ignores it"
        )
    if abs(values[0]) * scale > 1e11:
        raise InputError(f"{what} must be in seconds, or name its unit as in 't [ms]'")
    if dated and unit is None and not others and not (values > 1e8).all():
        raise InputError(
            f"{what} must hold dates, Excel's serial days or seconds since 1970, or name its unit "
            f"as in 'date [s]': row 0 holds {values[0]:.10g}"
        )
    if scale > 1:  # rounded in this unit, not in seconds
        grain = max(grain, last_place(values))
    return [Reading("seconds", values * scale, grain * scale), *others]


_READ_AS_SECONDS = 3, 4, 6, 12
"""Steps in minutes that are not taken for fractions of a day: a day has 480, 360, 240 or 120 of
them, so that loggers at as many Hz write the same numbers, in seconds."""


def _beside_seconds(values: Array, grain: float, dated: bool) -> Iterator[Reading]:
    """Yield what numbers without a unit may mean other than seconds."""
    step, exact = float(np.median(np.diff(values))), last_place(values) > 1e-5
    common = _steps_in_days(values)
    # Rounded to five decimals, a common step of a day may be that of 24, 48, 72, 96 or 144 Hz.
    fine = last_place(values) < 0.9e-5
    if common and fine and 0 <= values[0] < 1 and round(1440 * step) not in _READ_AS_SECONDS:
        yield Reading("fractions of a day", values * _DAY, last_place(values) * _DAY)
    for words, unit in _FINER.items():
        since = values * unit
        if since.min() > 9.4e8 and since.max() < 2.5e9:  # years 2000 to 2049
            first = pd.Timestamp(since[0], unit="s").round("ms")
            note = f"is read as {words} since 1970, from {first} on"
            yield Reading(words, since, grain * unit, None, note, True)
    yield from _of_digits(values, dated)
    for words, of_1970 in _SERIAL_DAYS.items():
        since_1970 = values - of_1970
        if since_1970.min() > -5569 and since_1970.max() < 54431:  # 1954 to 2119
            certain = dated or (common and not exact)
            if certain or common or (not exact and of_1970 > 1e5):  # steps of any length
                yield _of_days(words, values, of_1970, certain)
    parts = _is_whole(step, 1, 4, 12, 52, 365.25) or (not exact and _is_whole(step, 8766))
    if values.min() >= 1700 and values.max() <= 2100 and parts:
        yield Reading("years", (values - values[0]) * _YEAR, grain * _YEAR)
    odd = step > 999 and not (_is_whole(_DAY / step) or _is_whole(step / _DAY))
    in_ms = step in _STEPS_IN_MS and last_place(values) == 1
    for words in ("milliseconds", "microseconds")[: 2 if odd else int(in_ms)]:
        if values[0] < 9.4e8:
            yield Reading(words, values * _FINER[words], grain * _FINER[words])


def _is_whole(number: float, *factors: float) -> bool:
    """Return whether the number, times one of the factors (default 1), is about 1, 2, 3, ..."""
    products = [number * factor for factor in factors or (1,)]
    return any(each > 0.5 and abs(each - round(each)) < 0.02 for each in products)


def _of_digits(values: Array, dated: bool) -> Iterator[Reading]:
    """Yield the reading of numbers such as 20240131 as dates, if they are dates."""
    digits = len(f"{values[0]:.0f}")
    forms = [form for form in _DIGITS if len(form) + 2 * form.count("%Y") == digits]
    if not forms or (values % 1).any() or values.max() > 1e14:
        return
    written = pd.Series(values.astype(np.int64)).astype(str)
    for form in forms:
        dates = pd.to_datetime(written, format=form, errors="coerce")
        if dates.dt.year.between(1900, 2100).all():
            since = np.asarray((dates - dates[0]).dt.total_seconds(), np.float64)
            first, certain = dates[0].as_unit("ns"), dated or values[0] > 1e11
            yield Reading(f"dates from {first:%Y-%m-%d} on", since, 0.0, first, certain=certain)


def _of_days(words: str, days: Array, of_1970: float, certain: bool) -> Reading:
    milliseconds = round(_DAY * 1e3 * (days[0] - of_1970))  # which Excel resolves
    first = pd.Timestamp(milliseconds, unit="ms").as_unit("ns")
    grain = max(last_place(days), 2 * float(np.spacing(days.max())))
    note = f"holds {words}, read as dates from {first}"
    return Reading(words, (days - days[0]) * _DAY, grain * _DAY, first, note, certain)


def _steps_in_days(stamps: Array) -> bool:
    """Return whether the step of stamps is a common sampling time in days: 0.0416667 is an hour."""
    steps = np.diff(stamps)
    if steps.min() <= 0:
        return False
    span = _DAY * (stamps[-1] - stamps[0])
    count = np.rint(span / (_DAY * np.median(steps)))
    uncertain = 1e-6 + 2 * _DAY * last_place(stamps) / span
    off = min(abs(span / count / step - 1) for step in _CLOCK_STEPS)
    return bool(off < 1e-6 or off < uncertain < 1e-3)


def _of_clock(column: Column) -> list[Reading]:
    """Return the readings of times without a date, 23:59:59.5, 59:59.5 or 0.5 sec, if they are."""
    if len(column) > 1 and not _of_clock(column.iloc[:1]):
        return []
    text = column.astype(str).str.strip().str.replace(_DECIMAL, ".", regex=True)
    short = text.str.fullmatch(r"\d+:\d\d(?:\.\d+)?")
    long = _seconds(text.where(~short, "00:" + text))  # 59:59, 1:00:00
    if np.isnan(long).any():
        return []
    if not short.all():
        return [Reading("times of the day", _unwrapped(long, _DAY))]
    minutes = Reading("minutes and seconds", _unwrapped(long, 3600.0))
    if np.isnan(hours := _seconds(text + ":00")).any():  # a fraction
        return [minutes]
    return [Reading("hours and minutes", _unwrapped(hours, _DAY)), minutes]


def _seconds(text: Column) -> Array:
    """Return durations in seconds, NaN for others."""
    # pandas takes much else for a duration: 02.03.2024 10:00 for two hours.
    durations = text.where(text.str.fullmatch(_DURATION))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = pd.to_timedelta(durations, errors="coerce")
    return np.asarray(found.dt.total_seconds(), dtype=np.float64)


def _of_dotted(what: str, column: Column) -> list[Reading]:
    """Return what stamps such as 10.12.24 may mean: a time of the day, a date; [] for others."""
    texts = column.astype(str).str.strip()
    if not texts.str.match(_DOTTED_TIME).all():
        return []
    clock = _of_clock(texts.str.replace(_DOTTED_TIME, r"\1:\2:\3", regex=True))
    return clock + ([] if _dates(texts)[0].isna().any() else [_of_dates(what, texts)])


def _unwrapped(seconds: Array, period: float) -> Array:
    """Return the times of a clock that begins again at 0, at midnight or the hour, going on."""
    again = np.cumsum(np.diff(seconds, prepend=seconds[0]) < -0.5 * period)
    return np.asarray(seconds + period * again)


def _of_dates(what: str, column: Column) -> Reading:
    _check_zones(what, column)
    if is_text(column):
        column = column.astype(str).str.replace(_DECIMAL, ".", regex=True)
    if yearless := is_text(column) and column.str.match(_NO_YEAR).all():
        column = column.str.replace(_NO_YEAR, r"\1\2\3\g<2>2001 ", regex=True)
    dates, note = _dates(column)
    dates = dates.where(dates.dt.year.between(1700, 2200))  # what nanoseconds can hold
    if (bad := np.flatnonzero(dates.isna())).size:
        cell = str(column.iloc[bad[0]])[:40]
        raise InputError(
            f"{what} must hold numbers or dates: row {bad[0]} holds {cell!r}"
            f"{in_file(column, bad[0])}{hint_for(what, cell)}{below_samples(bad, len(column))}"
        )
    first = dates.iloc[0].as_unit("ns")
    # pandas adds today's date to a time without a date; here it is counted from midnight.
    of_day = _TIME_OF_DAY.fullmatch(str(column.iloc[0])) is not None
    midnight = first.normalize()
    since = dates - (
        midnight.replace(month=1, day=1) if yearless else midnight if of_day else first
    )
    seconds = np.asarray(since / pd.Timedelta(1, unit="s"), dtype=np.float64)
    if of_day:
        return Reading("times of the day", _unwrapped(seconds, _DAY))
    if yearless:
        note = f"has no year: it is read as seconds since 1 January, from {first:%d %B} on"
        return Reading("dates without a year", _unwrapped(seconds, 365 * _DAY), note=note)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        zone = pd.to_datetime(column.iloc[:1]).dt.tz  # which tables and messages show
    date = first.tz_convert(zone) if zone is not None else first.tz_localize(None)
    return Reading("dates", seconds, date=date, note=note)


def _dates(column: Column) -> tuple[pd.Series, str]:
    """Parse dates in UTC, NaT where that fails, in the order of which more cells are dates.

    Of two such orders, as in the first days of a month, the one of more even steps; else dates with
    dots are read day first, others month first, which the note says.
    """
    first = str(column.iloc[0])
    dotted = _DOTTED.match(first) is not None
    orders: list[dict[str, Any]] = [{"dayfirst": dotted}, {"dayfirst": not dotted}]
    orders += [{"yearfirst": True}] if _SHORT_YEAR.match(first) else []

    def parsed(**order: Any) -> pd.Series:
        return pd.to_datetime(column, utc=True, errors="coerce", **order)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        iso = parsed(format="ISO8601")
        if iso.notna().all():
            return iso, ""
        late = pd.to_timedelta((texts := column.astype(str)).str.contains(_DAY_END) * 1, unit="D")
        column = texts.str.replace(_DAY_END, "00", regex=True)
        tries = [parsed(**order) + late for order in ({"format": "ISO8601"}, *orders)]

    def doubt(dates: pd.Series) -> tuple[int, float]:
        """Return the number of missing dates, and the unevenness of the steps (relative)."""
        steps = dates.dropna().diff().dropna().dt.total_seconds()
        usual = abs(steps.median()) or 1.0
        uneven = round(float((steps - usual).abs().max() / usual), 2) if len(steps) else 0.0
        return int(dates.isna().sum()), uneven

    best = min(tries, key=doubt)
    others = {e.iloc[0] for e in tries[1:] if doubt(e) == doubt(best)} - {best.iloc[0]}
    if dotted or best.isna().any() or not others:
        return best, ""
    return best, (
        f"is read as dates from {best.iloc[0]:%Y-%m-%d} on; with day, month and year in another "
        f"order they begin on {' or '.join(f'{other:%Y-%m-%d}' for other in sorted(others))}"
    )


def _check_zones(what: str, column: Column) -> None:
    """Raise ValueError where only some dates have a time zone, or where its sign is not clear."""
    texts = column.astype(str)
    if (unclear := texts.str.contains(_EITHER_SIGN)).any():
        row = int(unclear.argmax())
        raise InputError(
            f"{what} must have a time zone of one meaning, +01:00 for an hour east of Greenwich: "
            f"row {row} holds {texts.iloc[row]!r}"
        )
    zoned = texts.str.contains(_ZONE)
    if zoned.any() and not zoned.all():
        row, other = int(zoned.argmax()), int(zoned.argmin())
        raise InputError(
            f"{what} must have a time zone in all rows or in none: row {row} holds "
            f"{texts.iloc[row]!r}, row {other} {texts.iloc[other]!r}"
        )


def last_place(stamps: Array) -> float:
    """Return the unit of the last printed decimal place; 0 if it is beyond 1e-9."""
    for places in range(10):
        scaled = stamps * 10.0**places
        tolerance = max(1e-6, 2 * np.spacing(np.abs(scaled).max()))
        if np.abs(scaled - np.rint(scaled)).max() < tolerance:
            return 10.0**-places
    return 0.0
