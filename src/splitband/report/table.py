"""A table: one list of columns for all displays.

rich draws tables in terminals and as text, a template in pages and notebooks; JSON and data frames
have the numbers.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from io import StringIO
from typing import Any, Literal

import pandas as pd
import rich.table
from rich.box import HEAVY_HEAD, Box
from rich.console import Console
from rich.text import Text

from splitband.comparison.recommendation import COVERAGE, by_reason
from splitband.forecasters.base import titled
from splitband.forecasters.held_out import so_far_ahead
from splitband.metrics import tenths
from splitband.report.numbers import aligned, decimals, gain_in_words, number, percent
from splitband.report.page import template

Unit = Literal["percent", "record", "deviation", "share", "seconds", "count", "gain"]
"""Unit of a column: percent, the output's unit, its standard deviation, 0 to 1, seconds, none, and
output over input."""
OVER_ALL: tuple[Unit, ...] = ("deviation", "seconds", "count")
"""Units of numbers over all outputs of a comparison."""
RANKED: tuple[Unit, ...] = ("percent", "record", "deviation")
"""Units of the columns of a comparison in which one number is the best."""

SHOWN = {
    "forecast fit %": "fit %",
    "test fit %": "fit %",
    "forecast RMSE": "RMSE",
    "test RMSE": "RMSE",
    "in interval": f"inside the {percent(COVERAGE)} interval",
}
"""Displayed headings, below a title that says of which samples the numbers are."""
DETAILS = ("score",)
"""Headings that a terminal shows on request."""
NARROW = 8
"""Smallest width of a heading's line, in characters. Layout."""


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
    def kind(self) -> str:
        """Return the displayed heading, without a unit."""
        if self.ahead:
            return f"fit % {so_far_ahead(self.ahead)}"
        return SHOWN.get(self.heading, self.heading)

    @property
    def shown(self) -> str:
        """Return the displayed heading, with the unit unless in the channel's name."""
        with_unit = self.measure and self.unit == "record" and not self.channel
        return f"{self.kind} ({self.measure})" if with_unit else self.kind

    @property
    def line(self) -> str:
        """Return the test record and the channel: the line of a row in a terminal."""
        return ", ".join(filter(None, [self.record, self.channel]))

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
        if self.unit == "gain" and value is not None and not math.isfinite(value):
            return gain_in_words(value)
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
    columns: Sequence[Column]
    rows: Mapping[str, str]  # remarks on rows by name, possibly empty
    head: str = "method"  # heading of the rows
    recommended: str = ""  # the marked row
    minor: frozenset[str] = frozenset()  # rows that a page folds away at first
    labels: Mapping[str, str] = field(default_factory=dict)  # rows in words, by name
    details: Mapping[str, str] = field(default_factory=dict)  # choices of fits, by name

    @property
    def notes(self) -> dict[str, str]:
        """Return explanations by heading."""
        return {c.kind: c.note for c in self.columns if c.note}

    def label(self, row: str) -> str:
        """Return a row in words."""
        return self.labels.get(row, row)

    def words(self, row: str) -> str:
        """Return a row in words, without the short name."""
        return self.label(row).removesuffix(f" ({row})")

    @cached_property
    def lines(self) -> list[str]:
        """Return the outputs and test records to tell apart; a single one alone is not named."""
        lines = [*dict.fromkeys(c.line for c in self.columns if c.line)]
        numbers = {(c.shown, c.line) for c in self.columns}
        return lines if len(lines) > 1 or len(numbers) > len(self.headings()) else []

    def headings(self, details: bool = True) -> list[str]:
        """Return the headings of the numbers, perhaps without the `details`."""
        shown = (c for c in self.columns if details or c.heading not in DETAILS)
        return [*dict.fromkeys(c.shown for c in shown)]

    def cells(self, row: str, details: bool = True) -> dict[str, list[tuple[str, bool]]]:
        """Return the numbers of a row, and whether each is the best of its column.

        Outputs and test records to tell apart have lines of their own, by name; the first line,
        named "", has the other numbers.
        """
        own = [c for c in self.columns if row in c.values]
        every = {c.line for c in own}
        lines = ["", *(line for line in self.lines if line in every)]
        found = {
            (c.line if self.lines else "", c.shown): (c.entry(row), c.best == row) for c in own
        }
        known = {c.shown for c in own}

        def cell(line: str, heading: str) -> tuple[str, bool]:
            missing = "" if line or heading in known else number(None)
            return found.get((line, heading), (missing, False))

        return {line: [cell(line, each) for each in self.headings(details)] for line in lines}

    def drawn(self, details: bool = False, box: Box | None = HEAVY_HEAD) -> rich.table.Table:
        """Return the table for a terminal, without its title; on request with `details`.

        The best number of a column is bold. In a narrow terminal words are folded, and numbers
        never.
        """
        table = rich.table.Table(box=box, padding=(0, 1, 0, 1) if box else (0, 2, 0, 0))
        table.add_column(self.head, overflow="fold")
        for heading in self.headings(details):
            entries = [c.entry(row) for c in self.columns if c.shown == heading for row in c.values]
            least = max(map(len, " ".join([heading, *entries]).split(" ")))
            most = max([NARROW, least, *map(len, entries)])
            header = textwrap.fill(heading, most, break_long_words=False)
            table.add_column(header, justify="right", min_width=least)
        for row in self.rows:
            best, lines = row == self.recommended, self.cells(row, details)
            label = Text(titled(row, self.words(row)), "bold" if best else "")
            for line, cells in lines.items():
                mark = "  " if line else "*" if best else " " * bool(self.recommended)
                head = _behind(mark, Text(line) if line else label) if mark else label
                numbers = (Text(text, "bold" if of_best else "") for text, of_best in cells)
                table.add_row(head, *numbers, end_section=len(lines) > 1 and line == [*lines][-1])
        return table

    def as_text(self, width: int = 100) -> str:
        """Return the table as text in lines of `width` characters.

        It has no rules, which some encodings of files lack.
        """
        # Brackets in names are text.
        console = Console(
            file=StringIO(), width=width, color_system=None, markup=False, emoji=False
        )
        with console.capture() as captured:
            console.print(self.drawn(box=None))
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


def _behind(mark: str, text: Text) -> rich.table.Table:
    """Return a text that is folded behind a mark."""
    grid = rich.table.Table.grid(padding=(0, 1, 0, 0))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    grid.add_row(mark, text)
    return grid
