"""Define the parts of a page, which the template renders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from splitband.report.colors import PALETTE


@dataclass(frozen=True)
class Cell:
    """Hold a cell of a table: its text, and the number to sort by.

    Attributes
    ----------
    text : Words or digits.
    value : A number to sort by; None sorts by the text.
    best : Whether it is the best one of its column.
    link : Link to another page.
    says : A second line, smaller.
    """

    text: str
    value: float | None = None
    best: bool = False
    link: str = ""
    says: str = ""


@dataclass(frozen=True)
class Table:
    """Hold a table that readers sort.

    Attributes
    ----------
    caption : What it shows.
    columns : The headings.
    rows : The first cell of each names it.
    marked : Rows that stand out.
    minor : Rows that are folded away at first.
    notes : What each heading means, in the order of the columns that need it.
    """

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    marked: frozenset[int] = frozenset()
    minor: frozenset[int] = frozenset()
    notes: Sequence[tuple[str, str]] = ()

    @property
    def numeric(self) -> list[bool]:
        """Return which columns hold numbers; these are right-aligned."""
        return [
            any(row[i].value is not None for row in self.rows) for i in range(len(self.columns))
        ]


@dataclass(frozen=True, eq=False)
class Plot:
    """Hold a plot, and what it shows in words.

    Attributes
    ----------
    figure : The Bokeh figure.
    caption : Text above it.
    says : Text for readers who cannot see it.
    methods : It is shown if one of these is switched on; if empty, always.
    key : Entries of the legend, each a colour and a name.
    small : Whether several share a row.
    """

    figure: Any
    caption: str
    says: str
    methods: Sequence[str] = ()
    key: Sequence[tuple[str, str]] = ()
    small: bool = False


@dataclass(frozen=True, eq=False)
class Section:
    """Hold a part of the page with a heading.

    Attributes
    ----------
    name : Its anchor.
    title : The heading.
    words : Paragraphs.
    items : A list after them.
    tables, plots : Shown after the list.
    code : Lines to copy, each with what they do.
    facts : Pairs of a name and a value.
    folded : Whether it is closed until clicked.
    """

    name: str
    title: str
    words: Sequence[str] = ()
    items: Sequence[str] = ()
    tables: Sequence[Table] = ()
    plots: Sequence[Plot] = ()
    code: Sequence[tuple[str, str]] = ()
    facts: Sequence[tuple[str, str]] = ()
    folded: bool = False


@dataclass(frozen=True)
class Method:
    """Describe a method that readers switch on and off; the recommended one is on at first.

    Attributes
    ----------
    name : Name of the forecaster.
    color : Index of its colour in the palette.
    dashed : Whether its colour repeats that of another method.
    recommended : Whether it is the recommended method.
    """

    name: str
    color: int = 0
    dashed: bool = False
    recommended: bool = True


def method_styles(names: Sequence[str], recommended: str) -> dict[str, Method]:
    """Return how each method is drawn; if colours run out, they repeat, dashed."""
    return {
        name: Method(name, i % len(PALETTE), i >= len(PALETTE), name == recommended)
        for i, name in enumerate(names)
    }


@dataclass(frozen=True)
class View:
    """Describe a part of the time axis that a button shows."""

    label: str
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class Page:
    """Hold a page.

    Attributes
    ----------
    title, lead : The heading, and the line below it.
    sections : Sections in order; the switches of the methods are below the first one.
    methods : Methods that are drawn.
    views : Ranges of the time axis with a button; the first one is the whole axis.
    """

    title: str
    lead: str
    sections: Sequence[Section]
    methods: Sequence[Method] = ()
    views: Sequence[View] = ()

    @property
    def plots(self) -> list[Plot]:
        """Return all plots."""
        return [plot for section in self.sections for plot in section.plots]


@dataclass(frozen=True)
class Usage:
    """Hold the command that made a result, and how to use its model.

    Attributes
    ----------
    commands : Commands that use the model, in a shell or in Python, each with what it does.
    asked : The command that made the page.
    """

    commands: Sequence[tuple[str, str]] = ()
    asked: str = ""
