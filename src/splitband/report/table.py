"""Make tables: one list of columns, whatever shows it.

rich draws a table in terminals and as text, a template draws it in pages and notebooks; JSON and
data frames hold its numbers.
"""

from __future__ import annotations

import math
import statistics
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from html import escape
from io import StringIO
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
import rich.table
from rich.box import HEAVY_HEAD, Box
from rich.console import Console
from rich.measure import Measurement
from rich.text import Text

from splitband.baselines.accuracy import NORMAL
from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.recommendation import COVERAGE, RULE, Trial, by_reason
from splitband.evaluation.search import Attempt
from splitband.forecasters.base import Forecaster, titled
from splitband.forecasters.checking import Responses
from splitband.forecasters.linear import Linear
from splitband.forecasters.names import NAMES
from splitband.metrics import channel_rmse, fit_percent, leaving, tenths
from splitband.report.numbers import (
    aligned,
    complex_in_words,
    decimals,
    number,
    percent,
)
from splitband.report.predicted import Protocol, predicted, run_of, what_was_known
from splitband.runtime.arrays import Array

Unit = Literal["percent", "record", "deviation", "share", "seconds", "count"]
"""Unit of a column: percent, the output's unit, its standard deviation, 0 to 1, seconds, none."""
OVER_ALL: tuple[Unit, ...] = ("deviation", "seconds", "count")
"""Units of numbers that are over all outputs of a comparison."""

SHOWN = {"forecast fit %": "fit %", "forecast RMSE": "RMSE"}
"""Headings as tables show them, where a title says whether it is a forecast or a simulation."""
DECISIVE = frozenset({"test fit %", "forecast fit %", "score"})
"""Headings without which a table does not say what is recommended, and what it is worth."""
NARROW = 8
"""Characters of a heading's line, at least. Layout."""


class _Form(NamedTuple):
    """Say where the short names of rows stand in a terminal, and how wide their words may be."""

    names: Literal["beside", "below", ""]
    width: int
    narrow: int = 0  # where long words are broken: the width of outputs; 0 elsewhere


_BESIDE, _BELOW, _SHORT, _PLAIN = (
    _Form("beside", 1000), _Form("below", 40), _Form("", 24, 20), _Form("", 1000)
)  # fmt: skip
"""The last one is for rows that have no words beside their names. Layout."""


@dataclass(frozen=True)
class Column:
    """Hold a column: a number for each row, of one channel or of all."""

    heading: str
    unit: Unit
    values: Mapping[str, float]  # by row, such as methods; a row that has none is missing
    channel: str = ""  # empty if the number is over all channels, or the record has only one
    record: str = ""  # name of the test record; empty for the record of the comparison
    spreads: Mapping[str, float] = field(default_factory=dict)  # over the seeds, if several
    ranked: bool = True  # whether the lowest number (of percents, the highest) is the best one
    measure: str = ""  # the unit of the output, as given in its name, such as "m"

    @property
    def title(self) -> str:
        """Return the heading with the test record and the channel: the key in a data frame."""
        what = f"{self.heading} {self.record}" if self.record else self.heading
        return f"{what}, {self.channel}" if self.channel else what

    @property
    def shown(self) -> str:
        """Return the heading as tables show it, with the test record."""
        return f"{SHOWN.get(self.heading, self.heading)} {self.record}".rstrip()

    @property
    def note(self) -> str:
        """Return the explanation of the heading; empty if it needs none."""
        return COLUMNS[self.heading].note if self.heading in COLUMNS else ""

    @property
    def label(self) -> str:
        """Return the title as shown, with the unit unless the channel's name says it."""
        shown = f"{self.shown}, {self.channel}" if self.channel else self.shown
        said = self.measure and self.unit == "record" and not self.channel
        return f"{shown} ({self.measure})" if said else shown

    @property
    def best(self) -> str:
        """Return the best row; empty if the column is not ranked."""
        known = {name: value for name, value in self.values.items() if value == value}  # noqa: PLR0124
        if not (known and self.ranked):
            return ""
        return (max if self.unit == "percent" else min)(known, key=lambda name: known[name])

    def entry(self, row: str) -> str:
        """Return the text of a cell, with the spread of its seeds."""
        value = self.values.get(row)
        if value is None or value != value:  # noqa: PLR0124  NaN
            return number(None)
        if self.unit == "share":
            return percent(value)
        if self.unit in ("percent", "seconds"):
            return tenths(value)
        text = aligned(value, self._decimals)
        spread = self.spreads.get(row)
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


