"""Define what a page is made of; the template draws it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from splitband.report.colors import PALETTE


@dataclass(frozen=True)
class Cell:
    """Hold a cell of a table: what it says, and what it is sorted by.

    Attributes
    ----------
    text : In words or digits.
    value : A number to sort by; None sorts by the text.
    best : Whether no other one of the column is lower.
    link : To another page.
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
    minor : Rows that are seen only when asked for.
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
        """Return which columns hold numbers, and stand on the right."""
        return [
            any(row[i].value is not None for row in self.rows) for i in range(len(self.columns))
        ]


@dataclass(frozen=True, eq=False)
class Plot:
    """Hold a plot, and what it shows in words.

    Attributes
    ----------
    figure : Of Bokeh.
    caption : Above it.
    says : For those who do not see it.
    methods : One of these has to be switched on for it; none: it is always there.
    key : Colour and name of what else it shows beside the methods.
    small : Whether several stand side by side.
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
    tables, plots : After these.
    code : Lines to copy, each with what they do.
    facts : Pairs of a name and a value.
    folded : Whether it opens by a click.
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
    name : Of the forecaster.
    color : Its place in the palette.
    dashed : Whether its colour is another one's, too.
    recommended : Whether it is the one.
    """

    name: str
    color: int = 0
    dashed: bool = False
    recommended: bool = True


def method_styles(names: Sequence[str], recommended: str) -> dict[str, Method]:
    """Return how each method is drawn; colours begin again where there are not enough."""
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
    sections : In their order; what switches methods stands below the first one.
    methods : Which are drawn.
    views : Parts of the time axis worth a button; the first one is all of it.
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
    """Hold what only the caller knows of how a result was asked for.

    Attributes
    ----------
    commands : To use the model, from a shell or in Python, each with what it does.
    asked : The command that made the page.
    """

    commands: Sequence[tuple[str, str]] = ()
    asked: str = ""
