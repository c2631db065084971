"""Define time stamps and even grids of them, and find the grid that measured stamps lie on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from splitband.records.rates import jitter, own_step
from splitband.records.remedies import IGNORE, Table, remedy
from splitband.records.signals import Column, Gaps, as_float, in_file, stretches
from splitband.records.stamps import last_place, readings
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

MOST_MISSING = 0.9
"""Share of a record's rows that may be missing between its time stamps. By eye."""
FEWEST_SPREAD = 3
"""Fewest rows missing at even distances that may be no missing rows, but rounded stamps.

Rows that are lost at random lie like this with a chance of 1 for one row, 0.35 for two, and 0.05
(15 rows) to 0.002 (1000 rows) for three.
"""
_RESOLUTIONS = (60.0, 3600.0, 86400.0)
"""Of stamps that show no seconds, no minutes or no time of the day, in s."""


class UnevenError(InputError):
    """Report time stamps that are not even, and that an even grid (`step`) would mend."""


Stamp: TypeAlias = float | pd.Timestamp
"""Seconds on the clock of a record, or a date, with a time zone or without."""


def as_stamp(value: Any) -> Stamp:
    """Check a time stamp; raises ValueError unless it is a finite number or a date."""
    if isinstance(value, datetime | np.datetime64) and not pd.isna(value):
        return pd.Timestamp(value).as_unit("ns")
    if math.isnan(seconds := as_float(value)):
        raise InputError(f"a time stamp must be a finite number of seconds or a date: got {value}")
    return seconds


def as_json(stamp: Stamp | None) -> float | str | None:
    """Return the time stamp for JSON: a date in ISO 8601."""
    return stamp.isoformat() if isinstance(stamp, pd.Timestamp) else stamp


def stamp_after(stamp: Stamp, seconds: float) -> Stamp:
    """Return the time stamp this many seconds later."""
    if isinstance(stamp, pd.Timestamp):
        return stamp + pd.Timedelta(round(1e9 * seconds), unit="ns")
    return stamp + seconds


def seconds_between(first: Stamp, second: Stamp) -> float:
    """Return how much later the second time stamp is, in s."""
    one: Any = first
    try:
        later = second - one
    except TypeError:
        rule = "time stamps that are put together must all be dates or all be in seconds"
        if zones_differ(first, second):
            rule = "dates that are put together must all have a time zone, or none"
        raise InputError(f"{rule}: got {in_words(first)} and {in_words(second)}") from None
    return float(later / pd.Timedelta(1, unit="s") if isinstance(later, pd.Timedelta) else later)


def zones_differ(first: Stamp | None, second: Stamp | None) -> bool:
    """Return whether both are dates and only one of them has a time zone."""
    dates = isinstance(first, pd.Timestamp) and isinstance(second, pd.Timestamp)
    return dates and (first.tzinfo is None) != (second.tzinfo is None)  # type: ignore[union-attr]


def seconds_of(stamp: Stamp | None) -> float:
    """Return the time stamp in s for a simulator; 0 for a date or None."""
    return stamp if isinstance(stamp, float) else 0.0


def in_words(stamp: Stamp) -> str:
    """Format the time stamp for a message."""
    return str(stamp) if isinstance(stamp, pd.Timestamp) else f"{stamp:.10g} s"


def stamps_at(start: Stamp, step: float, rows: NDArray[np.int_]) -> Array | pd.DatetimeIndex:
    """Return the stamps of rows from `start` on; seconds are rounded to a millionth of a step."""
    if isinstance(start, pd.Timestamp):
        return start + pd.to_timedelta(np.rint(1e9 * step * rows).astype(np.int64), unit="ns")
    return np.round(start + step * rows, max(0, 6 - math.floor(math.log10(step))))


def near_sampling(step: float, other: float) -> bool:
    """Return whether two steps differ by 1 % at most, as records of one system may."""
    return abs(step - other) <= 0.01 * other