@dataclass(frozen=True)
class Table:
    """Hold a table: columns, and the rows in order."""

    title: str
    columns: Sequence[Column]  # a narrow terminal leaves out the last ones
    rows: Mapping[str, str]  # what must be said of each row, by its name; it may be empty
    head: str = "method"  # what the rows are
    recommended: str = ""  # the row that stands out
    minor: frozenset[str] = frozenset()  # rows that a page folds away at first
    labels: Mapping[str, str] = field(default_factory=dict)  # rows in words, by name
    details: Mapping[str, str] = field(default_factory=dict)  # what each fit has chosen
    lines: str = "output"  # what the lines of a row are

    @property
    def notes(self) -> dict[str, str]:
        """Return what each heading means."""
        return {SHOWN.get(c.heading, c.heading): c.note for c in self.columns if c.note}

    def label(self, row: str) -> str:
        """Return a row in words."""
        return self.labels.get(row, row)

    def words(self, row: str) -> str:
        """Return the same where the name of the row stands beside or below."""
        return self.label(row).removesuffix(f" ({row})")

    def fitting(
        self, width: int, box: Box | None = HEAVY_HEAD
    ) -> tuple[rich.table.Table, list[str]]:
        """Return the table for a terminal, and the headings of columns that were left out.

        The best number of each column is bold. With several outputs, a row has a line for each. The
        short names stand beside or below the words, whichever leaves more columns. Where a decisive
        column would be left out, or the table is too wide still, they stand nowhere, and long words
        are broken.
        """
        forms = (_BESIDE, _BELOW) if self.labels else (_PLAIN,)
        found = [self._fitted(width, box, form) for form in forms]
        drawn, left_out = min(found, key=lambda each: len(each[1]))
        lost = bool(self.labels) and not DECISIVE.isdisjoint(c.heading for c in left_out)
        if not lost and _width(drawn) <= width:
            return drawn, self._headings(left_out)
        drawn, left_out = self._fitted(width, box, _SHORT)
        return drawn, [*self._headings(left_out), *["short names"] * bool(self.labels)]

    @staticmethod
    def _headings(columns: Sequence[Column]) -> list[str]:
        """Return the headings of columns, each once."""
        return [*dict.fromkeys(SHOWN.get(c.heading, c.heading) for c in columns)]

    def _fitted(
        self, width: int, box: Box | None, form: _Form
    ) -> tuple[rich.table.Table, list[Column]]:
        """Return the table in a form, and the columns that were left out."""
        of_heading: dict[tuple[str, str], dict[str, Column]] = {}
        for column in self.columns:
            of_heading.setdefault((column.heading, column.record), {})[column.channel] = column
        shown, left_out = [*of_heading.values()], list[Column]()
        drawn = self._drawn(shown, box, form)
        while len(shown) > 1 and _width(drawn) > width:
            left_out = [*shown.pop().values(), *left_out]
            drawn = self._drawn(shown, box, form)
        return drawn, left_out

    def _drawn(
        self, shown: Sequence[Mapping[str, Column]], box: Box | None, form: _Form
    ) -> rich.table.Table:
        """Return the table of the columns of some headings, by channel."""
        several = any(column.channel for column in self.columns)
        table = rich.table.Table(
            title=self.title or None, title_justify="left", title_style="bold", box=box,
            padding=(0, 1 if box else 2, 0, 1 if box else 0),
        )  # fmt: skip
        beside = form.names == "beside"
        for heading in (self.head, *["name"] * beside, *[self.lines] * several):
            table.add_column(heading, no_wrap=True)
        for of_channel in shown:
            first, *_ = of_channel.values()
            heading = first.shown if several else first.label
            entries = [c.entry(name) for c in of_channel.values() for name in self.rows]
            # A number in two lines would be taken for two outputs.
            header = textwrap.fill(
                heading, max(NARROW, *map(len, entries)), break_long_words=bool(form.narrow)
            )
            table.add_column(header, justify="right", no_wrap=True)
        for name in self.rows:
            channels = self._channels(name)
            heads = _spread(self._head(name, form), len(channels))
            for i, channel in enumerate(channels):
                cells = [heads[i], *[Text("" if i else name, "dim")] * beside]
                said = textwrap.fill(channel, form.narrow) if form.narrow else channel
                cells += [Text(said)] * several
                cells += [_cell(of_channel, name, channel, i == 0) for of_channel in shown]
                table.add_row(*cells, end_section=several and channel == channels[-1])
        return table

    def _head(self, name: str, form: _Form) -> list[Text]:
        """Return the lines that call a row: its words and, in one form, its name below them."""
        best = name == self.recommended
        label = self.words(name) if form.names else self.label(name)
        first, rest = ("* " if best else "  ", "  ") if self.recommended else ("", "")
        lines = textwrap.wrap(
            label, form.width, initial_indent=first, subsequent_indent=rest,
            break_long_words=bool(form.narrow), break_on_hyphens=False,
        )  # fmt: skip
        found = [Text(line, "bold" if best else "") for line in lines]
        below = form.names == "below" and label != name
        return [*found, Text(rest + name, "dim")] if below else found

    def _channels(self, name: str) -> list[str]:
        """Return the channels that a row has numbers of; a single one has no name."""
        found = dict.fromkeys(c.channel for c in self.columns if c.channel and name in c.values)
        return [*found] or [""]

    def as_text(self, width: int = 100) -> str:
        """Return the table as text, with as many columns as fit into `width` characters.

        It has no lines, which not every encoding of a file can hold.
        """
        console = _console(width)
        with console.capture() as captured:
            console.print(self.fitting(width, None)[0])
        lines = [line.rstrip() for line in captured.get().splitlines()]
        return "\n".join(lines + self.remarks())

    def remarks(self, details: bool = False) -> list[str]:
        """Return what must be said of rows, each remark once; if asked for, with their details."""
        every = {n: (words, self.details.get(n, "") * details) for n, words in self.rows.items()}
        return by_reason({self.label(n): "; ".join(filter(None, of)) for n, of in every.items()})


