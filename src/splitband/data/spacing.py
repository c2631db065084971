"""Find the even step between time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from splitband.data.columns import Column, in_file
from splitband.data.gaps import Gaps, stretches
from splitband.data.stamps import last_place, readings
from splitband.data.timing import Stamp, near_sampling, stamp_after
from splitband.runtime.arrays import Array

MOST_MISSING = 0.9
"""Share of a record's rows that may be missing between its time stamps. By eye."""
FEWEST_SPREAD = 3
"""Fewest rows missing at even distances that may be no missing rows, but rounded stamps.

Rows that are lost at random lie like this with a chance of 1 for one row, 0.35 for two, and 0.05
(15 rows) to 0.002 (1000 rows) for three.
"""
_RESOLUTIONS = (60.0, 3600.0, 86400.0)
"""Of stamps that show no seconds, no minutes or no time of the day, in s."""


@dataclass(frozen=True, eq=False)
class Spacing:
    """Describe the even grid that the rows of a file lie on.

    Attributes
    ----------
    step : In s.
    start : Time stamp of its first row; None for a file without time stamps.
    places : Grid index of each row of the file, `(time,)`; None if no rows are missing.
    newest_first : Whether the rows of the file are to be reversed.
    note : Message about how the stamps were interpreted; empty if that is certain.
    """

    step: float
    start: Stamp | None = None
    places: NDArray[np.int_] | None = None
    newest_first: bool = False
    note: str = ""


def spacing(what: str, name: str, column: Column, gaps: Gaps, expected: float | None) -> Spacing:
    """Return the even grid of time stamps; `expected` is the sampling time that a user gave.

    Raises ValueError for cells that are not stamps, for stamps that do not increase evenly
    (`reading.read` states the tolerance), and for stamps with several readings of different steps,
    none of which is the expected one.
    """
    found = readings(what, name, column)
    newest_first = float(np.median(np.diff(found[0].seconds))) < 0
    if newest_first:
        column = column.iloc[::-1]
        found = readings(what, name, column)
    rising = [each for each in found if (np.diff(each.seconds) > 0).all()] or found[:1]
    steps = {each.words: float(np.median(np.diff(each.seconds))) for each in rising}
    if expected:
        near = [each for each in rising if near_sampling(steps[each.words], expected)]
        rising = near[:1] or rising
    if len(rising) > 1:
        ways = [f"{words} ({step:.6g} s)" for words, step in steps.items()]
        raise ValueError(
            f"{what} can be read as {' or as '.join(ways)}: sampling_time (--sampling-time) in "
            f"seconds decides; it holds {column.iloc[0]}, {column.iloc[1]}, ..."
        )
    read = rising[0]
    stamps = read.seconds
    cut = _cut_to_units(what, stamps, expected)
    rows, joined = np.arange(len(stamps)), stamps
    if gaps == "mask":
        rows, joined = _on_grid(what, stamps, cut)
    unit = cut[1] if cut else max(last_place(stamps), read.grain)
    if not cut and unit > 0.99 * float(np.median(np.diff(joined))):
        unit = 0.0  # rounding this coarse could hide a missing row
    in_order = column if gaps == "refuse" else None
    step, start = _even_grid(what, joined, unit, read.grain, in_order)
    return Spacing(
        step,
        start if read.date is None else stamp_after(read.date, start),
        rows if len(rows) <= rows[-1] else None,
        newest_first,
        read.note and f"{what} {read.note}",
    )