def whole_multiple(step: float, other: float) -> bool:
    """Return whether a step is another one, or two, three, ... of them, to 1 %."""
    return step > 0.5 * other and near_sampling(step, round(step / other) * other)


def same_sampling(step: float, other: float, samples: int) -> bool:
    """Return whether two grids with the same start and length end within half a step."""
    return abs(step - other) * samples < 0.5 * min(step, other)


@dataclass(frozen=True)
class Grid:
    """Represent a grid of evenly spaced times.

    start : Time stamp of the first sample; None if unknown.
    step : Sampling time in s.
    samples : Number of samples.
    """

    start: Stamp | None
    step: float
    samples: int

    def after(self, samples: int) -> Grid:
        """Return the grid of so many samples that continues this one."""
        start = None if self.start is None else stamp_after(self.start, self.samples * self.step)
        return Grid(start, self.step, samples)

    def __str__(self) -> str:
        """Return the first and the last time stamp in words."""
        if self.start is None:
            return f"{self.samples} samples every {self.step:.7g} s"
        end = stamp_after(self.start, (self.samples - 1) * self.step)
        return f"{in_words(self.start)} to {in_words(end)}"


@dataclass(frozen=True, eq=False)
class Times:
    """Hold the times of the rows of a file, oldest first: `seconds`, since a `date` if any.

    `what`: the column in messages; `column`: its cells; `grain`: resolution of their number type in
    s; `newest_first`: whether the rows of the file are reversed; `note`: how the stamps were
    interpreted, if that is not certain; `todo`: what to do about stamps that are not even, in
    words, after what is usual.
    """

    what: str
    column: Column
    seconds: Array
    grain: float
    date: pd.Timestamp | None
    newest_first: bool
    note: str
    todo: Callable[[str], str]

    def stamp(self, seconds: float) -> Stamp:
        """Return these seconds as a stamp of the file's clock."""
        return seconds if self.date is None else stamp_after(self.date, seconds)

    def check_increasing(self, repeated: bool = False, gaps: Gaps = "refuse") -> None:
        """Raise ValueError for stamps that do not increase; some may be `repeated`."""
        steps, stamps = np.diff(self.seconds), self.seconds
        if (back := np.flatnonzero(steps < 0 if repeated else steps <= 0)).size:
            row = int(back[0]) + 1
            place = in_file(self.column, row) if gaps == "refuse" else ""
            raise InputError(
                f"{self.what} must increase: row {row} ({stamps[row]:.10g} s) follows "
                f"{stamps[row - 1]:.10g} s{place}; {self.todo('')}"
            )


@dataclass(frozen=True, eq=False)
class Spacing:
    """Describe the even grid that the rows of a file lie on: its step in s and its start, if known.

    `grid_rows`: grid index of each row of the file, `(time,)`, None if no rows are missing;
    `jitter`: the largest deviation of a step of the stamps, in s.
    """

    step: float
    start: Stamp | None = None
    grid_rows: NDArray[np.int_] | None = None
    jitter: float = 0.0


def times_of(
    what: str, column: Column, expected: float | None, table: Table, names: list[str]
) -> Times:
    """Return the times of a column of stamps; `expected` is the sampling time that a user gave.

    They are in the columns `names` of a `table`, whose others may tell what is wrong with them.
    """
    found = readings(what, names[0], column)
    newest_first = found[0].step < 0
    if newest_first:
        column = column.iloc[::-1]
        found = readings(what, names[0], column)
    found = [each for each in found if (np.diff(each.seconds) > 0).all()] or found[:1]
    if expected:  # readings differ by more than jitter does
        found.sort(key=lambda each: abs(math.log(max(each.step, 1e-300) / expected)))
        found = found[: 1 if 0.7 * expected < found[0].step < 1.4 * expected else None]
    if len(found) > 1:
        ways = [f"{each.words} ({each.step:.6g} s)" for each in found]
        raise InputError(
            f"{what} can be read as {' or as '.join(ways)}: sampling_time (--sampling-time) in "
            f"seconds decides; it holds {column.iloc[0]}, {column.iloc[1]}, ..."
        )
    read = found[0]
    raw = replace(read, seconds=read.seconds[::-1] if newest_first else read.seconds)
    return Times(
        what,
        column,
        read.seconds,
        read.grain,
        read.date,
        newest_first,
        read.note and f"{what} {read.note}",
        partial(remedy, table, names, raw),
    )


