"""Define time stamps, and evenly spaced grids of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

Stamp: TypeAlias = float | pd.Timestamp
"""Seconds on the clock of a record, or a date, with a time zone or without."""


def as_stamp(value: Any) -> Stamp:
    """Check a time stamp; raises ValueError unless it is a finite number or a date."""
    if isinstance(value, datetime | np.datetime64) and not pd.isna(value):
        return pd.Timestamp(value).as_unit("ns")
    try:
        seconds = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        seconds = math.nan
    if not math.isfinite(seconds):
        raise ValueError(f"a time stamp must be a finite number of seconds or a date: got {value}")
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
    """Return how much later the second time stamp is, in s.

    Raises ValueError if only one of them is a date, or only one has a time zone.
    """
    if isinstance(first, pd.Timestamp) and isinstance(second, pd.Timestamp):
        if zones_differ(first, second):
            raise ValueError(
                "dates that are put together must all have a time zone, or none: got "
                f"{in_words(first)} and {in_words(second)}"
            )
        return float((second - first) / pd.Timedelta(1, unit="s"))
    if isinstance(first, pd.Timestamp) or isinstance(second, pd.Timestamp):
        raise ValueError(
            "time stamps that are put together must all be dates or all be in seconds: "
            f"got {in_words(first)} and {in_words(second)}"
        )
    return second - first


def zones_differ(first: Stamp | None, second: Stamp | None) -> bool:
    """Return whether both are dates and only one of them has a time zone."""
    dates = [each for each in (first, second) if isinstance(each, pd.Timestamp)]
    return len(dates) == 2 and (dates[0].tzinfo is None) != (dates[1].tzinfo is None)


def seconds_of(stamp: Stamp | None) -> float:
    """Return the time stamp in s for a simulator; 0 for a date or None."""
    return stamp if isinstance(stamp, float) else 0.0


def in_words(stamp: Stamp) -> str:
    """Format the time stamp for a message."""
    return str(stamp) if isinstance(stamp, pd.Timestamp) else f"{stamp:.10g} s"


def stamps_at(start: Stamp, step: float, rows: NDArray[np.int_]) -> Array | pd.DatetimeIndex:
    """Return the time stamps of rows, counted from `start`, for tables and pictures.

    Seconds are rounded to a millionth of the step: 0.3, not 0.30000000000000004.
    """
    if isinstance(start, pd.Timestamp):
        return start + pd.to_timedelta(np.rint(1e9 * step * rows).astype(np.int64), unit="ns")
    return np.round(start + step * rows, max(0, 6 - math.floor(math.log10(step))))


def near_sampling(step: float, other: float) -> bool:
    """Return whether two steps differ by 1 % at most, as records of one system may."""
    return abs(step - other) <= 0.01 * other


def same_sampling(step: float, other: float, samples: int) -> bool:
    """Return whether two grids with the same start and length end within half a step."""
    return abs(step - other) * samples < 0.5 * min(step, other)


@saved
@dataclass(frozen=True)
class Grid:
    """Represent a grid of evenly spaced times.

    Attributes
    ----------
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
