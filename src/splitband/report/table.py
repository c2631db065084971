"""The table of a comparison: one list of columns that every renderer shows.

The command line, the page, results.json and `Comparison.table` all read it, so that they agree.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.protocols import Run, by_channel
from splitband.evaluation.selection import (
    CHANGE_COUNTS,
    LEVEL,
    NETWORK_CHANGE_COUNTS,
    WORTH_TRAINING,
    Trial,
)
from splitband.forecasters.prediction import Prediction
from splitband.metrics import leaving

Unit = Literal["record", "deviation", "share", "seconds", "count"]
"""Of a column: the record's own unit, standard deviations of the record, 0 to 1, seconds, none."""

NOTES = {
    "score": "what the recommendation goes by, the lowest: the held-out error in standard "
    "deviations (of several channels the root of the sum of squares) or, where that is larger, "
    f"{CHANGE_COUNTS**0.5:.2g} times the change, of a network {NETWORK_CHANGE_COUNTS**0.5:.2g} "
    f"times; {WORTH_TRAINING:.0%} are added to a network's",
    "held out": "RMSE of forecasts of the last quarter of the training part, fitted to the rest",
    "changed": "RMSE between those fits' forecasts of what follows the training part and the final "
    "one; it should not be above the held-out error",
    "from the start": "RMSE of the simulation from the first samples to the end of the record",
    "forecast": "RMSE of the forecast from the end of the training part",
    "test": "RMSE of the simulation of this test record",
    "in interval": f"share of the forecast's samples in its interval; it should be {LEVEL:.0%}",
    "seeds": "trainings, of which the mean of the predictions is shown; after ±: the standard "
    "deviation of the errors of the single ones",
    "fit (s)": "seconds of one fit, mean over the seeds",
}
"""What the columns mean."""


@dataclass(frozen=True)
class Column:
    """A column: a number for each method, of one channel or of all.

    Attributes
    ----------
    heading : What it is called.
    unit : Of its numbers.
    values : By method; a method that has none is missing.
    channel : The measured column it is of; empty where it is of all of them, or the record has one.
    record : The test record it is of, by name; empty: the one that is compared on.
    spreads : Standard deviation over the seeds, by method, where there are several.
    ranked : Whether the lowest number is the best one.
    """

    heading: str
    unit: Unit
    values: Mapping[str, float]
    channel: str = ""
    record: str = ""
    spreads: Mapping[str, float] = field(default_factory=dict)
    ranked: bool = True

    @property
    def title(self) -> str:
        """The heading with the test record and the channel."""
        what = f"{self.heading} {self.record}" if self.record else self.heading
        return f"{what}, {self.channel}" if self.channel else what

    @property
    def note(self) -> str:
        """What it means."""
        return NOTES[self.heading]

    @property
    def best(self) -> str:
        """The method with the lowest number; empty where numbers are not ranked."""
        known = {name: value for name, value in self.values.items() if value == value}  # noqa: PLR0124
        return min(known, key=lambda name: known[name], default="") if self.ranked else ""

    def as_json(self) -> dict[str, Any]:
        """Return what results.json says of it."""
        return {
            "heading": self.heading,
            **({"record": self.record} if self.record else {}),
            **({"channel": self.channel} if self.channel else {}),
            "note": self.note,
            "unit": self.unit,
            "values": {name: v for name, v in self.values.items() if math.isfinite(v)},
            **({"spreads": dict(self.spreads)} if self.spreads else {}),
        }


def columns(comparison: Comparison) -> list[Column]:
    """Return the columns of a comparison, in the order in which they are shown.

    Errors are of the mean of the seeds' predictions, which is what is handed out, each channel by
    itself; beside them stands the standard deviation of the seeds' own errors.
    """
    runs, record, ahead = comparison.runs, comparison.record, bool(comparison.predictions)
    found = [] if comparison.trial is None else tried(comparison.trial, record, [*runs], ahead)
    found += _errors(comparison, "from the start", record, lambda run: run.from_start)
    if ahead:
        found += _errors(comparison, "forecast", record, lambda run: run.forecast)
    for i, test in enumerate(comparison.tests):
        tested = _errors(comparison, "test", test, _test(i))
        found += [replace(column, record=test.name or str(i + 1)) for column in tested]
    if ahead and comparison.trial is not None:
        held = {name: comparison.coverages(name) for name in runs}
        found += _by_channel("in interval", held, _channels(record), "share")
    if any(len(of_method) > 1 for of_method in runs.values()):
        counts = {name: float(len(of_method)) for name, of_method in runs.items()}
        found.append(Column("seeds", "count", counts, ranked=False))
    seconds = {name: statistics.mean(r.fit.seconds for r in rs) for name, rs in runs.items()}
    return [*found, Column("fit (s)", "seconds", seconds, ranked=False)]


def tried(trial: Trial, record: Record, methods: Sequence[str], ahead: bool = True) -> list[Column]:
    """Return the columns of what a trial has found: score, held-out error and change.

    Only a forecast of what lies `ahead` of the training part can change.
    """
    channels, settled = _channels(record), [name for name in methods if name in trial.final]
    scores = {name: trial.worth(name) for name in settled}
    found = [Column("score", "deviation", scores)]
    found += _by_channel("held out", {m: trial.errors[m] for m in methods}, channels)
    if ahead:
        changes = {name: trial.change(name) for name in settled}
        changed = _by_channel("changed", changes, channels)
        found += [replace(column, ranked=False) for column in changed]
    return found


def remarks(comparison: Comparison) -> dict[str, str]:
    """Return what is to be said of each method beside its numbers; why it failed, if it did."""
    found = {}
    for name, runs in comparison.runs.items():
        left = [run.leaves for run in runs if run.leaves is not None]
        said = [leaving(min(left)) if left else "", runs[0].description]
        found[name] = "; ".join(filter(None, said))
    failed = {} if comparison.trial is None else comparison.trial.failed
    return found | {
        name: f"could not be fitted: {reason}"
        for name, reason in failed.items()
        if name not in found
    }


def _errors(
    comparison: Comparison,
    heading: str,
    record: Record,
    predicted: Callable[[Run], Prediction | None],
) -> list[Column]:
    """Return the errors on a record of the mean of each method's seeds, and their spread."""
    means, spreads = {}, {}
    for name, runs in comparison.runs.items():
        of_mean = predicted(comparison.means[name])
        if of_mean is None:
            continue
        means[name] = by_channel(record, of_mean.y)
        each = [by_channel(record, p.y) for run in runs if (p := predicted(run)) is not None]
        if len(each) > 1:
            spreads[name] = [statistics.stdev(errors) for errors in zip(*each, strict=True)]
    return _by_channel(heading, means, _channels(record), "record", spreads)


def _test(i: int) -> Callable[[Run], Prediction | None]:
    """Return what takes the prediction of a test record out of a run, None where it has none."""
    return lambda run: run.tests[i] if run.tests else None


def _channels(record: Record) -> Sequence[str]:
    """Return what errors are said of: each measured column, or nothing in particular."""
    return record.columns if record.ny > 1 else ("",)


def _by_channel(
    heading: str,
    values: Mapping[str, Sequence[float]],
    channels: Sequence[str],
    unit: Unit = "record",
    spreads: Mapping[str, Sequence[float]] | None = None,
) -> list[Column]:
    return [
        Column(
            heading,
            unit,
            {name: float(of_method[i]) for name, of_method in values.items()},
            channel,
            spreads={name: float(of_method[i]) for name, of_method in (spreads or {}).items()},
            ranked=unit == "record",
        )
        for i, channel in enumerate(channels)
    ]