def _even_grid(
    what: str, stamps: Array, unit: float, grain: float, column: Column | None
) -> tuple[float, float]:
    """Return the step and the first stamp of an even grid, in s; see `reading.read` for tolerances.

    `unit` is one unit in the last place of the stamps, 0 if it explains no steps, `grain` the
    resolution of their number type, in s; `column` holds them in the file, None if rows may be
    missing.
    """
    steps = np.diff(stamps)
    if (back := np.flatnonzero(steps <= 0)).size:
        row = int(back[0]) + 1
        line = "" if column is None else in_file(column, row)
        raise ValueError(
            f"{what} must increase: row {row} ({stamps[row]:.10g} s) follows "
            f"{stamps[row - 1]:.10g} s{line}; time_column='' (--time-column '') with sampling_time "
            "ignores the stamps"
        )
    median, mean = float(np.median(steps)), float(steps.mean())
    line_off = np.abs(stamps - stamps[0] - mean * np.arange(len(stamps)))[1:]
    most = (1.001 + 1 / len(steps)) * unit  # the mean is that of rounded stamps, too
    rounded = np.maximum(np.abs(steps - mean), line_off) < most
    off = np.abs(steps - median)
    exact = 0.01 * median + 4 * float(np.spacing(np.abs(stamps).max()))
    if (bad := np.flatnonzero((off > exact) & ~rounded)).size:
        gaps = bad[off[bad] > 1.001 * unit]  # report true gaps first: they shift the other rows
        row = int((gaps if gaps.size else bad)[0]) + 1
        raise ValueError(
            f"{what} must be even: expected a step of {median:.6g} s at row {row}, found "
            f"{steps[row - 1]:.6g} s{in_file(column, row) if column is not None else ''}; "
            "time_column='' (--time-column '') ignores the stamps"
            + (", gaps='mask' (--gaps mask) allows for missing rows" if column is not None else "")
        )
    centred = np.arange(len(stamps)) - 0.5 * len(steps)
    # The slope of a fitted line, which averages out the rounding of the stamps.
    slope = centred @ (stamps - stamps[0]) / (centred @ centred)
    plain = float(f"{slope:.3g}")  # taken where the stamps cannot tell it from the slope
    drift = abs(plain - slope) * len(stamps)
    step = plain if drift < max(0.1 * unit, grain) else float(f"{slope:.12g}")
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


def _cut_to_units(what: str, stamps: Array, expected: float | None) -> tuple[float, float] | None:
    """Return the step and the unit of stamps that are cut to units almost as long: 0, 1, 3, 4, 6 s.

    None for other stamps. Raises ValueError where steps of one unit are more frequent than those of
    two, which may then be missing rows, unless `expected` decides.
    """
    steps = np.diff(stamps)
    unit = float(steps.min())
    if unit <= 0 or not (unit < 1.001 * last_place(stamps) or unit in _RESOLUTIONS):
        return None
    begin, end = max(stretches(steps < 2.001 * unit), key=lambda part: part[1] - part[0])
    part = stamps[begin : end + 2]
    lost = round((part[-1] - part[0]) / unit) - (len(part) - 1)
    if lost < FEWEST_SPREAD:
        return None
    index = np.arange(len(part))
    found = scipy.optimize.minimize_scalar(
        lambda step: np.ptp(part - step * index), bounds=(unit, 2 * unit),
        method="bounded", options={"xatol": 1e-3 * unit / len(part)},
    )  # fmt: skip
    if found.fun > 1.001 * unit:
        return None
    step = float(f"{np.polyfit(index, part, 1)[0]:.3g}")  # a plain one, if it explains the stamps
    step = step if np.ptp(part - step * index) < 1.001 * unit else float(found.x)
    if expected is None and 2 * lost >= len(part) - 2:
        return step, unit
    if expected is None:
        raise ValueError(
            f"{what} can be read as every {unit:.6g} s with rows missing, {lost} of them at even "
            f"distances, or as every {step:.3g} s, cut to {unit:.6g} s: sampling_time "
            "(--sampling-time) in seconds decides, with gaps='mask' (--gaps mask) for missing rows"
        )
    return (expected, unit) if np.ptp(part - expected * index) < 1.001 * unit else None


def _on_grid(
    what: str, stamps: Array, cut: tuple[float, float] | None
) -> tuple[NDArray[np.int_], Array]:
    """Return each stamp's row on the grid without gaps, `(time,)`, and the stamps of all rows.

    `cut` is the step and the unit of stamps that are cut to units almost as long.
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
    gap = np.rint(steps / usual) > 1
    unit = 0.0
    if cut is not None:
        usual, unit = cut
        gap = steps > 2.001 * unit
    missing = float(np.maximum(np.rint(steps / usual) - 1, 0).sum())
    if missing > MOST_MISSING * (missing + len(stamps)):
        worst = int(np.argmax(steps))
        raise ValueError(
            f"{what} must have a stamp for one row in ten at least: {missing:.0f} rows of "
            f"{usual:.6g} s are missing, most of them after row {worst}"
        )
    index = np.arange(len(stamps))
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
