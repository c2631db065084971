"""A table: one list of columns, whatever shows it.

rich draws a table in terminals and as text, a template draws it in pages and notebooks; JSON and
data frames hold its numbers.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from typing import Any, Literal, NamedTuple

import pandas as pd
import rich.table
from rich.box import HEAVY_HEAD, Box
from rich.console import Console
from rich.measure import Measurement
from rich.text import Text

from splitband.comparison.recommendation import by_reason
from splitband.metrics import tenths
from splitband.report.numbers import aligned, decimals, number, percent
from splitband.report.page import template

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


_BESIDE, _BELOW, _SHORT = _Form("beside", 1000), _Form("below", 40), _Form("", 24, 20)
_PLAIN = _Form("", 1000)
"""For rows that have no words beside their names. Layout."""


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
    note: str = ""  # what the heading means; empty if it needs no explanation
    marks: Mapping[str, str] = field(default_factory=dict)  # by row: a word beside the number

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
            mark = self.marks.get(row)
            return percent(value) + (f" ({mark})" if mark else "")
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
            **({"marks": dict(self.marks)} if self.marks else {}),
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
        """Return a row in words, without the short name, which stands beside or below them."""
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
        padding = (0, 1, 0, 1) if box else (0, 2, 0, 0)
        table = rich.table.Table(box=box, padding=padding, title_justify="left", title_style="bold")
        table.title = self.title or None
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
        wrapper = textwrap.TextWrapper(form.width, first, rest, break_on_hyphens=False)
        wrapper.break_long_words = bool(form.narrow)
        found = [Text(line, "bold" if best else "") for line in wrapper.wrap(label)]
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

    def as_html(self) -> str:
        """Return the table as HTML without style, for notebooks."""
        return str(template("macros.html").module.table(self, "table"))

    def to_frame(self) -> pd.DataFrame:
        """Return a data frame: the columns by their titles, and what must be said of each row."""
        table: dict[str, Mapping[str, object]] = {}
        for column in self.columns:
            table[column.title] = column.values
            if column.spreads:
                table[f"{column.title}, spread"] = column.spreads
        table["note"] = {row: said or self.details.get(row, "") for row, said in self.rows.items()}
        if self.recommended:
            known = [row for row, said in self.rows.items() if not said]
            table["recommended"] = {row: row == self.recommended for row in known}
        return pd.DataFrame(table, index=[*self.rows]).rename_axis(self.head)

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
