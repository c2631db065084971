"""A table: one list of columns for all displays.

rich draws tables in terminals and as text, a template in pages and notebooks; JSON and data frames
have the numbers.
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
"""Units of numbers over all outputs of a comparison."""

SHOWN = {"forecast fit %": "fit %", "forecast RMSE": "RMSE"}
"""Displayed headings, below a title with "forecast" or "simulation"."""
DECISIVE = frozenset({"N ahead fit %", "test fit %", "forecast fit %", "score"})
"""Headings with the reason for the recommendation, and its quality."""
NARROW = 8
"""Smallest width of a heading's line, in characters. Layout."""


class _Form(NamedTuple):
    """The layout in a terminal: place of short names of rows, and largest width of words."""

    names: Literal["beside", "below", ""]
    width: int
    narrow: int = 0  # width of outputs, with long words broken; 0 for whole words


_BESIDE, _BELOW, _SHORT = _Form("beside", 1000), _Form("below", 40), _Form("", 24, 20)
_PLAIN = _Form("", 1000)
"""Form for rows without words beside their names. Layout."""


@dataclass(frozen=True)
class Column:
    """A column: numbers by row, of one channel or of all."""

    heading: str
    unit: Unit
    values: Mapping[str, float]  # by row, such as methods; possibly not of all rows
    channel: str = ""  # empty for numbers over all channels, or a single channel
    record: str = ""  # name of the test record; empty for the record of the comparison
    spreads: Mapping[str, float] = field(default_factory=dict)  # over the seeds, if several
    ranked: bool = True  # whether the lowest number (of percents, the highest) is the best one
    measure: str = ""  # the unit in the output's name, such as "m"
    note: str = ""  # explanation of the heading
    marks: Mapping[str, str] = field(default_factory=dict)  # by row: a word beside the number
    ahead: int = 0  # samples from each of many origins to the predicted one; 0: a free run

    @property
    def title(self) -> str:
        """Return the heading with the test record and the channel: the key in a data frame."""
        what = f"{self.heading} {self.record}" if self.record else self.heading
        return f"{what}, {self.channel}" if self.channel else what

    @property
    def shown(self) -> str:
        """Return the displayed heading, with the test record."""
        heading = SHOWN.get(self.heading, self.heading)
        heading = f"fit % {self.ahead} ahead" if self.ahead else heading
        return f"{heading} {self.record}".rstrip()

    @property
    def label(self) -> str:
        """Return the displayed title, with the unit unless in the channel's name."""
        shown = f"{self.shown}, {self.channel}" if self.channel else self.shown
        with_unit = self.measure and self.unit == "record" and not self.channel
        return f"{shown} ({self.measure})" if with_unit else shown

    @property
    def best(self) -> str:
        """Return the best row; empty for an unranked column."""
        finite = {name: value for name, value in self.values.items() if value == value}  # noqa: PLR0124
        if not (finite and self.ranked):
            return ""
        return (max if self.unit == "percent" else min)(finite, key=lambda name: finite[name])

    def entry(self, row: str) -> str:
        """Return the text of a cell, with the spread over seeds."""
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
        """Return the column for results.json."""
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
            **({"ahead": self.ahead} if self.ahead else {}),
        }


