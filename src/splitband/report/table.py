"""Make the table of a comparison: one list of columns that every renderer shows.

The command line, the page, results.json and `Comparison.table` all read it, so that they agree.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any, Literal

import pandas as pd

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.recommendation import LEVEL, WORTH_TRAINING, Trial
from splitband.forecasters.backtest import Fit
from splitband.forecasters.prediction import Prediction
from splitband.metrics import channel_rmse, fit_percent, leaving
from splitband.report.numbers import aligned, decimals, number, percent
from splitband.runtime.arrays import Array

Unit = Literal["percent", "record", "deviation", "share", "seconds", "count"]
"""Unit of a column: percent, the output's unit, its standard deviation, 0 to 1, seconds, none."""
FARTHEST = -999.0
"""Percent: a worse fit is shown as less than this."""

NOTES = {
    "test fit %": "100 (1 - |y - prediction| / |y - mean(y)|) of the simulation of this test "
    "record: 100 is perfect, 0 is as good as the mean of the record",
    "forecast fit %": "100 (1 - |y - prediction| / |y - mean(y)|) of the forecast: 100 is perfect, "
    "0 is as good as the mean of the samples after the training part",
    "test RMSE": "root mean squared error of the simulation of this test record",
    "forecast RMSE": "root mean squared error of the forecast after the training part",
    "score": "the lowest is recommended: the held-out RMSE in standard deviations, of several "
    f"outputs the root of the sum of squares; networks carry a penalty of {WORTH_TRAINING:.0%}",
    "in interval": f"share of the measured samples in the forecast's interval; {LEVEL:.0%} is "
    "ideal",
    "held-out RMSE": "error on the last quarter of the training samples, by models trained on "
    "the rest",
    "RMSE from the start": "of the simulation from the first samples to the end of the record",
    "fit % from the start": "of the same simulation",
    "fit (s)": "seconds of one training, on average",
    "trainings": "how many the median is of; after ±: the standard deviation of their errors",
}
"""What each column means; each heading needs an entry. The order is that of the columns: a narrow
terminal leaves out the last ones."""


@dataclass(frozen=True)
class Column:
    """Hold a column: a number for each method, of one channel or of all.

    Attributes
    ----------
    heading : What it is called.
    unit : Unit of its numbers.
    values : Numbers by method; a method that has none is missing.
    channel : The channel; empty if the number is over all channels, or the record has only one.
    record : Name of the test record; empty for the record of the comparison.
    spreads : Standard deviation over the seeds, by method, if there are several.
    ranked : Whether the lowest number (of percents, the highest) is the best one.
    measure : The unit of the output, as given in its name, such as "m".
    """

    heading: str
    unit: Unit
    values: Mapping[str, float]
    channel: str = ""
    record: str = ""
    spreads: Mapping[str, float] = field(default_factory=dict)
    ranked: bool = True
    measure: str = ""

    @property
    def title(self) -> str:
        """Return the heading with the test record and the channel."""
        what = f"{self.heading} {self.record}" if self.record else self.heading
        return f"{what}, {self.channel}" if self.channel else what

    @property
    def note(self) -> str:
        """Return the explanation of the heading."""
        return NOTES[self.heading]

    @property
    def label(self) -> str:
        """Return the title with the unit, unless the channel's name says it."""
        said = self.measure and self.unit == "record" and not self.channel
        return f"{self.title} ({self.measure})" if said else self.title

    @property
    def best(self) -> str:
        """Return the best method; empty if the column is not ranked."""
        known = {name: value for name, value in self.values.items() if value == value}  # noqa: PLR0124
        if not (known and self.ranked):
            return ""
        return (max if self.unit == "percent" else min)(known, key=lambda name: known[name])

    def entry(self, method: str) -> str:
        """Return the text of a method's cell, with the spread of its seeds."""
        value = self.values.get(method)
        if value is None or value != value:  # noqa: PLR0124  NaN
            return number(None)
        if self.unit == "share":
            return percent(value)
        if self.unit == "percent" and value < FARTHEST:
            return f"< {FARTHEST:.0f}"
        if self.unit in ("percent", "seconds"):
            return f"{round(value, 1) + 0.0:.1f}"
        text = aligned(value, self._decimals)
        spread = self.spreads.get(method)
        return text if spread is None else f"{text} ± {aligned(spread, self._decimals)}"

    @property
    def _decimals(self) -> int:
        return 0 if self.unit == "count" else decimals([*self.values.values()])

    def as_json(self) -> dict[str, Any]:
        """Return the column as in results.json."""
        return {
            "heading": self.heading,
            **({"record": self.record} if self.record else {}),
            **({"channel": self.channel} if self.channel else {}),
            "note": self.note,
            "unit": self.unit,
            **({"measure": self.measure} if self.measure and self.unit == "record" else {}),
            "values": {name: v for name, v in self.values.items() if math.isfinite(v)},
            **({"spreads": dict(self.spreads)} if self.spreads else {}),
        }


