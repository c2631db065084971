"""Time stamps: seconds or dates, and the even step between them."""

from __future__ import annotations

import re
import warnings

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import is_timedelta64_dtype

from splitband.data.columns import Column, has_number, numbers
from splitband.data.gaps import FloatArray, Gaps
from splitband.data.trajectory import require_finite

MOST_MISSING = 0.9
"""Share of a record's rows that may be missing between its time stamps."""
TIME_NAMES = ("time", "t", "timestamp", "datetime", "date")
_UNITS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "min": 60.0, "h": 3600.0}
_UNITS |= {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9}
_UNIT = re.compile(rf"[\s_/(\[]+({'|'.join(_UNITS)})[)\]]?$")


def time_name(column: str) -> tuple[str, float]:
    """Split a name such as "Time [ms]" into what it names and the seconds in its unit."""
    name = column.strip().lower()
    unit = _UNIT.search(name)
    return (name[: unit.start()], _UNITS[unit[1]]) if unit else (name, 1.0)


def spacing(
    what: str, name: str, column: Column, gaps: Gaps
) -> tuple[float, NDArray[np.int_] | None]:
    """The even step between stamps in s, and the row of each where others are missing.

    Raises
    ------
    ValueError
        For what is no stamp, or comes out of turn; see `reading.read` for the tolerance.
    """
    stamps, grain = _seconds(what, name, column)
    rows = _on_grid(what, stamps) if gaps == "mask" else np.arange(len(stamps))
    missing = len(rows) <= rows[-1]
    unit = max(_last_place(stamps), grain)
    if missing:
        stamps = _joined(stamps, rows)
    return _even_step(what, stamps, unit, gaps == "mask"), rows if missing else None


def _seconds(what: str, name: str, column: Column) -> tuple[FloatArray, float]:
    """Return stamps in seconds, (time,), and the resolution of their number type."""
    if is_timedelta64_dtype(column):
        column = column.dt.total_seconds()
    if has_number(column):
        values, unit = numbers(what, column), time_name(name)[1]
        require_finite(what, values[:, None])
        if abs(values[0]) * unit > 1e11:
            raise ValueError(f"{what} must be in seconds, or name its unit as in 't [ms]'")
        kind = np.float32 if column.dtype == np.float32 else np.float64
        grain = 2 * float(np.spacing(kind(np.abs(values).max())))
        return values * unit, grain * unit
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        formats = ("ISO8601", None)  # None: as in the first row
        tries = [pd.to_datetime(column, format=f, utc=True, errors="coerce") for f in formats]
    dates = min(tries, key=lambda parsed: int(parsed.isna().sum()))
    if (bad := np.flatnonzero(dates.isna())).size:
        cell = str(column.iloc[bad[0]])[:40]
        raise ValueError(f"{what} must hold numbers or dates: row {bad[0]} holds {cell!r}")
    return np.asarray((dates - dates.iloc[0]).dt.total_seconds(), dtype=np.float64), 0.0


def _joined(stamps: FloatArray, rows: NDArray[np.int_]) -> FloatArray:
    """Stamps for missing rows too, those after a gap moved onto the grid of those before it.

    A logger that starts again does so at any moment: half a step is not missed.
    """
    steps, places = np.diff(stamps), np.diff(rows)
    usual = steps[places == 1].mean() if (places == 1).any() else (steps / places).mean()
    moved = np.concatenate([[0.0], np.cumsum(np.where(places == 1, steps, usual * places))])
    return np.asarray(np.interp(np.arange(rows[-1] + 1), rows, stamps[0] + moved))


def _even_step(what: str, stamps: FloatArray, unit: float, masked: bool) -> float:
    """Return the step of evenly rising stamps, in seconds; `reading.read` states the tolerance.

    `unit` is that of their last place.
    """
    steps = np.diff(stamps)
    if (back := np.flatnonzero(steps <= 0)).size:
        before, after = stamps[back[0] : back[0] + 2]
        raise ValueError(
            f"{what} must increase: row {back[0] + 1} ({after:.10g} s) follows {before:.10g} s"
        )
    median, mean = float(np.median(steps)), float(steps.mean())
    if unit > 0.99 * median:  # stamps so coarse would hide a missing row
        unit = 0.0
    line = np.abs(stamps - stamps[0] - mean * np.arange(len(stamps)))[1:]
    rounded = np.maximum(np.abs(steps - mean), line) < 0.999 * unit
    off = np.abs(steps - median)
    if (bad := np.flatnonzero((off > 0.01 * median) & ~rounded)).size:
        gaps = bad[off[bad] > 1.001 * unit]  # named first: rounded steps only drift with them
        row = int((gaps if gaps.size else bad)[0]) + 1
        raise ValueError(
            f"{what} must be even: expected a step of {median:.6g} s at row {row}, found "
            f"{steps[row - 1]:.6g} s; time_column='' (--time-column '') ignores the stamps"
            + (", gaps='mask' (--gaps mask) allows for missing rows" if not masked else "")
        )
    centred = np.arange(len(stamps)) - 0.5 * len(steps)
    slope = centred @ (stamps - stamps[0]) / (centred @ centred)  # averages the rounding out
    return float(f"{slope:.12g}")


def _on_grid(what: str, stamps: FloatArray) -> NDArray[np.int_]:
    """The row of each stamp, `(time,)`, if none were missing; where they rise evenly, 0, 1, 2...

    Raises
    ------
    ValueError
        When nearly all are missing, which is a wrong stamp rather.
    """
    steps = np.diff(stamps)
    if not len(steps) or steps.min() <= 0:  # refused later, with the row
        return np.arange(len(stamps))
    usual = float(np.quantile(steps, 0.1))  # the smallest, but for jitter
    usual = float(steps[steps < 1.75 * usual].mean())  # stamps may be rounded to few units
    missing = float(np.maximum(np.rint(steps / usual) - 1, 0).sum())
    if missing > MOST_MISSING * (missing + len(stamps)):
        worst = int(np.argmax(steps))
        raise ValueError(
            f"{what} must have a stamp for one row in ten at least: {missing:.0f} rows of "
            f"{usual:.6g} s are missing, most of them after row {worst}"
        )
    return np.concatenate([[0], np.cumsum(np.maximum(np.rint(steps / usual), 1))]).astype(int)


def _last_place(stamps: FloatArray) -> float:
    """Return the unit of the last printed decimal place; 0 if it is beyond 1e-9."""
    for places in range(10):
        scaled = stamps * 10.0**places
        tolerance = max(1e-6, 2 * np.spacing(np.abs(scaled).max()))
        if np.abs(scaled - np.rint(scaled)).max() < tolerance:
            return 10.0**-places
    return 0.0