def spacing(times: Times, gaps: Gaps, expected: float | None) -> Spacing:
    """Return the even grid that times lie on; `expected` is the sampling time that a user gave."""
    times.check_increasing(gaps=gaps)
    what, stamps = times.what, times.seconds
    rows, cut = np.arange(len(stamps)), _cut_to_units(what, stamps, expected)
    if gaps == "mask":
        rows, stamps = _on_grid(what, stamps, cut)
    unit = cut[1] if cut else max(last_place(times.seconds), times.grain)
    if not cut and unit > 0.99 * np.median(np.diff(stamps)):
        unit = 0.0  # rounding this coarse could hide a missing row
    _check_steps(times, stamps, unit, gaps)
    step, start = _line(what, stamps, unit, times.grain)
    return Spacing(
        step,
        times.stamp(start),
        rows if len(rows) <= rows[-1] else None,
        float(np.abs(np.diff(stamps) - step).max()),
    )


def _check_steps(times: Times, stamps: Array, unit: float, gaps: Gaps) -> None:
    """Raise ValueError for steps that differ by more than 1 % and the `unit` of the last place."""
    steps = np.diff(stamps)
    median, mean = float(np.median(steps)), float(steps.mean())
    line_off = np.abs(stamps - stamps[0] - mean * np.arange(len(stamps)))[1:]
    most = (1.001 + 1 / len(steps)) * unit  # the mean is that of rounded stamps, too
    rounded = np.maximum(np.abs(steps - mean), line_off) < most
    off = np.abs(steps - median)
    exact = 0.01 * median + 4 * float(np.spacing(np.abs(stamps).max()))
    if not (bad := np.flatnonzero((off > exact) & ~rounded)).size:
        return
    lost = bad[off[bad] > 1.001 * unit]  # report true gaps first: they shift the other rows
    row = int((lost if lost.size else bad)[0]) + 1
    refuse = gaps == "refuse"
    mask = "gaps='mask' (--gaps mask) excludes missing rows; " if refuse else ""
    usual = f"{mask}{way_out(times.seconds)}"
    todo = times.todo(usual)
    raise (UnevenError if todo == usual else InputError)(
        f"{times.what} must be even: expected a step of {median:.6g} s at row {row}, found "
        f"{steps[row - 1]:.6g} s{in_file(times.column, row) if refuse else ''}; {todo}"
    )


def way_out(seconds: Array) -> str:
    """Return how to read uneven stamps, with the step that they suggest and their jitter."""
    step = own_step(seconds)
    return (
        f"step={step:g} (--step {step:g}) puts the samples on an even grid: steps differ from that "
        f"by up to {100 * jitter(seconds, step):.2g} %, gaps aside; {IGNORE}"
    )


def _line(what: str, stamps: Array, unit: float, grain: float) -> tuple[float, float]:
    """Return step and begin in s of the line through stamps, which averages out their rounding."""
    index = np.arange(len(stamps))
    centred = index - 0.5 * (len(stamps) - 1)
    slope = centred @ (stamps - stamps[0]) / (centred @ centred)
    plain = float(f"{slope:.3g}")  # taken where the stamps cannot tell it from the slope
    drift = abs(plain - slope) * len(stamps)
    step = plain if drift < max(0.1 * unit, grain) else float(f"{slope:.12g}")
    beside = stamps - stamps[0] - step * index
    first = float(beside.mean())  # where the grid begins, after the first stamp
    wander = np.abs(beside - first)
    if wander.max() > 0.5 * (step + unit):
        raise UnevenError(
            f"{what} must be even: its stamps wander by {wander.max() / step:.2g} samples from an "
            f"even step of {step:.6g} s, at row {int(wander.argmax())}; {way_out(stamps)}"
        )
    if abs(first) < 1e-6 * step:
        return step, float(stamps[0])
    # Rounded to a tenth of the last printed place, the resolution of the stamps.
    digits = 0.1 * unit or 1e-6 * step
    return step, float(np.rint((stamps[0] + first) / digits) * digits)