def columns(comparison: Comparison) -> list[Column]:
    """Return the columns of a comparison: fit and error first, then supporting numbers.

    Errors are of the median of the seeds' predictions, which is the method's prediction, for each
    output separately. Their spread is the standard deviation of the single seeds' errors.
    """
    runs, record, ahead = comparison.fits, comparison.record, bool(comparison.predictions)
    found: list[Column] = []
    for i, test in enumerate(comparison.tests):
        tested = _errors(comparison, ("test fit %", "test RMSE"), test, of_test(i))
        found += [replace(column, record=test.name or str(i + 1)) for column in tested]
    if ahead:
        headings = "forecast fit %", "forecast RMSE"
        found += _errors(comparison, headings, record, lambda run: run.forecast)
    found += [] if comparison.trial is None else tried(comparison.trial, record, [*runs])
    headings = "fit % from the start", "RMSE from the start"
    found += _errors(comparison, headings, record, lambda run: run.from_start)
    if ahead and comparison.trial is not None:
        held = {name: comparison.coverages(name) for name in runs}
        found += _by_channel("in interval", held, record, "share")
    if any(len(of_method) > 1 for of_method in runs.values()):
        counts = {name: float(len(of_method)) for name, of_method in runs.items()}
        found.append(Column("trainings", "count", counts, ranked=False))
    seconds = {name: statistics.mean(r.report.seconds for r in rs) for name, rs in runs.items()}
    found.append(Column("fit (s)", "seconds", seconds, ranked=False))
    importance = [*NOTES]
    return sorted(found, key=lambda column: importance.index(column.heading))


def ordered(trial: Trial | None, methods: Iterable[str]) -> list[str]:
    """Return the methods sorted by their score, the recommended one first."""
    if trial is None:
        return [*methods]
    return sorted(methods, key=lambda name: (name in trial.left_out, trial.worth(name)))


def tried(trial: Trial, record: Record, methods: Sequence[str]) -> list[Column]:
    """Return the columns of a trial: score and held-out error."""
    scores = {name: trial.worth(name) for name in methods if name in (trial.final or trial.scores)}
    held_out = {name: trial.errors[name] for name in methods}
    return [Column("score", "deviation", scores), *_by_channel("held-out RMSE", held_out, record)]


def remarks(comparison: Comparison) -> dict[str, str]:
    """Return the remarks on each method, or why it failed.

    The methods are in the order of the table's rows.
    """
    found = {}
    for name in ordered(comparison.trial, comparison.fits):
        left = leaving_range(comparison, name)
        found[name] = "; ".join(filter(None, (left, comparison.fits[name][0].description)))
    missing = {} if comparison.trial is None else comparison.trial.without_result
    return found | {name: why for name, why in missing.items() if name not in found}


def leaving_range(comparison: Comparison, name: str) -> str:
    """Return when a forecast of a method leaves the training range, in words; else empty."""
    left = comparison.leaves(name)
    return "" if left is None else leaving(left)