def _width(table: rich.table.Table) -> int:
    """Return the width of a table in which no cell is wrapped."""
    wide = _console(10_000)
    return Measurement.get(wide, wide.options, table).maximum


def _console(width: int) -> Console:
    """Return a console that writes plain text; brackets in names are text."""
    return Console(file=StringIO(), width=width, color_system=None, markup=False, emoji=False)


def _cell(of_channel: Mapping[str, Column], name: str, channel: str, first: bool) -> Text:
    """Return the number of a row's channel; one over all channels stands in the first line."""
    column = of_channel.get(channel) or (of_channel.get("") if first else None)
    if column is None:
        return Text(number(None) if channel == "" else "")
    return Text(column.entry(name), "bold" if column.best == name else "")


def _spread(lines: Sequence[Text], count: int) -> list[Text]:
    """Return texts for so many cells below each other: a line each, the last one with the rest."""
    cells = [*lines[: count - 1], Text("\n").join(lines[count - 1 :])]
    return cells + [Text("")] * (count - len(cells))


def of_comparison(comparison: Comparison) -> Table:
    """Return the table of a comparison: a row for each method, the recommended one first."""
    record, train, trial = comparison.record, comparison.plan.train, comparison.trial
    truth = "the noise-free signal" if record.y_true is not None else "what was measured"
    ahead = f"{run_of(record)} of the {len(record) - train:,} after them, against {truth}"
    title = (
        f"{record.name}: {train:,} samples to train on"
        + (f", {ahead}" if train < len(record) else "")
        + f". {what_was_known(comparison)}"
    )
    notes = remarks(comparison)
    missing = {} if trial is None else trial.without_result
    rows = {name: missing.get(name, "") for name in notes}
    details = {name: note for name, note in notes.items() if name not in missing}
    called = labels_of(comparison)
    return _ranked(Table(title, columns(comparison), rows, labels=called, details=details), trial)


