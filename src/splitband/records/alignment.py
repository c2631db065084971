"""Align signals by their time stamps; signals without stamps are assumed to begin together."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from splitband.records.preparation import signals_of
from splitband.records.record import Record
from splitband.records.timing import Grid, near_sampling, same_sampling, seconds_between
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.errors import InputError

log = logging.getLogger("splitband")
"""Says how signals were put together; the command line prints it."""
NEAR = 0.01
"""Share of a step within which times count as equal, as stamps may be rounded. Rounding."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Hold a signal at the sampling times of another one.

    values : `(samples, n)`.
    note : How it was resampled, in words; empty if its rows were used unchanged.
    """

    values: Array
    note: str = ""


def aligned(what: str, values: Array, own: Grid, onto: Grid, held: Flags | None = None) -> Aligned:
    """Return the values of a signal at other times, aligned by the time stamps of both.

    Unless both have time stamps, they are assumed to begin together. The signal is interpolated
    between its samples. At either end it may be half a step of `onto` short, and is held there.

    what : Name of the signal in messages.
    values : `(time, n)`, all finite, at the times `own`.
    own, onto : Sampling times of the signal, and those to align it to.
    held : For inputs: which of them are held, `(n,)`, see `interpolated`.
    """
    try:
        rows = _rows(own, onto)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
    last, slack = len(values) - 1, 0.5 * onto.step / own.step
    if rows[0] < -slack or rows[-1] > last + slack:
        raise InputError(_not_covered(what, own, onto))
    nearest = np.rint(rows).astype(int)
    off = float(np.abs(rows - nearest).max())
    exact = off <= NEAR
    at_times = values[np.clip(nearest, 0, last)] if exact else interpolated(values, rows, held)
    as_they_are = exact and bool((np.diff(nearest) == 1).all())
    notes = [_one_sided(own, onto), "" if as_they_are else _resampled(own, onto, off)]
    return Aligned(at_times, "; ".join(filter(None, notes)))


def reach(own: Grid, onto: Grid) -> int:
    """Return how many times from the first of `onto` on are covered by a signal at times `own`.

    The length of `onto` does not matter. Raises ValueError if one has dates and the other seconds,
    or if only one has a time zone.
    """
    begin = _rows(own, replace(onto, samples=1))[0]
    return max(0, int(np.floor((own.samples - 1 - begin) * own.step / onto.step + NEAR)) + 1)


def resampled(record: Record, sampling_time: float) -> Record:
    """Return a record resampled to another sampling time in s, from its first sample on.

    Known inputs are held or interpolated linearly, as `Reading.hold` says, the rest by a spline. A
    sample counts as measured if both of its neighbours were. All signals end with the record.
    """
    samples = reach(record.grid, replace(record.grid, step=sampling_time))
    rows = np.minimum(np.arange(samples) * (sampling_time / record.sampling_time), len(record) - 1)
    measured = record.measured
    if measured is not None:
        before, after = np.floor(rows + NEAR).astype(int), np.ceil(rows - NEAR).astype(int)
        measured = measured[before] & measured[after]
    changed: dict[str, Any] = {"sampling_time": sampling_time, "measured": measured}
    for name, signal in signals_of(record).items():
        held = record.reading.holds(record.inputs) if name == "u" else None
        changed[name] = interpolated(signal, rows, held)
    return replace(record, **changed)


def sampled_like(record: Record, sampling_time: float, name: str) -> Record:
    """Return a record resampled to a sampling time that differs from its own by 1 % at most.

    It is unchanged if they differ by more, or if both grids end within half a sample.
    """
    own = record.sampling_time
    if not near_sampling(own, sampling_time) or same_sampling(own, sampling_time, len(record)):
        return record
    log.info("%s: sampled every %.7g s, interpolated to every %.7g s", name, own, sampling_time)
    return resampled(record, sampling_time)


def interpolated(values: Array, rows: Array, held: Flags | None = None) -> Array:
    """Interpolate `values` `(time, n)` at fractional rows; the first and last value are held.

    By a cubic spline, as a simulator's output; inputs, which may jump, linearly, unless they are
    `held`, `(n,)`.
    """
    index = np.arange(len(values))
    rows = np.clip(rows, 0, len(values) - 1)
    if held is None and len(values) > 1:
        return np.asarray(scipy.interpolate.CubicSpline(index, values)(rows))
    lines = np.column_stack([np.interp(rows, index, channel) for channel in values.T])
    return np.where(
        False if held is None else held, values[np.floor(rows + NEAR).astype(int)], lines
    )


def _rows(own: Grid, onto: Grid) -> Array:
    """Return the times `onto` as fractional rows of a signal at the times `own`."""
    offset = 0.0
    if own.start is not None and onto.start is not None:
        offset = seconds_between(own.start, onto.start)
    return np.asarray((offset + onto.step * np.arange(onto.samples)) / own.step)


def _not_covered(what: str, own: Grid, onto: Grid) -> str:
    if own.start is not None and onto.start is not None:
        return (
            f"{what} must cover {onto}, by the time stamps of both: it has {own} (where one has no "
            "time stamps, both are taken to begin together)"
        )
    return (
        f"{what} must cover {onto.samples} samples every {onto.step:.7g} s, got {own.samples}"
        + ("" if same_sampling(own.step, onto.step, onto.samples) else f" every {own.step:.7g} s")
    )


def _one_sided(own: Grid, onto: Grid) -> str:
    if (own.start is None) == (onto.start is None):
        return ""
    has, lacks = ("it", "the record") if onto.start is None else ("the record", "it")
    return f"{has} has time stamps, {lacks} has none: taken to begin together"


def _resampled(own: Grid, onto: Grid, off: float) -> str:
    """Describe the resampling of a signal whose samples are up to `off` steps off the times."""
    if same_sampling(own.step, onto.step, onto.samples):
        return f"its samples lie up to {off:.2g} of a step beside the record's: interpolated"
    how = "interpolated" if off > NEAR else "taken"
    return f"sampled every {own.step:.7g} s, {how} at the record's times, every {onto.step:.7g} s"