@dataclass(frozen=True)
class Table:
    """A table: columns, and the rows in order."""

    title: str
    columns: Sequence[Column]  # the last ones are missing in a narrow terminal
    rows: Mapping[str, str]  # remarks on rows by name, possibly empty
    head: str = "method"  # heading of the rows
    recommended: str = ""  # the marked row
    minor: frozenset[str] = frozenset()  # rows that a page folds away at first
    labels: Mapping[str, str] = field(default_factory=dict)  # rows in words, by name
    details: Mapping[str, str] = field(default_factory=dict)  # choices of fits, by name
    lines: str = "output"  # heading of the lines of a row

    @property
    def notes(self) -> dict[str, str]:
        """Return explanations by heading."""
        return {SHOWN.get(c.heading, c.heading): c.note for c in self.columns if c.note}

    def label(self, row: str) -> str:
        """Return a row in words."""
        return self.labels.get(row, row)

    def words(self, row: str) -> str:
        """Return a row in words, without the short name."""
        return self.label(row).removesuffix(f" ({row})")

    def fitting(
        self, width: int, box: Box | None = HEAVY_HEAD
    ) -> tuple[rich.table.Table, list[str]]:
        """Return the table for a terminal, and the headings of omitted columns.

        The best number of a column is bold. With several outputs, a row has several lines. Short
        names are beside or below the words, for the larger number of columns. If a decisive column
        would be omitted, or the table is still too wide, short names are omitted, and long words
        are broken.
        """
        forms = (_BESIDE, _BELOW) if self.labels else (_PLAIN,)
        drafts = [self._fitted(width, box, form) for form in forms]
        drawn, left_out = min(drafts, key=lambda draft: len(draft[1]))
        lost = bool(self.labels) and not DECISIVE.isdisjoint(c.heading for c in left_out)
        if not lost and _width(drawn) <= width:
            return drawn, self._headings(left_out)
        drawn, left_out = self._fitted(width, box, _SHORT)
        return drawn, [*self._headings(left_out), *["short names"] * bool(self.labels)]

    @staticmethod
    def _headings(columns: Sequence[Column]) -> list[str]:
        """Return the distinct headings of columns."""
        return [*dict.fromkeys(SHOWN.get(c.heading, c.heading) for c in columns)]

    def _fitted(
        self, width: int, box: Box | None, form: _Form
    ) -> tuple[rich.table.Table, list[Column]]:
        """Return the table in a form, and the omitted columns."""
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
            # A number in two lines would look like two outputs.
            header = textwrap.fill(
                heading, max(NARROW, *map(len, entries)), break_long_words=bool(form.narrow)
            )
            table.add_column(header, justify="right", no_wrap=True)
        for name in self.rows:
            channels = self._channels(name)
            heads = _spread(self._head(name, form), len(channels))
            for i, channel in enumerate(channels):
                cells = [heads[i], *[Text("" if i else name, "dim")] * beside]
                line = textwrap.fill(channel, form.narrow) if form.narrow else channel
                cells += [Text(line)] * several
                cells += [_cell(of_channel, name, channel, i == 0) for of_channel in shown]
                table.add_row(*cells, end_section=several and channel == channels[-1])
        return table

    def _head(self, name: str, form: _Form) -> list[Text]:
        """Return the label of a row in lines: words and, in one form, the name below."""
        best = name == self.recommended
        label = self.words(name) if form.names else self.label(name)
        first, rest = ("* " if best else "  ", "  ") if self.recommended else ("", "")
        wrapper = textwrap.TextWrapper(form.width, first, rest, break_on_hyphens=False)
        wrapper.break_long_words = bool(form.narrow)
        lines = [Text(line, "bold" if best else "") for line in wrapper.wrap(label)]
        below = form.names == "below" and label != name
        return [*lines, Text(rest + name, "dim")] if below else lines

    def _channels(self, name: str) -> list[str]:
        """Return the channels with numbers in a row; a single one has no name."""
        channels = dict.fromkeys(c.channel for c in self.columns if c.channel and name in c.values)
        return [*channels] or [""]

    def as_text(self, width: int = 100) -> str:
        """Return the table as text, with as many columns as fit into `width` characters.

        It has no rules, which some encodings of files lack.
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
        """Return a data frame: the columns by title, and remarks by row."""
        table: dict[str, Mapping[str, object]] = {}
        for column in self.columns:
            table[column.title] = column.values
            if column.spreads:
                table[f"{column.title}, spread"] = column.spreads
        notes = self.rows.items()
        table["note"] = {row: note or self.details.get(row, "") for row, note in notes}
        if self.recommended:
            complete = [row for row, note in notes if not note]
            table["recommended"] = {row: row == self.recommended for row in complete}
        return pd.DataFrame(table, index=[*self.rows]).rename_axis(self.head)

    def remarks(self, details: bool = False) -> list[str]:
        """Return the distinct remarks on rows; on request with `details`."""
        every = {n: (words, self.details.get(n, "") * details) for n, words in self.rows.items()}
        return by_reason({self.label(n): "; ".join(filter(None, of)) for n, of in every.items()})


def _width(table: rich.table.Table) -> int:
    """Return the width of a table without wrapped cells."""
    wide = _console(10_000)
    return Measurement.get(wide, wide.options, table).maximum


def _console(width: int) -> Console:
    """Return a console for plain text; brackets in names are text."""
    return Console(file=StringIO(), width=width, color_system=None, markup=False, emoji=False)


def _cell(of_channel: Mapping[str, Column], name: str, channel: str, first: bool) -> Text:
    """Return the number of a row's channel; one over all channels is in the first line."""
    column = of_channel.get(channel) or (of_channel.get("") if first else None)
    if column is None:
        return Text(number(None) if channel == "" else "")
    return Text(column.entry(name), "bold" if column.best == name else "")


def _spread(lines: Sequence[Text], count: int) -> list[Text]:
    """Return texts for `count` cells in a column: one line per cell, the rest in the last one."""
    cells = [*lines[: count - 1], Text("\n").join(lines[count - 1 :])]
    return cells + [Text("")] * (count - len(cells))