def of_trial(
    trial: Trial, record: Record, methods: Mapping[str, Forecaster], title: str = ""
) -> Table:
    """Return the table of a trial: a row for each method, the recommended one first."""
    rows = dict.fromkeys(ordered(trial, trial.errors), "") | trial.without_result
    title = title or f"{record.name}: RMSE on its last quarter, fitted to the rest of it"
    listed = tried(trial, record, [*trial.errors])
    return _ranked(Table(title, listed, rows, labels=labels(rows, methods)), trial)


def of_forecast(result: Forecast) -> Table:
    """Return the table of what a forecast has tried."""
    methods = {method.name: method for method in result.plan.methods}
    return of_trial(result.trial, result.record, methods | {result.method: result.model})


def _ranked(table: Table, trial: Trial | None) -> Table:
    """Return the table with the recommended method marked, and simple ones folded away.

    Of the baselines, a recommended one and the best of the others stay: these are the reference.
    """
    if trial is None:
        return table
    best = trial.recommended
    others = trial.trained | trial.failed.keys() | {best}
    simple = [name for name in table.rows if name not in others]
    return replace(table, recommended=best, minor=frozenset(simple[1:]))


def of_attempts(attempts: Sequence[Attempt]) -> Table:
    """Return the table of the search for how to train networks."""
    names = [f"{i}. {each.method}, seed {each.seed}" for i, each in enumerate(attempts, 1)]
    of = dict(zip(names, attempts, strict=True))
    scores = {name: each.score for name, each in of.items() if each.score is not None}
    listed = [
        Column("round", "count", {n: float(each.round) for n, each in of.items()}, ranked=False),
        Column("score", "deviation", scores),
    ]
    title = (
        "What was tried, in that order; the score is of a single training, in the table of methods "
        "of a median"
    )
    details = {name: each.training for name, each in of.items()}
    rows = dict.fromkeys(names, "")
    return Table(title, listed, rows, "training", listed[1].best, details=details)


def columns(comparison: Comparison, *headings: str) -> list[Column]:
    """Return the columns of a comparison, by default all: fit and error first.

    Errors are of the median of the seeds' predictions, which is the method's prediction, for each
    output separately. Their spread is the standard deviation of the single seeds' errors.
    """
    return [
        column
        for heading in headings or COLUMNS
        for numbers in COLUMNS[heading].of(comparison)
        for column in _columns(heading, numbers)
    ]


def ordered(trial: Trial | None, methods: Iterable[str]) -> list[str]:
    """Return the methods sorted by their score, the recommended one first."""
    return [*methods] if trial is None else trial.ranked(methods)


def tried(trial: Trial, record: Record, methods: Iterable[str]) -> list[Column]:
    """Return the columns of a trial: score and held-out error."""
    of = {"score": _scores(trial, methods), "held-out RMSE": _held_out(trial, record, methods)}
    return [column for heading, numbers in of.items() for column in _columns(heading, numbers)]


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


def in_words(name: str, methods: Mapping[str, Forecaster] = NAMES) -> str:
    """Return a method in words; its name, for one of the user that has no description."""
    method = methods.get(name, NAMES.get(name))
    return (method.in_words() if method is not None else "") or name


def labels(names: Iterable[str], methods: Mapping[str, Forecaster]) -> dict[str, str]:
    """Return methods in words, by name; those with the same words have their names in brackets."""
    said = {name: in_words(name, methods) for name in names}
    count = Counter(said.values())
    return {n: titled(n, words) if count[words] > 1 else words for n, words in said.items()}


def labels_of(comparison: Comparison) -> dict[str, str]:
    """Return the methods of a comparison in words; what is fitted knows its cut-off."""
    fitted = {name: fits[0].fitted for name, fits in comparison.fits.items()}
    failed = () if comparison.trial is None else comparison.trial.failed
    names = dict.fromkeys([*comparison.fits, *comparison.methods, *failed])
    return labels(names, comparison.methods | fitted)


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