def _cut_to_units(what: str, stamps: Array, expected: float | None) -> tuple[float, float] | None:
    """Return step and unit of stamps that are cut to units almost as long: 0, 1, 3, 4, 6 s."""
    steps = np.diff(stamps)
    unit = float(steps.min())
    if not (unit < 1.001 * last_place(stamps) or unit in _RESOLUTIONS):
        return None
    begin, end = max(stretches(steps < 2.001 * unit), key=lambda part: part[1] - part[0])
    part = stamps[begin : end + 2]
    lost = round((part[-1] - part[0]) / unit) - (len(part) - 1)
    if lost < FEWEST_SPREAD:
        return None
    index = np.arange(len(part))

    def spread(step: float) -> float:
        return float(np.ptp(part - step * index))

    def explained(step: float) -> bool:
        return spread(step) < 1.001 * unit

    step = float(f"{np.polyfit(index, part, 1)[0]:.3g}")  # a plain one, if it explains the stamps
    if not explained(step):
        bounds, exact = (unit, 2 * unit), 1e-3 * unit / len(part)
        step = scipy.optimize.fminbound(spread, *bounds, xtol=exact)
    if not explained(step):
        return None
    if expected is not None:
        return (expected, unit) if explained(expected) else None
    if 2 * lost >= len(part) - 2:
        return float(step), unit
    raise InputError(
        f"{what} can be read as every {unit:.6g} s with rows missing, {lost} of them at even "
        f"distances, or as every {step:.3g} s, cut to {unit:.6g} s: sampling_time "
        "(--sampling-time) in seconds decides, with gaps='mask' (--gaps mask) for missing rows"
    )


def _on_grid(
    what: str, stamps: Array, cut: tuple[float, float] | None
) -> tuple[NDArray[np.int_], Array]:
    """Return each stamp's row on the grid without gaps, `(time,)`, and the stamps of all rows.

    A logger may restart at any time after a gap: its stamps are then moved to the closest rows of
    the grid that begins at the first stamp, so that rows do not drift away over many gaps.
    """
    steps, index = np.diff(stamps), np.arange(len(stamps))
    usual, unit = cut or (float(np.quantile(steps, 0.1)), 0.0)  # the smallest steps may be jitter
    if not cut:
        usual = float(steps[steps < 1.75 * usual].mean())  # stamps may be rounded to few units
    gap = steps > 2.001 * unit if cut else np.rint(steps / usual) > 1
    missing = float(np.maximum(np.rint(steps / usual) - 1, 0).sum())
    if missing > MOST_MISSING * (missing + len(stamps)):
        raise InputError(
            f"{what} must have a stamp for one row in ten at least: {missing:.0f} rows of "
            f"{usual:.6g} s are missing, most of them after row {int(np.argmax(steps))}; "
            f"{way_out(stamps)}"
        )
    if not gap.any():
        return index, stamps
    begins = np.concatenate([[0], np.flatnonzero(gap) + 1])  # first rows of the stretches
    stretch = np.concatenate([[0], np.cumsum(gap)])
    closest = np.rint((stamps[begins] - stamps[0]) / usual).astype(int)
    rows = closest[stretch] + index - begins[stretch]
    rows = np.maximum.accumulate(rows - index) + index  # so that no two samples share a row
    whole = usual * np.diff(rows)
    even = np.where(gap & (np.abs(steps - whole) > unit), whole, steps)
    joined = stamps[0] + np.concatenate([[0.0], np.cumsum(even)])
    return rows, np.asarray(np.interp(np.arange(rows[-1] + 1), rows, joined))
