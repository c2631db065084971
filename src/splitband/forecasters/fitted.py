"""Hold the results of a fit: the training record, ranges, and a report."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from splitband.metrics import Extrapolation, extrapolations, input_range
from splitband.records import Record
from splitband.records.timing import Stamp, as_stamp, in_words, seconds_between
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.simulators.base import Absent

NEAR_ROW = 1e-3
"""Tolerance in samples: a history that begins this close to a training sample begins at it.
Rounding."""


def unmoved(records: Sequence[Record]) -> list[str]:
    """Return a remark on the inputs that are constant in all training records, if there are any."""
    inputs = [r.u for r in records if r.u is not None]
    names = records[0].inputs if inputs else ()
    still = [name for j, name in enumerate(names) if max(np.ptp(u[:, j]) for u in inputs) == 0]
    return [f"constant in training, effect unknown: {', '.join(still)}"] if still else []


@dataclass(frozen=True)
class FitReport:
    """Report how a fit went.

    Attributes
    ----------
    seed : Of the fit.
    seconds : Run time of the fit.
    losses : Mean training loss of each epoch, by network.
    notes : Remarks on the training record, and problems in training that were corrected.
    cut : Whether a deadline ended the training early.
    growth : Factor by which an error of a simulation grows each sample; above 1 where it is known
        that a simulation may grow without bound. Of a network that of its linear part.
    reach : Samples ahead for which forecasts of an unstable plant are worth making; None for a
        plant that is stable, as far as is known.
    parameters : The fitted parameters of a simulator, in a form that JSON can hold.
    """

    seed: int = 0
    seconds: float = 0.0
    losses: Mapping[str, Sequence[float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    cut: bool = False
    growth: float = 1.0
    reach: int | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict)

    @property
    def stable(self) -> bool:
        """Return whether nothing is known of a simulation that grows without bound."""
        return self.growth <= 1

    def unstable(self) -> str:
        """Return in words that it is unstable, and how far; empty for a stable model."""
        if self.stable:
            return ""
        if self.reach is None:
            return (
                f"perhaps unstable: its linear part has the pole {self.growth:.4g}, so that a "
                "simulation may grow without bound where it leaves the range of training"
            )
        doubled = math.log(2) / math.log(self.growth)
        return (
            f"unstable: largest pole {self.growth:.4g}, an error doubles every {doubled:.3g} "
            f"samples; forecasts up to {self.reach} samples ahead"
        )


@dataclass(frozen=True, eq=False)
class Fitted:
    """Hold the records that a forecaster was fitted to, and the report of the fit.

    Attributes
    ----------
    record : The first training record, or as much of its end as a forecast needs.
    begin : Number of samples that were dropped before `record`.
    start : Time stamp of the first training sample, before any were dropped.
    y_range : Lowest and highest measured value of each channel in all records, `(2, ny)`.
    u_summary : Lowest, highest and mean value of each input in all records, `(3, nu)`.
    others : The other training records, which are not saved.
    report : Of the fit.
    whole : Whether `others` holds all other training records.
    simulator : The one that computed the output in `record`, where that is known.
    """

    record: Record
    begin: int
    start: Stamp | None
    y_range: Array
    u_summary: Array | None
    others: tuple[Record, ...] = ()
    report: FitReport = field(default_factory=FitReport)
    whole: bool = True
    simulator: Absent | None = None

    def __post_init__(self) -> None:
        """Check what may come from a file."""
        whole("begin", self.begin, 0)
        if self.start is not None:
            as_stamp(self.start)

    def reporting(self, **changes: Any) -> Fitted:
        """Return it with changes to the report."""
        return replace(self, report=replace(self.report, **changes))

    def end(self, first: int) -> Fitted:
        """Return the version to save, with the training record from its sample `first` on."""
        whole, begin = self.whole and not self.others, self.begin + first
        # Without the run time, the same fit is saved as the same file, byte by byte.
        saved = self.reporting(seconds=0.0, parameters={})
        return replace(saved, record=self.record[first:], begin=begin, others=(), whole=whole)

    @classmethod
    def of(cls, records: Sequence[Record], seed: int) -> Fitted:
        """Return records, ranges and an empty report, before the fit."""
        seen = np.concatenate([record.y_with_gaps for record in records])
        y_range = np.stack([np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)])
        inputs, u_summary = [record.u for record in records if record.u is not None], None
        if inputs:
            u_summary = np.stack([*input_range(inputs), np.concatenate(inputs).mean(axis=0)])
        first, *others = records
        of_first = first, 0, first.start, y_range, u_summary
        return cls(*of_first, tuple(others), FitReport(seed), simulator=first.simulator)

    def is_of(self, records: Sequence[Record]) -> bool:
        """Return whether these records are all that were fitted to, sample by sample."""
        own = [self.record, *self.others]
        return self.whole and len(own) == len(records) and all(map(_alike, own, records))

    def begins_and_ends_like(self, other: Fitted) -> bool:
        """Return whether both are of the same first record, of which each may hold an end."""
        kept = min(len(self.record), len(other.record))
        ours, theirs = (each.record.y_with_gaps[-kept:] for each in (self, other))
        alike = self.start == other.start and np.array_equal(ours, theirs, equal_nan=True)
        return alike and self.begin + len(self.record) == other.begin + len(other.record)

    def begins(self, history: Record) -> float:
        """Return where a history begins, in samples after the first training sample."""
        step = self.record.sampling_time
        if self.start is None or history.start is None:
            return 0.0
        begin = seconds_between(self.start, history.start) / step
        return float(round(begin)) if abs(begin - round(begin)) < NEAR_ROW else begin

    def beginning(self, history: Record) -> str:
        """Return in words when a history begins, relative to the training record; empty for 0."""
        if history.start is None and self.start is not None:
            return (
                "the history has no time stamps: it is taken to begin where the training record "
                f"did, at {in_words(self.start)}"
            )
        if history.start is not None and self.start is None:
            return (
                "the model does not know when its training record began: it is taken to begin with "
                "the history"
            )
        later = self.begins(history) * self.record.sampling_time
        return f"the history begins {later:+.7g} s after the training record" if later else ""

    def late_inputs(self, delays: Sequence[int]) -> str:
        """Return the dead times of the inputs in words; empty for none.

        Each delay is the sample at which the impulse response begins. A held input acts one sample
        late by itself, so that the dead time is one sample less.
        """
        step, names = self.record.sampling_time, self.record.inputs
        said = [
            f"{name} {late - 1} samples ({(late - 1) * step:.4g} s; "
            f"its impulse response begins at sample {late})"
            for name, late in zip(names, delays, strict=False)
            if late > 1
        ]
        return f"dead time {', '.join(said)}" if said else ""

    def inputs_beyond(self, u: Array | None) -> list[Extrapolation]:
        """Return which inputs `u`, `(time, nu)`, leave their range in training."""
        if u is None or self.u_summary is None:
            return []
        low, high, _ = self.u_summary
        return extrapolations(low, high, u)

    def outputs_beyond(self, y: Array) -> list[Extrapolation]:
        """Return which measured outputs `y`, `(time, ny)`, leave their range in training.

        Such outputs may be in other units.
        """
        low, high = self.y_range
        found = extrapolations(low, high, y)
        return [replace(each, kind="output") for each in found]


def _alike(one: Record, other: Record) -> bool:
    """Return whether two records are equal in all that a fit sees of them."""
    ours, theirs = ((each.y_with_gaps, each.u, each.y_sim) for each in (one, other))
    return one.grid == other.grid and all(
        a is b or (a is not None and b is not None and np.array_equal(a, b, equal_nan=True))
        for a, b in zip(ours, theirs, strict=True)
    )


def first_only(fitted: Fitted) -> str:
    """Return the end of a description, on further training records that were not used."""
    several = fitted.others or not fitted.whole
    return "; fitted to the first record only" if several else ""