def as_text(comparison: Comparison) -> str:
    """Return the table with as many columns as fit into 100 characters, fit % first."""
    return f"{comparison!r}\n\n{replace(of_comparison(comparison), title='').as_text()}"


def as_html(comparison: Comparison) -> str:
    """Return the table as HTML without style, the recommended method first, for notebooks."""
    from splitband.report.page.parts import template  # noqa: PLC0415  it imports this module

    said = f"<p>{escape(repr(comparison))}</p>"
    return said + str(
        template("macros.html").module.table(
            replace(of_comparison(comparison), title=""), "comparison"
        )
    )


class Numbers(NamedTuple):
    """Hold numbers by method: one over all outputs or, of a record, one for each channel."""

    values: Mapping[str, Any]
    record: Record | None = None
    test: str = ""  # name of the test record
    spreads: Mapping[str, Any] = MappingProxyType({})


def _columns(heading: str, numbers: Numbers) -> list[Column]:
    """Return the columns of these numbers, which have a unit each."""
    values, record, test, spreads = numbers
    unit = COLUMNS[heading].unit
    if record is None:
        return [Column(heading, unit, values, ranked=unit == "deviation")] if values else []

    def of(i: int, numbers: Mapping[str, Any]) -> dict[str, float]:
        return {name: float(of_method[i]) for name, of_method in numbers.items()}

    channels = enumerate(zip(record.columns, record.units, strict=True))
    return [
        Column(heading, unit, of(i, values), name if record.ny > 1 else "", test, of(i, spreads),
               unit != "share", measure)
        for i, (name, measure) in channels
    ]  # fmt: skip


def _errors(
    protocol: Protocol, measure: Callable[[Array, Array], Array], comparison: Comparison
) -> Iterator[Numbers]:
    """Yield the fits or errors of predictions, of errors also their spread over the seeds."""
    every = [each for each in predicted(comparison) if each.protocol == protocol]
    for i, shown in enumerate(every, 1):
        values, spreads = {}, {}
        for name, median in shown.predictions.items():
            truth = shown.truth(median)
            values[name] = measure(truth, median.y)
            each = [measure(truth, one.y) for one in shown.trainings[name]]
            if measure is channel_rmse and len(each) > 1:
                spreads[name] = [statistics.stdev(of_seeds) for of_seeds in zip(*each, strict=True)]
        test = (shown.record.name or str(i)) if protocol == "test" else ""
        yield Numbers(values, shown.record, test, spreads)


def _scores(trial: Trial, methods: Iterable[str]) -> Numbers:
    scored = trial.final or trial.scores
    return Numbers({name: trial.penalized_score(name) for name in methods if name in scored})


def _held_out(trial: Trial, record: Record, methods: Iterable[str]) -> Numbers:
    return Numbers({name: trial.errors[name] for name in methods}, record)


def _intervals(comparison: Comparison) -> list[Numbers]:
    if comparison.trial is None or not comparison.predictions:
        return []
    held = {name: comparison.coverages(name) for name in comparison.fits}
    return [Numbers(held, comparison.record)]


def _trainings(comparison: Comparison) -> list[Numbers]:
    counts = {name: float(len(fits)) for name, fits in comparison.fits.items()}
    return [Numbers(counts)] if max(counts.values(), default=0) > 1 else []


def _seconds(comparison: Comparison) -> list[Numbers]:
    runs = comparison.fits.items()
    return [Numbers({name: statistics.mean(r.report.seconds for r in rs) for name, rs in runs})]


class Quantity(NamedTuple):
    """Describe a column of comparisons: its unit, what it means, and where its numbers are from."""

    unit: Unit
    note: str
    of: Callable[[Comparison], Iterable[Numbers]]


