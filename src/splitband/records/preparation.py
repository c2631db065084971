"""Prepare records, and keep what was decided, by which another record is prepared alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
import pandas as pd

from splitband.records.plausibility import period_of
from splitband.records.signals import as_float, bare_name, category_names, refilled
from splitband.records.timing import seconds_of, stamp_after
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from splitband.records.record import Record

Value = TypeVar("Value")
Periods: TypeAlias = Mapping[str, float | None] | Sequence[str] | str
"""Angles and counters by name, with their periods or without."""
Limits: TypeAlias = Mapping[str, tuple[float, float]]
"""Lowest and highest value of outputs, by name."""


@dataclass(frozen=True)
class Reading:
    """What reading and preparing a record decided; `Record.like` treats another one by it.

    Attributes
    ----------
    missing : Words and numbers that stand for a missing value in its file.
    categories : Words of columns of its file that are inputs, by column; see `read`.
    jitter : Largest deviation of a step between its time stamps from the sampling time, in s;
        of stamps that `grid` is for, that of nine in ten steps, gaps aside.
    grid : Step in s of the even grid that `read(..., step=)` put uneven stamps on; None without.
    hold : Inputs that are held, between their stamps and in gaps; the others are interpolated.
        None where nothing had to be filled.
    step : Sampling time in s before `Record.resample`; None without.
    periods : Periods of the outputs and inputs that `Record.unwrap` lets go on, by name.
    limits : Lowest and highest value to which `Record.clip_outliers` limits outputs, by name.
    levels : What `Record.detrend` subtracts from outputs and inputs, by name.
    slopes : What it subtracts more per second after `begin`, by name; empty for means.
    begin : Time in s at which straight lines have their levels; for dates since 1970.
    """

    missing: tuple[str, ...] = ()
    categories: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    jitter: float = 0.0
    grid: float | None = None
    hold: tuple[str, ...] | None = None
    step: float | None = None
    periods: Mapping[str, float] = field(default_factory=dict)
    limits: Limits = field(default_factory=dict)
    levels: Mapping[str, float] = field(default_factory=dict)
    slopes: Mapping[str, float] = field(default_factory=dict)
    begin: float = 0.0

    @property
    def units(self) -> tuple[Any, ...]:
        """Return the units of samples; limits leave those within them as they are."""
        return self.periods, self.levels, self.slopes, self.begin

    @property
    def steps(self) -> tuple[Any, ...]:
        """Return all that was done to samples but their resampling."""
        return *self.units, self.limits

    @property
    def sentences(self) -> list[str]:
        """Return what was done with the times of the samples, in words."""
        said = [] if self.grid is None else [f"uneven stamps put on a grid of {self.grid:g} s"]
        said += [] if self.step is None else [f"means of samples every {self.step:g} s"]
        return said + ([f"{', '.join(self.hold)} held between values"] if self.hold else [])

    def holds(self, names: Sequence[str]) -> Flags:
        """Return which of these signals are held where they have to be filled, `(names,)`."""
        return np.array([name in (self.hold or ()) for name in names])

    def label(self, name: str) -> str:
        """Return the name of a channel with its unit, as "tank (minus 20.3)"."""
        said = [f"0 {words[0]}, 1 {words[1]}" for words in [self.categories.get(name, ())] if words]
        said += [f"unwrapped by {self.periods[name]:.6g}"] if name in self.periods else []
        if name in self.limits:
            said.append("limited from {:.6g} to {:.6g}".format(*self.limits[name]))
        if name in self.levels:
            said.append(f"minus {self.levels[name]:.6g}")
        if name in self.slopes:
            said[-1] += f" and {self.slopes[name]:.6g} per s after {self.begin:.10g} s"
        return f"{name} ({', '.join(said)})" if said else name

    def column(self, name: str) -> str:
        """Return the column of the file that an input comes from: "mode" of "mode=heat"."""
        found = (c for c, words in self.categories.items() if name in category_names(c, words))
        return next(found, name)

    def __str__(self) -> str:
        """Return the channels that are not as they were measured."""
        names = dict.fromkeys([*self.periods, *self.limits, *self.levels])
        return ", ".join(map(self.label, names)) or "as it was measured"


def of_channels(what: str, given: Mapping[str, Value], names: Sequence[str]) -> dict[str, Value]:
    """Return values by the names of channels, which may be given without their units."""
    if not isinstance(given, Mapping):
        raise InputError(f"{what} must give values by name, got {given!r}")
    found = dict[str, Value]()
    for asked, value in given.items():
        own = [asked] if asked in names else [name for name in names if bare_name(name) == asked]
        if not own:
            raise InputError(f"{what} must name one of {', '.join(names)}, got {asked}")
        found |= dict.fromkeys(own, value)
    return found


def periods_of(signals: Mapping[str, Array], asked: Periods) -> dict[str, float]:
    """Return the periods of angles and counters by name, where they are not given as they jump."""
    given = [asked] if isinstance(asked, str) else asked
    given = given if isinstance(given, Mapping) else dict.fromkeys(given)
    found = dict[str, float]()
    for name, value in of_channels("unwrap", given, [*signals]).items():
        x = signals[name]
        period = period_of(x) if value is None else as_float(value)
        if period is None:
            raise InputError(
                f"unwrap must give the period of {name!r}, which has no clear jumps, as in "
                f"{{{name!r}: 360}} (--unwrap {bare_name(name)}=360)"
            )
        span = np.nanmax(x) - np.nanmin(x)
        if not span <= period * (1 + 1e-6) < np.inf:
            rule = f"give {name!r} a period of {span:g} at least, which is its range"
            raise InputError(f"unwrap must {rule}, got {value}")
        found[name] = float(period)
    return found


def limits_of(
    signals: Mapping[str, Array],
    columns: Sequence[str],
    outputs: Sequence[str],
    deviations: float = 5.0,
) -> Limits:
    """Return limits of `deviations` robust standard deviations around the medians of outputs."""
    found = dict[str, tuple[float, float]]()
    for name in of_channels("clip_outliers", dict.fromkeys(columns), outputs):
        middle = np.nanmedian(signals[name])
        # The factor turns the median deviation into the standard deviation of a Gaussian.
        reach = deviations * 1.4826 * np.nanmedian(abs(signals[name] - middle))
        if reach > 0:
            found[name] = float(middle - reach), float(middle + reach)
    return found


def limits_given(record: Record, given: Limits) -> Limits:
    """Return the lowest and highest values of outputs; raises ValueError for anything else."""
    found = dict[str, tuple[float, float]]()
    for name, pair in of_channels("limits", given, record.columns).items():
        ends = [as_float(end) for end in np.ravel(np.asarray(pair, dtype=object))]
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise InputError(f"limits of {name!r} must be lowest and highest value, got {pair}")
        found[name] = ends[0], ends[1]
    return found


def lines_of(record: Record, order: int) -> Reading:
    """Return the means (order 0) of outputs and inputs, or straight lines (order 1) over time."""
    time, levels, slopes = seconds(record), dict[str, float](), dict[str, float]()
    for name, x in record.signals.items():
        known = ~np.isnan(x)
        if order:
            slope, level = np.polyfit((time - time[0])[known], x[known], 1)
            slopes[name], levels[name] = float(slope), float(level)
        else:
            levels[name] = float(x[known].mean())
    return Reading(levels=levels, slopes=slopes, begin=float(time[0]) if order else 0.0)


def unwrapped(record: Record, by: Reading) -> Record:
    """Return a record without jumps by the periods of a reading; see `Record.unwrap`."""
    first = dict(zip(record.columns, record.y[0], strict=True))

    def change(kind: str, name: str, x: Array) -> Array:
        if name not in by.periods:
            return x
        whole, period = going_on(x, by.periods[name]), by.periods[name]
        return in_turn(whole, first[name], period) if kind in ("y_sim", "y_true") else whole

    return _changed(record, change, "unwrap", periods=by.periods)


def going_on(x: Array, period: float) -> Array:
    """Return an angle or counter, `(time,)`, without jumps, which begins as it did."""
    whole, known = np.array(x), np.isfinite(x)
    whole[known] = np.unwrap(x[known], period=period)
    return whole


def in_turn(x: Array, beside: float, period: float) -> Array:
    """Return an angle or counter, `(time,)`, that begins in the turn of another value."""
    return np.asarray(x + period * np.round((beside - x[0]) / period))


def clipped(record: Record, by: Reading) -> Record:
    """Return a record whose measured samples are limited; see `Record.clip_outliers`."""

    def change(kind: str, name: str, x: Array) -> Array:
        return np.clip(x, *by.limits[name]) if kind == "y" and name in by.limits else x

    return _changed(record, change, "clip_outliers", limits=by.limits)


def detrended(record: Record, by: Reading) -> Record:
    """Return a record without the levels and straight lines of a reading; see `Record.detrend`."""
    if by.slopes and record.start is None:
        raise InputError(
            f"{record.name or 'the record'} must have time stamps for straight lines over time, "
            "or nothing tells where on them it is"
        )
    since, step = seconds(record)[0] - by.begin, record.sampling_time

    def change(kind: str, name: str, x: Array) -> Array:
        rise = by.slopes.get(name, 0.0) * (since + step * np.arange(len(x)))
        return x - (by.levels.get(name, 0.0) + rise)

    lines = {"levels": by.levels, "slopes": by.slopes, "begin": by.begin}
    return _changed(record, change, "detrend", **lines)


def resampled(record: Record, k: int) -> Record:
    """Return a record of the means of each `k` samples; see `Record.resample`."""
    if len(record) < 2 * k:
        raise InputError(f"record must have {2 * k} samples to be resampled, got {len(record)}")
    step, first = record.sampling_time, len(record) % k
    changed: dict[str, Any] = {"reading": _decided(record.reading, "resample", step=step)}
    for name, signal in signals_of(record).items():
        kept = signal[first : len(signal) - (len(signal) - first) % k]
        changed[name] = kept.reshape(-1, k, signal.shape[1]).mean(axis=1)
    if record.measured is not None:
        known = record.y_with_gaps[first:].reshape(-1, k, record.ny)
        count = np.isfinite(known).sum(axis=1)
        means = np.nansum(known, axis=1) / np.maximum(count, 1)
        changed |= {"y": np.where(count > 0, means, changed["y"]), "measured": count > 0}
    if record.start is not None:
        changed["start"] = stamp_after(record.start, (first + k - 1) * step)
    return replace(record, sampling_time=k * step, **changed)


def check_level(record: Record, name: str) -> None:
    """Raise ValueError for a detrended record, whose level a simulator that is run cannot have."""
    if record.reading.levels:
        raise InputError(
            f"the record must not be detrended for {name}, whose simulator runs at the measured "
            "level; output that is given with the record (y_sim) is detrended as well"
        )


def signals_of(record: Record) -> dict[str, Array]:
    """Return the signals that a record has, `(time, channels)` each, by the names of its fields."""
    found = {"y": record.y, "y_true": record.y_true, "y_sim": record.y_sim, "u": record.u}
    return {name: signal for name, signal in found.items() if signal is not None}


def seconds(record: Record) -> Array:
    """Return the times of a record in seconds, `(time,)`; for dates, since 1970."""
    start = record.start
    begin = start.timestamp() if isinstance(start, pd.Timestamp) else seconds_of(start)
    return np.asarray(begin + record.sampling_time * np.arange(float(len(record))))


def _changed(
    record: Record, change: Callable[[str, str, Array], Array], method: str, **found: Any
) -> Record:
    """Return a record with each column changed, or itself where nothing was found."""
    if not any(found.values()):
        return record
    reading, new = _decided(record.reading, method, **found), dict[str, Array]()
    for kind, signal in (signals_of(record) | {"y": record.y_with_gaps}).items():
        names = record.inputs if kind == "u" else record.columns
        columns = [change(kind, name, x) for name, x in zip(names, signal.T, strict=True)]
        new[kind] = np.column_stack(columns)
    whole: Any = new | {"y": refilled(record.y, new["y"])}
    return replace(record, reading=reading, **whole)


def _decided(reading: Reading, method: str, **found: Any) -> Reading:
    """Return a reading with what a method has found; raises ValueError if that comes too late."""
    done: dict[str, Any] = {"unwrap": reading.periods, "clip_outliers": reading.limits}
    done |= {"resample": reading.step, "detrend": reading.levels}
    order = [*done]
    if late := next(filter(done.get, order[order.index(method) :]), None):
        raise InputError(
            f"{method} must come once, in the order {', '.join(order)}, got it after {late}"
        )
    return replace(reading, **found)