def frame(result: Comparison) -> pd.DataFrame:
    """Return a row for each method, see `Comparison.table`."""
    notes = remarks(result)
    table: dict[str, Mapping[str, object]] = {}
    for column in columns(result):
        table[column.title] = column.values
        if column.spreads:
            table[f"{column.title}, spread"] = column.spreads
    table["note"] = notes
    if result.trial is not None:
        table["recommended"] = {name: name == result.recommended for name in result.fits}
    return pd.DataFrame(table, index=[*notes]).rename_axis("method")


def as_text(comparison: Comparison, width: int = 100) -> str:
    """Return the table with as many columns as fit into `width` characters, fit % first."""
    listed, rows = columns(comparison), remarks(comparison)
    best = "" if comparison.trial is None else comparison.recommended
    names = [f"{'*' if name == best else ' '} {name}" for name in rows]
    table = pd.DataFrame(
        {column.label: [column.entry(name) for name in rows] for column in listed},
        index=pd.Index(names, name="  method"),
    ).reset_index()
    text = table.to_string(index=False)
    while len(text.partition("\n")[0]) > width and len(table.columns) > 2:
        table = table.iloc[:, :-1]
        text = table.to_string(index=False)
    missing = {} if comparison.trial is None else comparison.trial.without_result
    said = [f"\n{name}: {why}" for name, why in missing.items()]
    return f"{comparison!r}\n\n{text}{''.join(said)}"


def as_html(comparison: Comparison) -> str:
    """Return the table as HTML without style, the recommended method first, for notebooks."""
    listed, rows = columns(comparison), remarks(comparison)
    heads = "".join(f"<th>{escape(column.label)}</th>" for column in listed)
    body = []
    for name in rows:
        cells = "".join(
            f"<td>{'<b>' * best}{escape(column.entry(name))}{'</b>' * best}</td>"
            for column in listed
            for best in [column.best == name]
        )
        body.append(f"<tr><th>{escape(name)}</th>{cells}</tr>")
    table = f"<table><thead><tr><th>method</th>{heads}</tr></thead><tbody>{''.join(body)}</tbody>"
    return f"<p>{escape(repr(comparison))}</p>{table}</table>"


def _errors(
    comparison: Comparison,
    headings: tuple[str, str],
    record: Record,
    predicted: Callable[[Fit], Prediction | None],
) -> list[Column]:
    """Return the columns of fit and RMSE on a record, of each method's median over seeds."""
    fits, errors, spreads = {}, {}, {}
    for name, runs in comparison.fits.items():
        median = predicted(comparison.medians[name])
        if median is None:
            continue
        truth = record.truth[len(record) - len(median) :]
        fits[name], errors[name] = fit_percent(truth, median.y), channel_rmse(truth, median.y)
        each = [channel_rmse(truth, p.y) for run in runs if (p := predicted(run)) is not None]
        if len(each) > 1:
            spreads[name] = [statistics.stdev(of_seeds) for of_seeds in zip(*each, strict=True)]
    fit, error = headings
    return [
        *_by_channel(fit, fits, record, "percent"),
        *_by_channel(error, errors, record, "record", spreads),
    ]


def of_test(i: int) -> Callable[[Fit], Prediction | None]:
    """Return a function that gives a run's prediction of the i-th test record, or None."""
    return lambda run: run.tests[i] if run.tests else None


def _by_channel(
    heading: str,
    values: Mapping[str, Sequence[float] | Array],
    record: Record,
    unit: Unit = "record",
    spreads: Mapping[str, Sequence[float]] | None = None,
) -> list[Column]:
    return [
        Column(
            heading,
            unit,
            {name: float(of_method[i]) for name, of_method in values.items()},
            channel if record.ny > 1 else "",
            spreads={name: float(of_method[i]) for name, of_method in (spreads or {}).items()},
            ranked=unit != "share",
            measure=measure,
        )
        for i, (channel, measure) in enumerate(zip(record.columns, record.units, strict=True))
    ]