_FIT = "100 (1 - |y - prediction| / |y - mean(y)|) of the"
COLUMNS = {
    "test fit %": Quantity(
        "percent", f"{_FIT} simulation of this test record: 100 is perfect, 0 is as good as the "
        "mean of the record", partial(_errors, "test", fit_percent),
    ),
    "forecast fit %": Quantity(
        "percent", f"{_FIT} samples after the training part, which are simulated where inputs are "
        "known and forecast where there are none: 100 is perfect, 0 is as good as their mean",
        partial(_errors, "forecast", fit_percent),
    ),
    "score": Quantity(
        "deviation", RULE, lambda c: [_scores(c.trial, c.fits)] if c.trial else [],
    ),
    "in interval": Quantity(
        "share", "share of the measured samples after the training part in the interval; "
        f"{percent(COVERAGE)} is ideal", _intervals,
    ),
    "test RMSE": Quantity(
        "record", "root mean squared error of the simulation of this test record",
        partial(_errors, "test", channel_rmse),
    ),
    "forecast RMSE": Quantity(
        "record", "root mean squared error of the samples after the training part",
        partial(_errors, "forecast", channel_rmse),
    ),
    "held-out RMSE": Quantity(
        "record", "error on the last quarter of the training samples, by models trained on the "
        "rest", lambda c: [_held_out(c.trial, c.record, c.fits)] if c.trial else [],
    ),
    "RMSE from the start": Quantity(
        "record", "of the simulation from the first samples to the end of the record",
        partial(_errors, "start", channel_rmse),
    ),
    "fit % from the start": Quantity(
        "percent", "of the same simulation", partial(_errors, "start", fit_percent)
    ),
    "fit (s)": Quantity("seconds", "seconds of one training, on average", _seconds),
    "trainings": Quantity(
        "count", "how many the median is of; after ±: the standard deviation of their errors",
        _trainings,
    ),
}  # fmt: skip
"""The columns of comparisons by heading; a narrow terminal leaves out the last ones."""


def of_gains(found: Sequence[Responses]) -> list[Table]:
    """Return a table of a model's final responses; see `respond_over_range`."""
    if not found:
        return []
    first = found[0]
    pairs = {
        f"{u} to {y}": (j, i)
        for i, u in enumerate(first.inputs)
        for j, y in enumerate(first.columns)
    }
    listed = [
        Column(f"at {r.place}", "record", {n: float(r.y[-1][at]) for n, at in pairs.items()},
               ranked=False)
        for r in sorted(found, key=lambda r: 0.5 if r.share is None else r.share)
    ]  # fmt: skip
    title = (
        f"Step responses after {first.time[-1]:.4g} s, for a step of 1 (static gain, if settled)"
    )
    if len(found) > 1:
        title += ", where all inputs are at these shares of their ranges in training"
    return [Table(title, listed, dict.fromkeys(pairs, ""), "step")]


@np.errstate(divide="ignore", invalid="ignore")
def of_poles(fitted: Linear) -> Table:
    """Return the table of a linear model's poles: a row for each real one and for each pair.

    The numbers are those of MATLAB's `damp`, with the 95 % interval of the absolute value.
    """
    step, accuracy = fitted.require_fitted().record.sampling_time, fitted.model.accuracy
    poles = fitted.poles() if accuracy is None else accuracy.poles
    kept = [int(i) for i in np.argsort(-np.abs(poles), kind="stable") if poles[i].imag >= 0]
    names = {i: f"{n}. {complex_in_words(poles[i])}" for n, i in enumerate(kept, 1)}
    rates = np.log(poles.astype(np.complex128)) / step  # in the s plane

    def of(values: Array) -> dict[str, float]:
        known = np.where(np.isfinite(values), values, np.nan)
        return {names[i]: float(known[i]) for i in kept}

    error = np.full(len(poles), np.nan) if accuracy is None else NORMAL * accuracy.pole_errors[:, 2]
    errors = {name: size for name, size in of(error).items() if math.isfinite(size) and size}
    listed = [
        Column("absolute value", "record", of(np.abs(poles)), spreads=errors, ranked=False),
        Column("time constant (s)", "record", of(-1 / rates.real), ranked=False),
        Column("frequency (rad/s)", "record", of(np.abs(rates)), ranked=False),
        Column("frequency (Hz)", "record", of(np.abs(rates) / (2 * np.pi)), ranked=False),
        Column("damping ratio", "record", of(-rates.real / np.abs(rates)), ranked=False),
    ]
    title = "Poles in the z plane; after ±: half of the 95 % interval"
    return Table(title, listed, dict.fromkeys(names.values(), ""), "pole")
