"""Remember a fit: the training record, ranges, and how the fit went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from splitband.data import Record
from splitband.data.timing import Stamp, as_stamp, in_words, seconds_between
from splitband.metrics import Extrapolation, extrapolations, input_range
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

NEAR_ROW = 1e-3
"""Of a sample: a history that begins so close to a sample of the training record begins there.
By eye."""


@saved
@dataclass(frozen=True)
class FitReport:
    """Report what a fit did.

    Attributes
    ----------
    seed : It was given.
    seconds : How long it took.
    losses : Mean training loss of each epoch, by network.
    notes : What went wrong in training and was mended.
    cut : Whether a deadline ended the training before its time.
    stable : False where a simulation is known to be able to grow without bound.
    parameters : What is known of the fitted parameters of a simulator, as JSON can hold it.
    """

    seed: int = 0
    seconds: float = 0.0
    losses: Mapping[str, Sequence[float]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    cut: bool = False
    stable: bool = True
    parameters: Mapping[str, Any] = field(default_factory=dict)


@saved
@dataclass(frozen=True, eq=False)
class Fitted:
    """Remember the records that a forecaster was fitted to.

    Attributes
    ----------
    record : The first one, or the end of it that a forecast from there needs.
    begin : How many samples of it were dropped before `record`.
    start : Time stamp of its first sample.
    y_range : Lowest and highest measured value of each channel in all records, `(2, ny)`.
    u_summary : Lowest, highest and mean value of each input in all records, `(3, nu)`.
    others : The other training records, which are not saved.
    report : What the fit did.
    whole : Whether `others` are all that there were.
    """

    record: Record
    begin: int
    start: Stamp | None
    y_range: Array
    u_summary: Array | None
    others: tuple[Record, ...] = ()
    report: FitReport = field(default_factory=FitReport)
    whole: bool = True

    def __post_init__(self) -> None:
        """Check what may come from a file."""
        whole("begin", self.begin, 0)
        if self.start is not None:
            as_stamp(self.start)

    @property
    def several(self) -> bool:
        """Return whether there were further training records."""
        return bool(self.others) or not self.whole

    def end(self, first: int) -> Fitted:
        """Return what is saved: the training record from its sample `first` on."""
        end = replace(self.record[first:], beyond=None, u_beyond=None)
        # The run time is left out, so that the same fit is saved as the same file, byte by byte.
        report = replace(self.report, seconds=0.0)
        whole = self.whole and not self.others
        begin = self.begin + first
        return replace(self, record=end, begin=begin, others=(), report=report, whole=whole)

    @classmethod
    def of(cls, records: Sequence[Record], seed: int) -> Fitted:
        """Return what is known before anything is computed."""
        seen = np.concatenate([record.seen for record in records])
        inputs = [record.u for record in records if record.u is not None]
        return cls(
            records[0],
            0,
            records[0].start,
            np.stack([np.nanmin(seen, axis=0), np.nanmax(seen, axis=0)]),
            np.stack([*input_range(inputs), np.concatenate(inputs).mean(axis=0)])
            if inputs
            else None,
            tuple(records[1:]),
            FitReport(seed),
        )

    def begins(self, history: Record) -> float:
        """Return how many samples after the training record's first one a history begins."""
        step = self.record.sampling_time
        if self.start is None or history.start is None:
            return 0.0
        begin = seconds_between(self.start, history.start) / step
        return float(round(begin)) if abs(begin - round(begin)) < NEAR_ROW else begin

    def beginning(self, history: Record) -> str:
        """Return in words when a history begins, beside the training record; empty for with it."""
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
        """Return in words which inputs act late; empty for none."""
        step, names = self.record.sampling_time, self.record.inputs
        said = [f"{name}: {delay} samples ({delay * step:.4g} s)"
                for name, delay in zip(names, delays, strict=False) if delay]  # fmt: skip
        return f"input delay {', '.join(said)}" if said else ""

    def inputs_beyond(self, u: Array | None) -> list[Extrapolation]:
        """Return which inputs `u` `(time, nu)` go beyond those that were trained on."""
        if u is None or self.u_summary is None:
            return []
        low, high, _ = self.u_summary
        return extrapolations(low, high, u)


def first_only(fitted: Fitted) -> str:
    """Return the end of a description that says that further training records were not used."""
    return "; fitted to the first record only" if fitted.several else ""
