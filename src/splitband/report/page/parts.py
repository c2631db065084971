"""Define the parts of a page, which the template renders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from splitband.report.colors import PALETTE
from splitband.report.table import Table

if TYPE_CHECKING:
    from splitband.report.page.charts import Chart


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
    plots: Sequence[Chart] = ()
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

    @property
    def tags(self) -> list[str]:
        """Return the tags by which the page's script colours its curves and switches them."""
        return [f"c{self.color}", "method", *([] if self.recommended else ["hidden"])]


def method_styles(names: Sequence[str], recommended: str) -> dict[str, Method]:
    """Return how each method is drawn; if colours run out, they repeat, dashed."""
    return {
        name: Method(name, i % len(PALETTE), i >= len(PALETTE), name == recommended)
        for i, name in enumerate(names)
    }


@dataclass(frozen=True, eq=False)
class Page:
    """Hold a page.

    Attributes
    ----------
    title, lead : The heading, and the line below it.
    sections : Sections in order; the switches of the methods are below the first one.
    methods : Methods that are drawn.
    views : Ranges of the time axis that a button with this name shows.
    """

    title: str
    lead: str
    sections: Sequence[Section]
    methods: Sequence[Method] = ()
    views: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def plots(self) -> list[Chart]:
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
