"""Prepare records: unwrap, detrend, clip, resample. Steps are stored, and undone on predictions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, final

import numpy as np
import pandas as pd

from splitband.data.plausibility import period_of
from splitband.data.signals import bare_name, refilled
from splitband.data.timing import seconds_of, stamp_after
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from splitband.data.record import Record

Numbers = tuple[float, ...]
Periods: TypeAlias = Mapping[str, float | None] | Sequence[str] | str
"""Angles and counters by name, with their periods or without."""
What = Literal["y", "u", "y_sim"]
"""Measured samples, inputs, or a simulator's output, as which the noise-free signal counts, too."""


class Preparation:
    """Define the interface of a preparation step; by default it changes nothing."""

    @property
    def timed(self) -> bool:
        """Return whether it depends on the time."""
        return False

    def apply(self, record: Record) -> Record:
        """Return the prepared record."""
        time, step = seconds(record), record.sampling_time
        y = refilled(record.y, self.transform("y", record.y_with_gaps, time))
        changed: dict[str, Any] = {"y": y}
        given = signals_of(record)
        for field in given.keys() - {"y"}:
            at = time[0] + step * np.arange(len(given[field]))
            found = self.transform("u" if field == "u" else "y_sim", given[field], at)
            changed[field] = found if field == "u" else self.beside(y, found)
        return replace(record, **changed)

    def transform(self, what: What, signal: Array, time: Array) -> Array:
        """Return a prepared signal, `(time, channels)`, at `time` in s."""
        return signal

    def beside(self, y: Array, y_sim: Array) -> Array:
        """Return a simulator's output as it belongs beside these prepared samples."""
        return y_sim

    def undo(self, what: Literal["y", "u"], signal: Array, time: Array) -> Array:
        """Undo the step on predictions or inputs, `(time, channels)`, at `time` in s."""
        return signal

    def counted_from(self, begin: float) -> Preparation:
        """Return the same step for times counted from `begin`, in seconds."""
        return self


@final
@dataclass(frozen=True)
class Unwrapped(Preparation):
    """Let angles and counters go on where they jump by a period; predictions go on, too.

    `periods` and `input_periods` are those of each output and input; 0 where one has none.
    """

    periods: Numbers
    input_periods: Numbers = ()

    @classmethod
    def of(cls, record: Record, periods: Periods) -> Unwrapped:
        """Return the step for these names of outputs and inputs; see `Record.unwrap`."""
        given = {periods: None} if isinstance(periods, str) else periods
        given = given if isinstance(given, Mapping) else dict.fromkeys(given)
        columns = record.signals
        found = dict.fromkeys(columns, 0.0)
        for asked, value in given.items():
            if not (names := [own for own in columns if asked in (own, bare_name(own))]):
                rule = f"name an output or input ({', '.join(columns)})"
                raise InputError(f"unwrap must {rule}, got {asked}")
            x = columns[names[0]]
            period = period_of(x) if value is None else value
            if period is None:
                raise InputError(
                    f"unwrap must give the period of {asked!r}, which has no clear jumps, as in "
                    f"{{{asked!r}: 360}} (--unwrap {asked}=360)"
                )
            span = np.nanmax(x) - np.nanmin(x)
            if not span <= period * (1 + 1e-6) < np.inf:
                rule = f"give {asked!r} a period of {span:g} at least, which is its range"
                raise InputError(f"unwrap must {rule}, got {value}")
            found[names[0]] = float(period)
        return cls(tuple(found.values())[: record.ny], tuple(found.values())[record.ny :])

    def transform(self, what: What, signal: Array, time: Array) -> Array:
        """Return a signal without jumps, which begins as it did; NaN stays NaN."""
        whole = np.array(signal)
        periods = self.input_periods if what == "u" else self.periods
        for x, period in zip(whole.T, periods, strict=True):
            known = np.isfinite(x)
            x[known] = np.unwrap(x[known], period=period) if period else x[known]
        return whole

    def beside(self, y: Array, y_sim: Array) -> Array:
        """Return a simulator's output without jumps, which begins in the turn of the samples."""
        whole, periods = self.transform("y_sim", y_sim, np.empty(0)), np.array(self.periods)
        turns = np.round((y[0] - whole[0]) / np.where(periods > 0, periods, 1.0))
        return np.asarray(whole + periods * turns)


