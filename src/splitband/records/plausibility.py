"""Find what is wrong in a record before a model is fitted to it: `Record.warnings`.

Each function looks for one kind of fault and returns sentences. What looks like a fault and is none
stands in `tests/records/test_plausibility.py`; constants were chosen on such records, by eye.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from splitband.records.signals import row_ranges, stretches
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.system import quoted

if TYPE_CHECKING:
    from splitband.records.record import Record

TURNS, COUNTS = (360.0, 2 * np.pi), (2.0**8, 2.0**16, 2.0**32)
"""Periods of angles, and of counters in their smallest steps."""
FEW, STUCK = 10, 20
"""Samples or values that show nothing; samples that have one value by no chance. By eye."""
APART = 3.0
"""Distance of an outlier from all other values, in their range. By eye."""
HOUR, SUNDAY = 3600.0, 6
"""An hour in s, and the day of the week on which clocks are put forward. Convention."""
REACH, MOST = 20, 20_000
"""Samples between an output and an input that repeats it, by eye; compared ones, for the time."""


def warnings_of(record: Record) -> list[str]:
    """Return what is wrong in the columns of a record, a sentence each."""
    u = np.zeros((len(record), 0)) if record.u is None else record.u
    every, found = record.signals, list[str]()
    for i, (name, x) in enumerate(every.items()):
        is_output = i < record.ny
        found += _outliers(name, x, u if is_output else None) or _wraps(name, x)
        others = (other for by, other in every.items() if by != name)
        found += _flat(name, x, [*others]) if is_output else _hardly_moves(name, x)
    for (output, y), (name, v) in product(
        zip(record.columns, record.y.T, strict=True), zip(record.inputs, u.T, strict=True)
    ):
        found += _not_an_input(output, y[:MOST], name, v[:MOST])
    return found + _summer_time(record)


def _summer_time(record: Record) -> list[str]:
    """Return a sentence on a missing hour where clocks are put forward, on dates without a zone."""
    start, step = record.start, record.sampling_time
    if not isinstance(start, pd.Timestamp) or start.tzinfo is not None or step > HOUR:
        return []
    hours = [
        start + pd.Timedelta(first * step, "s")
        for first, last in stretches(~record.complete)
        if abs((last + 1 - first) * step - HOUR) < 0.5 * step
    ]
    return [
        f"an hour is missing at {at}, as where summer time begins: if it does there, no sample is "
        "missing once the stamps have a zone, in pandas tz_localize('Europe/Berlin')"
        for at in hours
        if at.day_of_week == SUNDAY and at.hour in (1, 2)
    ]


def period_of(x: Array) -> float | None:
    """Return the period by which an angle or a counter jumps, as its jumps show; or None."""
    x = x[np.isfinite(x)]
    steps, span = np.diff(x), np.ptp(x) if len(x) > FEW else 0.0
    if not span or np.abs(steps).max() < 0.5 * span:
        return None
    levels = np.unique(x)
    if np.isin(x, levels[[0, -1]]).sum() > max(0.05 * len(x), FEW * len(x) / len(levels)):
        return None  # it is switched, or stays at its limits
    units = {_resolution(x), float(f"{np.diff(levels).min():.6g}")} - {0.0}
    for period in (*TURNS, *(unit * count for unit, count in product(units, COUNTS))):
        left, at = np.abs(steps - period * np.round(steps / period)), np.abs(steps) > 0.5 * period
        if span > period * (1 + 1e-9) or not at.any() or left.max() > 0.25 * period:
            continue
        around = np.flatnonzero(at)[:, None] + np.delete(np.arange(-5, 6), 5)
        usual = np.where(at, 0.0, left)[np.clip(around, 0, len(steps) - 1)].max(axis=1)
        if (left[at] <= 3 * usual + 1e-9 * period).mean() > 0.95:
            return float(period)
    return None


def _resolution(x: Array) -> float:
    """Return the decimal unit of which all values are multiples; 0 where there is none."""
    for unit in (1.0, 0.1, 1e-2, 1e-3, 1e-4):
        if np.allclose(x / unit, np.round(x / unit), rtol=1e-9, atol=1e-9):
            return unit
    return 0.0


def _wraps(name: str, x: Array) -> list[str]:
    if (period := period_of(x)) is None:
        return []
    at, size = np.append(False, np.abs(np.diff(x)) > 0.5 * period), _number(period)
    said = f"{name!r} jumps by {period:.10g} at {row_ranges(at)}, as an angle or a counter does"
    option = quoted(f"{name}={size}")
    return [f"{said}: unwrap={{{name!r}: {size}}} (--unwrap {option}) makes it continuous"]


def _outliers(name: str, x: Array, u: Array | None) -> list[str]:
    """Return a sentence on values far from all others: missing values in disguise, or spikes.

    Pulses of an input (`u` is None), and what the inputs of an output explain, are no outliers.
    """
    apart, rest = _apart(x)
    values, counts = np.unique(x[apart], return_counts=True)
    few = len(values) <= 3
    if not len(values) or (not few and period_of(x)):
        return []
    if not (few and counts.max() >= 3) and (u is None or _answers(apart, u)):
        return []
    ways = [f"{_missing(*values)} leaves them out"] if few else []
    if u is not None:
        by = f"clip_outliers(columns=[{name!r}]) (--clip-outliers {quoted(name)})"
        ways.append(f"{by} limits them")
    said = ", ".join(map(_number, values)) if few else f"{values[0]:.4g} to {values[-1]:.4g}"
    said = f"outliers, {said} in {apart.sum()} of {len(x)} samples ({row_ranges(apart)})"
    usual = f"all others are from {rest[0]:.4g} to {rest[-1]:.4g}"
    return [f"{name!r} has {said}, {usual}: {'; '.join(ways)}"]


def _apart(x: Array) -> tuple[Flags, Array]:
    """Return where values stand apart, at most a tenth of them, and all others in order."""
    known = np.sort(x[np.isfinite(x)])
    n, most, gaps = len(known), len(known) // 10, np.diff(known)
    low = int(gaps[:most].argmax()) + 1 if most else 0
    high = n - 1 - int(gaps[::-1][:most].argmax()) if most else n
    for _ in range(2):  # without outliers on one side, the range of the others may be wider
        least = APART * np.ptp(known[low:high]) if n else 0.0
        low = low if low and gaps[low - 1] >= least else 0
        high = high if high < n and gaps[high - 1] >= least else n
    kept = known[low:high]
    if len(np.unique(kept)) < FEW:
        return np.zeros(len(x), dtype=np.bool_), kept
    return np.asarray((x < kept[0]) | (x > kept[-1])), kept


def _answers(rows: Flags, u: Array) -> bool:
    """Return whether one of the inputs jumps at half of these rows, or up to two rows before."""
    moves = np.abs(np.diff(u, axis=0, prepend=u[:1]))
    large = (moves > 0) & (moves >= np.quantile(moves, 0.95, axis=0))
    near = [np.convolve(each, np.ones(3))[: len(rows)] > 0 for each in large.T]
    return any(2 * (each & rows).sum() >= rows.sum() for each in near)


def _flat(name: str, x: Array, others: list[Array]) -> list[str]:
    """Return sentences on an output that is constant, stays at a limit, or is stuck.

    What comes to rest slows down before; what is limited or stuck stops abruptly, and goes on so. A
    column that often repeats its values, as it is held or coarsely quantised, does not tell.
    """
    rows = np.flatnonzero(np.isfinite(x))
    known, steps = x[rows], np.diff(x[rows])
    levels, counts = np.unique(known, return_counts=True)
    if len(levels) == 1:
        return [f"{name!r} is constant, {_number(levels[0])}: there is nothing to predict"]
    runs = [(a, b + 1) for a, b in stretches(steps == 0) if b > a > 0]  # equal from a to b
    held = np.zeros(len(steps), dtype=np.bool_)
    for a, b in runs:
        held[a:b] = True
    moving, found, abrupt = steps[~held], list[str](), dict[float, list[tuple[int, int]]]()
    if len(moving) < max(FEW, 0.25 * len(x)) or (moving == 0).mean() > 0.1:
        return []
    usual, noisy = float(np.median(np.abs(moving))), _noisy(moving)
    for a, b in runs:
        sides = np.abs(steps[max(a - 5, 0) : a]), np.abs(steps[b : b + 5])
        if min(np.median(each) for each in sides if len(each)) >= 0.1 * usual:
            abrupt.setdefault(float(known[a]), []).append((a, b))
    for value, those in abrupt.items():
        i, at = int(np.searchsorted(levels, value)), np.zeros(len(x), dtype=np.bool_)
        for a, b in those:
            at[rows[a : b + 1]] = True
        around = np.append(counts[max(i - 3, 0) : i], counts[i + 1 : i + 4]).mean()
        jump = max(np.abs(steps[b : b + 1]).sum() for _, b in those) > 3 * usual
        limit = {0: "at its lowest value,", len(levels) - 1: "at its highest value,"}.get(i, "")
        sure = noisy or (len(those) > 1 if limit else jump and value != 0)
        if sure and at.sum() >= max(STUCK, 8 * around) and len(levels) > STUCK:
            said = f"stays {limit or 'stuck at'} {_number(value)}, in {at.sum()} samples"
            way = f"{_missing(value)} leaves them out"
            if any((other == value).any() for other in others):
                way = "empty cells and gaps='mask' (--gaps mask) leave them out"
            found.append(f"{name!r} {said} ({row_ranges(at)}): if the sensor is at fault, {way}")
    return found


def _hardly_moves(name: str, v: Array) -> list[str]:
    """Return a sentence on an input that has a little noise around one value, and nothing else."""
    if not 0 < np.ptp(v) < 0.02 * np.abs(v).max() or np.std(np.diff(v)) < np.std(v):
        return []
    said = f"{name!r} hardly moves: it is from {v.min():.6g} to {v.max():.6g}"
    return [f"{said}, without steps or slow changes that could show an effect"]


def _not_an_input(output: str, y: Array, name: str, v: Array) -> list[str]:
    """Return a sentence on an input that is computed from the output, or that comes after it."""
    if min(np.ptp(y), np.ptp(v)) == 0 or len(y) < 10 * REACH:
        return []
    # An input may be followed by its output exactly, but not by the output's noise.
    for lag in range(REACH + 1) if _noisy(np.diff(y)) else ():
        if _same(v[: len(v) - lag], y[lag:]):
            said = f"{name!r} is {output!r}{f' of {lag} sample(s) later' if lag else ''}"
            return [f"{said}, noise included: if it is computed from that, it must be no input"]
    if not (early := _lead(np.diff(y), np.diff(v))):
        return []
    said = f"{output!r} moves before {name!r}, by up to {early} sample(s): shift that column if it"
    return [f"{said} is recorded too late; if it answers the output, nobody knows it in advance"]


def _noisy(steps: Array) -> bool:
    """Return whether the steps of a signal often change their sign."""
    return bool((np.sign(steps[1:]) != np.sign(steps[:-1])).mean() > 0.25)


def _same(a: Array, b: Array) -> bool:
    """Return whether `a` is `b` in other units, apart from rounding."""
    slope, level = np.polyfit(b, a, 1) if np.ptp(b) else (0.0, 0.0)
    rounding = 0.6 * (_resolution(a) + abs(slope) * _resolution(b)) + 1e-9 * np.ptp(a)
    return bool(np.abs(a - slope * b - level).max() <= rounding < 0.3 * np.std(np.diff(a)))


def _lead(y: Array, v: Array) -> int:
    """Return by how many samples `y` is ahead of an input, by FIR models; 0 if it is not."""
    rows, shares = np.lib.stride_tricks.sliding_window_view(v, 4 * REACH + 1), []
    y = y[3 * REACH : 3 * REACH + len(rows)]
    if not y.any():
        return 0
    for last in (3 * REACH + 1, 4 * REACH + 1):  # without samples to come, and with them
        some = rows[:, :last]
        h = np.linalg.lstsq(some.T @ some, some.T @ y, rcond=1e-9)[0]
        shares.append(1 - float(((y - some @ h) ** 2).sum() / (y**2).sum()))
    ahead = np.abs(h[3 * REACH + 1 :])
    before = int(np.flatnonzero(ahead > 0.3 * ahead.max())[-1]) + 1 if ahead.any() else 0
    return before if shares[1] > max(0.5, shares[0] + 0.25) else 0


def _missing(*values: float) -> str:
    listed = [*map(_number, values)]
    return f"missing={listed}, gaps='mask' (--missing {','.join(listed)} --gaps mask)"


def _number(value: float) -> str:
    """Return a number as it is read back, as short as possible."""
    return f"{value:.6g}" if float(f"{value:.6g}") == value else repr(float(value))
