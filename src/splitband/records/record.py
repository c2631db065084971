"""Define the data container: an evenly sampled record with its inputs and simulator output."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from splitband.records.plausibility import warnings_of
from splitband.records.preparation import (
    Limits,
    Periods,
    Reading,
    clipped,
    detrended,
    limits_given,
    limits_of,
    lines_of,
    of_channels,
    periods_of,
    resampled,
    signals_of,
    unwrapped,
)
from splitband.records.signals import (
    ReadingWarning,
    as_float,
    channel_names,
    described,
    filled,
    numbered,
    positive_seconds,
    refilled,
    require_finite,
    row_ranges,
    same_names,
    signal_of,
    unit_of,
)
from splitband.records.timing import (
    Grid,
    Stamp,
    as_stamp,
    near_sampling,
    seconds_of,
    stamp_after,
    stamps_at,
    whole_multiple,
)
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.errors import InputError


@dataclass(frozen=True, eq=False, repr=False)
class Record:
    """A record: measured outputs and inputs on one time grid.

    Every signal is array-like of shape (time,) or (time, channels); it is kept as a read-only,
    C-contiguous float64 array of shape (time, channels): a copy, unless it is one that nobody can
    change, such as that of another record. A slice holds views.

    Parameters
    ----------
    y : the measured signal, (time, ny), at least two samples; `with_gaps` takes one with NaN.
    sampling_time : seconds between two samples.
    u : known inputs, (time, nu): forces, set-points, or another model's prediction.
    y_true : the noise-free signal where it is known, (time, ny).
    y_sim : the simulator's output, (time or more, ny): a calibrated delay or clock may need it
        after the record's end.
    name : name of the record in plots and tables.
    columns : names of the channels of y; by default "y", or "y0", "y1", ...
    inputs : names of the inputs; by default "u", or "u0", "u1", ...
    measured : where y was measured, (time, ny); other values are fillers, and are excluded from
        every comparison. None: everywhere.
    start : time stamp of the first sample, seconds or a date. None for a record without time
        stamps: other signals are then assumed to begin with it.
    reading : the periods, limits, step and levels that reading, `unwrap`, `clip_outliers`,
        `resample` and `detrend` have used; they tell the units of the samples.
    simulator : description of the simulator that computed y_sim, if splitband ran it; a saved
        model recognises the simulator by it.

    Raises
    ------
    ValueError
        If a signal is not real and finite, exceeds 1e120 or has a range below 1e-120 (squares would
        overflow or vanish), lengths or channels differ, there are fewer than two samples, the
        sampling time is not positive, or `start` is no time stamp. Rows are counted from 0.

    Examples
    --------
    >>> record = sb.Record([0.0, 0.2, 0.3, 0.3], sampling_time=0.5, u=[1, 1, 0, 0])
    >>> record.y.shape, record.time
    ((4, 1), array([0. , 0.5, 1. , 1.5]))
    """

    y: Array
    sampling_time: float
    u: Array | None = None
    y_true: Array | None = None
    y_sim: Array | None = None
    name: str = ""
    columns: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    measured: Flags | None = None
    start: Stamp | None = None
    reading: Reading = field(default_factory=Reading)
    simulator: Any = field(default=None, repr=False)

    def __post_init__(self) -> None:
        y = signal_of("y", self.y)
        if len(y) < 2:
            raise InputError(f"y must have at least 2 samples: it has {len(y)}")
        columns = channel_names("columns", self.columns, "y", y.shape[1])
        require_finite("y", y, columns)
        vars(self)["y"] = y
        self._keep("u", len(y))
        inputs = channel_names("inputs", self.inputs, "u", self.nu)
        self._keep("y_true", len(y), columns)
        self._keep("y_sim", len(y), columns)
        start = None if self.start is None else as_stamp(self.start)
        step = positive_seconds(self.sampling_time)
        vars(self).update(columns=columns, inputs=inputs, sampling_time=step, start=start)
        if self.measured is not None:
            measured = np.array(self.measured, dtype=np.bool_)
            measured = measured[:, None] if measured.ndim == 1 else measured
            if measured.shape != y.shape:
                raise InputError(
                    f"measured must have the shape of y, {y.shape}: it is {measured.shape}"
                )
            measured.setflags(write=False)
            vars(self)["measured"] = None if measured.all() else measured

    def _keep(self, field: str, samples: int, names: tuple[str, ...] = ()) -> None:
        """Check a signal, and keep it as an array."""
        if (value := vars(self)[field]) is None:
            return
        signal, more = signal_of(field, value), " or more" if field == "y_sim" else ""
        rows = min(len(signal), samples) if more else len(signal)
        if rows != samples or len(names) not in (0, signal.shape[1]):
            shape = f"({samples}{more}, {len(names) or 'any number'})"
            raise InputError(f"{field} must have the shape {shape}: its shape is {signal.shape}")
        require_finite(field, signal, names or numbered("u", signal.shape[1]))
        vars(self)[field] = signal

    @classmethod
    def with_gaps(cls, y: Any, sampling_time: float, u: Any = None, **others: Any) -> Record:
        """Return a record of y and u that may contain NaN or infinite values.

        Missing outputs are interpolated linearly. A missing input keeps its last value, as a
        command does between samples, unless `reading` says that it is interpolated; with a warning,
        since this value drives simulators and models. Its sample and the next one, which also
        depends on it, do not count as measured.
        """
        y, measured = filled("y", signal_of("y", y))
        reading, known = others.get("reading", Reading()), None
        if u is not None:
            u = signal_of("u", u)
            inputs = channel_names("inputs", others.get("inputs", ()), "u", u.shape[1])
            u, known = filled("u", u, reading.hold is None or reading.holds(inputs))
            if len(u) == len(y):  # the constructor refuses any other length
                driven = np.asarray(known.all(axis=1, keepdims=True))
                measured = np.asarray(measured & driven & np.concatenate([driven[:1], driven[:-1]]))
        record = cls(y, sampling_time, u=u, measured=measured, **others)
        alike = dict[tuple[str, str], list[str]]()
        for name, lacks in zip(record.inputs, () if known is None else ~known.T, strict=False):
            if lacks.any():
                how = "held there at the last value"
                if reading.hold is None:
                    how += "; interpolate beforehand what changes smoothly"
                elif name not in reading.hold:
                    how = "interpolated there"
                where = f"{lacks.sum()} of {len(record)} samples ({row_ranges(lacks)})"
                alike.setdefault((where, how), []).append(repr(name))
        for (where, how), lacking in alike.items():
            what, verb = ("inputs", "are") if len(lacking) > 1 else ("input", "is")
            warnings.warn(
                f"{record.name or 'the record'}: {what} {', '.join(lacking)} {verb} missing in "
                f"{where} and {verb} {how}",
                ReadingWarning,
                stacklevel=2,
            )
        return record

    def __len__(self) -> int:
        return len(self.y)

    def __getitem__(self, key: slice) -> Record:
        """Return the slice `key` of every signal, with its time stamps.

        Without time stamps, `time` starts at 0 again.
        """
        if not isinstance(key, slice):
            raise TypeError(f"a Record takes slices only, as in traj[a:b]: got {key!r}")
        if key.step not in (None, 1):
            raise InputError(f"a Record takes slices of step 1 only: got step {key.step}")
        begin, end, _ = key.indices(len(self))
        parts: dict[str, Any] = {name: x[begin:end] for name, x in signals_of(self).items()}
        if self.measured is not None:  # gaps are filled again, from the slice only
            parts["y"] = refilled(self.y[key], self.y_with_gaps[key])
            measured = self.measured[key]
            parts["measured"] = None if measured.all() else measured
        start = self.start
        if start is not None:
            start = stamp_after(start, begin * self.sampling_time)
        if len(parts["y"]) < 2:
            raise InputError(f"y must have at least 2 samples: it has {len(parts['y'])}")
        parts["y"].setflags(write=False)
        # Views of what was checked: copies of a long record would take much memory.
        part = copy(self)
        vars(part).update(start=start, **parts)
        return part

    def to_frame(self) -> pd.DataFrame:
        """Return a table of time stamps, inputs and outputs, with NaN in gaps."""
        header = "time (s)" if "time" in (*self.columns, *self.inputs) else "time"
        parts = [pd.DataFrame({header: self.stamps})]
        parts += [] if self.u is None else [pd.DataFrame(self.u, columns=self.inputs)]
        return pd.concat([*parts, pd.DataFrame(self.y_with_gaps, columns=self.columns)], axis=1)

    def warnings(self) -> list[str]:
        """Return what seems wrong in the record, a sentence each, with the way out.

        These are angles and counters that jump; outliers; outputs that are constant, stuck or
        saturated; inputs that hardly move, that repeat an output, or that come after it.

        Examples
        --------
        >>> turning = 3.0 * np.arange(300) % 360
        >>> sb.Record(turning, 0.1, columns=["yaw"]).warnings()[0]
        "'yaw' jumps by 360 at rows 120, 240, as an angle ... unwrap={'yaw': 360} ..."
        """
        return warnings_of(self)

    def unwrap(self, periods: Periods) -> Record:
        """Return the record with angles and counters that go on where they jump.

        Unwrap before all other preparation. Predictions of a model then go on beyond a turn, too.

        Parameters
        ----------
        periods : Periods of outputs and inputs, by name: {"heading": 360}. None, or a name alone,
            takes the period that the jumps show, which `reading.periods` reports.
        """
        return unwrapped(self, Reading(periods=periods_of(self.signals, periods)))

    def clip_outliers(
        self,
        deviations: float = 5.0,
        columns: Sequence[str] | None = None,
        limits: Limits | None = None,
    ) -> Record:
        """Return the record with outputs limited to a range, which `reading.limits` reports.

        Parameters
        ----------
        deviations : Distance of the limits from the median, in deviations, each 1.4826 times the
            median absolute deviation, which is robust to outliers.
        columns : The outputs to limit, by default all.
        limits : Lowest and highest values by name, such as those of another record; then
            `deviations` and `columns` do not count.
        """
        if not deviations > 0:
            raise InputError(f"deviations must be above 0, got {deviations}")
        if limits is None:
            columns = self.columns if columns is None else columns
            limits = limits_of(self.signals, columns, self.columns, deviations)
        return clipped(self, Reading(limits=limits_given(self, limits)))

    def resample(self, sampling_time: float) -> Record:
        """Return the record with a longer sampling time, a multiple of its own.

        Each new sample is the mean of the measured samples since the previous one, so nothing looks
        ahead; without any, it is not measured. Samples that are too few for a mean are dropped at
        the beginning. The time stamp of a mean is that of its last sample.
        """
        factor = round(positive_seconds(sampling_time) / self.sampling_time)
        if not whole_multiple(sampling_time, self.sampling_time):
            raise InputError(
                f"sampling_time must be a whole multiple of {self.sampling_time:g} s, "
                f"got {sampling_time:g}"
            )
        return resampled(self, factor) if factor > 1 else self

    def detrend(self, order: int = 0, levels: Mapping[str, float] | None = None) -> Record:
        """Return the record without the means, or straight lines, of its outputs and inputs.

        A model of the record takes and returns samples without them. `reading.levels` reports them,
        and `like` subtracts the same from another record.

        Parameters
        ----------
        order : 0 for means, 1 for straight lines, which needs time stamps.
        levels : What to subtract, by the names of outputs and inputs; by default their means.
        """
        if order not in (0, 1):
            raise InputError(f"order must be 0 (means) or 1 (straight lines), got {order}")
        if levels is None:
            return detrended(self, lines_of(self, order))
        if order:
            raise InputError(f"order must be left out where levels are given, got {order}")
        given = of_channels("levels", levels, [*self.signals])
        found = {name: as_float(level) for name, level in given.items()}
        if np.isnan([*found.values()]).any():
            raise InputError(f"levels must be numbers, got {levels}")
        return detrended(self, Reading(levels=found))

    def like(self, other: Record) -> Record:
        """Return the record, as it was measured, prepared like another one.

        The record is unwrapped, limited, resampled and detrended with the values in the other
        record's `reading`. A model takes only histories that are prepared like its training
        record, `model.fitted.record`.

        Raises ValueError if it has been prepared differently before, has other names, or lacks the
        time stamps of straight lines.
        """
        wanted = other.reading
        near = near_sampling(self.sampling_time, other.sampling_time)
        if self.reading.steps == wanted.steps and (near or wanted.step is None):
            return self
        periods = {name: p for name, p in wanted.periods.items() if name in self.signals}
        limits = {name: ends for name, ends in wanted.limits.items() if name in self.signals}
        done = Reading(), Reading(periods=periods), Reading(periods=periods, limits=limits)
        if self.reading.steps not in [each.steps for each in done]:
            raise InputError(
                f"{self.name or 'the record'} must be given as it was measured, to be prepared "
                f"like {other.name or 'the other'} ({wanted}), got {self.reading}"
            )
        found = self
        named = (self.columns, other.columns), (self.inputs, other.inputs)
        if all(same_names(*names) for names in named):  # numbered names match any others
            found = replace(self, columns=other.columns, inputs=other.inputs)
        if unknown := [name for name in found.signals if name not in other.signals]:
            raise InputError(
                f"{self.name or 'the record'} must have the names of {other.name or 'the other'}, "
                f"{', '.join(other.signals)}, got {', '.join(unknown)}"
            )
        found = found if self.reading.periods else unwrapped(found, wanted)
        found = found if self.reading.limits else clipped(found, wanted)
        found = found if near or wanted.step is None else found.resample(other.sampling_time)
        return detrended(found, wanted)

    @property
    def labels(self) -> tuple[list[str], list[str]]:
        """Return the names of outputs and of inputs with their units, as "tank (minus 20.3)"."""
        return [*map(self.reading.label, self.columns)], [*map(self.reading.label, self.inputs)]

    def __repr__(self) -> str:
        missing = int((~self.complete).sum())
        parts = [
            f"{len(self)} samples every {self.sampling_time:.6g} s",
            described(*self.labels),
            *([f"{missing} masked"] if missing else []),
            *self.reading.sentences,
            *(["a simulator's output"] if self.y_sim is not None else []),
        ]
        return f"<Record {self.name or 'without a name'}: {'; '.join(parts)}>"

    @property
    def y_with_gaps(self) -> Array:
        """Return the measured samples, (time, ny), with NaN in gaps."""
        return self.y if self.measured is None else np.where(self.measured, self.y, np.nan)

    @property
    def signals(self) -> dict[str, Array]:
        """Return the measured samples, NaN in gaps, and then the inputs, by name, (time,) each."""
        u = () if self.u is None else self.u.T
        return dict(zip((*self.columns, *self.inputs), (*self.y_with_gaps.T, *u), strict=True))

    @property
    def truth(self) -> Array:
        """Return what predictions are compared with, (time, ny): `y_true` or `y_with_gaps`."""
        return self.y_with_gaps if self.y_true is None else self.y_true

    @property
    def complete(self) -> Flags:
        """Return a mask of the samples at which every channel was measured, (time,)."""
        return np.asarray(~np.isnan(self.y_with_gaps).any(axis=1))

    @property
    def ny(self) -> int:
        """Return the number of measured channels."""
        return int(self.y.shape[1])

    @property
    def nu(self) -> int:
        """Return the number of known inputs; 0 without any."""
        return 0 if self.u is None else int(self.u.shape[1])

    @property
    def units(self) -> tuple[str, ...]:
        """Return the unit of each channel from its name: "m" of "position (m)"."""
        return tuple(unit_of(name) for name in self.columns)

    @property
    def sampling_rate(self) -> float:
        """Return the sampling rate in Hz."""
        return 1.0 / self.sampling_time

    @property
    def time(self) -> Array:
        """Return the time stamps in s, (time,); dates count from the first sample."""
        since_first = np.arange(len(self), dtype=np.float64) * self.sampling_time
        return seconds_of(self.start) + since_first

    @property
    def stamps(self) -> Array | pd.DatetimeIndex:
        """Return the time stamps for tables and pictures, (time,): seconds or dates."""
        start = 0.0 if self.start is None else self.start
        return stamps_at(start, self.sampling_time, np.arange(len(self)))

    @property
    def grid(self) -> Grid:
        """Return the grid of the sampling times."""
        return Grid(self.start, self.sampling_time, len(self))


def require_records(what: str, *given: Any) -> None:
    """Raise TypeError unless all are records; the message says how to make one."""
    for each in given:
        if not isinstance(each, Record):
            raise TypeError(
                f"{what} must be a Record, got {type(each).__name__}: splitband.Record(y, "
                "sampling_time) makes one of arrays, splitband.read one of a file or a DataFrame; "
                "several records are arguments of their own"
            )


def check_alike(other: Record, record: Record, name: str) -> None:
    """Check that another record, called `name` in messages, can be of the same system."""
    require_records(name, other)
    if (other.ny, other.nu) != (record.ny, record.nu):
        raise InputError(
            f"{name} must have the training record's {record.ny} channel(s) and {record.nu} "
            f"input(s), got {other.ny} and {other.nu}"
        )
    columns, inputs = (other.columns, record.columns), (other.inputs, record.inputs)
    for what, (names, known) in {"columns": columns, "inputs": inputs}.items():
        if not same_names(names, known):
            order = "in the order" if sorted(names) == sorted(known) else "those"
            raise InputError(
                f"{what} of {name} must be {order} of the training record, "
                f"{', '.join(known)}, got {', '.join(names)}"
            )
    held, asked = other.reading.holds(other.inputs), record.reading.holds(record.inputs)
    if None not in (other.reading.hold, record.reading.hold) and (held != asked).any():
        each = int((held != asked).argmax())
        ways = ("held", "interpolated")[:: 1 if asked[each] else -1]
        raise InputError(
            f"input {record.inputs[each]!r} of {name} must be {ways[0]} between its values, as in "
            f"the training record, got {ways[1]}; splitband.read(..., "
            "reading=model.fitted.record.reading) reads it alike, and hold (--hold) names what is "
            "held"
        )
    way_out = "; Record.like does that: history.like(model.fitted.record)"
    if other.reading.units != record.reading.units:
        raise InputError(
            f"{name} must be prepared like the training record, {record.reading}, got "
            f"{other.reading}{way_out}"
        )
    if not near_sampling(other.sampling_time, record.sampling_time):
        raise InputError(
            f"{name} must be sampled like the training record, every {record.sampling_time:g} s, "
            f"got every {other.sampling_time:g} s"
            + ("" if record.reading.step is None else way_out)
        )