@final
@dataclass(frozen=True)
class Detrended(Preparation):
    """Remove means, or straight lines over time, from outputs and inputs.

    Attributes
    ----------
    begin : Time in seconds to which the levels refer.
    levels, slopes : Levels and slopes per second of the outputs, `ny` each.
    input_levels, input_slopes : The same for the inputs.
    """

    begin: float
    levels: Numbers
    slopes: Numbers
    input_levels: Numbers = ()
    input_slopes: Numbers = ()

    @property
    def timed(self) -> bool:
        """Return whether it removes straight lines."""
        return any((*self.slopes, *self.input_slopes))

    @classmethod
    def of(cls, record: Record, order: int) -> Detrended:
        """Fit means (order 0) or straight lines (order 1) to a record."""
        time = seconds(record)
        begin = float(time[0]) if order else 0.0
        fits = [
            _line(time - begin, signal, order)
            for of in (record.y_with_gaps, record.u)
            if of is not None
            for signal in of.T
        ]
        levels, slopes = zip(*fits, strict=True)
        ny = record.ny
        return cls(begin, levels[:ny], slopes[:ny], levels[ny:], slopes[ny:])

    def transform(self, what: What, signal: Array, time: Array) -> Array:
        """Return a signal without its trend."""
        return signal - self._lines(what, time)

    def undo(self, what: Literal["y", "u"], signal: Array, time: Array) -> Array:
        """Return a signal with its trend."""
        return signal + self._lines(what, time)

    def counted_from(self, begin: float) -> Detrended:
        """Return the same trend for times counted from `begin`."""
        return replace(self, begin=self.begin - begin)

    def _lines(self, what: What, time: Array) -> Array:
        """Return the straight lines of a signal at `time`, `(time, channels)`."""
        of_inputs = self.input_levels, self.input_slopes
        levels, slopes = of_inputs if what == "u" else (self.levels, self.slopes)
        if not any(slopes):
            return np.array([levels])
        return np.array(levels) + (time - self.begin)[:, None] * np.array(slopes)


@final
@dataclass(frozen=True)
class Clipped(Preparation):
    """Limit each output to a range.

    `low` and `high` hold the limits of each output.
    """

    low: Numbers
    high: Numbers

    @classmethod
    def of(cls, record: Record, deviations: float, columns: Sequence[str]) -> Clipped:
        """Return limits of `deviations` robust standard deviations around the medians of columns.

        Others have none.
        """
        seen = record.y_with_gaps
        middle = np.nanmedian(seen, axis=0)
        # The factor turns the median deviation into the standard deviation of a Gaussian.
        reach = deviations * 1.4826 * np.nanmedian(abs(seen - middle), axis=0)
        chosen = np.array([bool({name, bare_name(name)} & {*columns}) for name in record.columns])
        reach = np.where(chosen & (reach > 0), reach, np.inf)
        return cls(tuple(map(float, middle - reach)), tuple(map(float, middle + reach)))

    def transform(self, what: What, signal: Array, time: Array) -> Array:
        """Return measured samples limited to the range; NaN stays NaN."""
        if what != "y":
            return signal
        clipped = np.clip(signal, np.array(self.low), np.array(self.high))
        return np.where(np.isnan(signal), signal, clipped)


@final
@dataclass(frozen=True)
class Resampled(Preparation):
    """Replace every `factor` samples by the mean of those measured, without looking ahead.

    Samples that are too few for a mean are dropped at the beginning of the record. The time stamp
    of a mean is that of its last sample. Predictions, and the inputs given for them, have the new
    sampling time.

    `factor` is the number of samples per mean.
    """

    factor: int

    def apply(self, record: Record) -> Record:
        """Return the resampled record."""
        k = self.factor
        if len(record) < 2 * k:
            raise InputError(f"record must have {2 * k} samples to be resampled, got {len(record)}")
        first = len(record) % k
        changed: dict[str, Any] = {}
        for field, signal in signals_of(record).items():
            kept = signal[first : len(signal) - (len(signal) - first) % k]
            changed[field] = kept.reshape(-1, k, signal.shape[1]).mean(axis=1)
        if record.measured is not None:
            known = record.y_with_gaps[first:].reshape(-1, k, record.ny)
            count = np.isfinite(known).sum(axis=1)
            means = np.nansum(known, axis=1) / np.maximum(count, 1)
            changed |= {"y": np.where(count > 0, means, changed["y"]), "measured": count > 0}
        step, start = record.sampling_time, record.start
        if start is not None:
            start = stamp_after(start, (first + k - 1) * step)
        return replace(record, sampling_time=k * step, start=start, **changed)


def signals_of(record: Record) -> dict[str, Array]:
    """Return the signals that a record has, `(time, channels)` each, by the names of its fields."""
    found = {"y": record.y, "y_true": record.y_true, "y_sim": record.y_sim, "u": record.u}
    return {name: signal for name, signal in found.items() if signal is not None}


def seconds(record: Record) -> Array:
    """Return the times of a record in seconds, `(time,)`; for dates, since 1970."""
    start = record.start
    begin = start.timestamp() if isinstance(start, pd.Timestamp) else seconds_of(start)
    return np.asarray(begin + record.sampling_time * np.arange(float(len(record))))


def _line(time: Array, signal: Array, order: int) -> tuple[float, float]:
    """Fit the level and slope of the measured samples."""
    known = ~np.isnan(signal)
    if not order:
        return float(signal[known].mean()), 0.0
    slope, level = np.polyfit(time[known], signal[known], 1)
    return float(level), float(slope)
