"""Define the parts of a page, without Bokeh, which loads slowly."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from splitband.report.colors import PALETTE
from splitband.report.table import Table

if TYPE_CHECKING:
    from splitband.report.page.charts import Chart


@dataclass(frozen=True, eq=False)
class Section:
    """Hold a part of the page with a heading."""

    name: str  # its anchor
    title: str  # the heading
    words: Sequence[str] = ()  # paragraphs
    items: Sequence[str] = ()  # warnings, above these
    tables: Sequence[Table] = ()  # shown after the list
    plots: Sequence[Chart] = ()
    code: Sequence[tuple[str, str]] = ()  # lines to copy, each with what they do
    facts: Sequence[tuple[str, str]] = ()  # pairs of a name and a value
    folded: bool = False  # whether it is closed until clicked


@dataclass(frozen=True)
class Method:
    """Describe a method that readers switch on and off."""

    name: str  # name of the forecaster
    color: int = 0  # index of its colour in the palette
    dashed: bool = False  # whether its colour repeats that of another method
    recommended: bool = True  # whether it is the recommended method
    shown: bool = True  # whether it is on at first
    label: str = ""  # what it is, in words

    @property
    def tags(self) -> list[str]:
        """Return the tags by which the page's script colours its curves and switches them."""
        return [f"c{self.color}", "method", *([] if self.shown else ["hidden"])]


def method_styles(
    labels: Mapping[str, str], recommended: str, minor: Collection[str] = ()
) -> dict[str, Method]:
    """Return how each method is drawn; if colours run out, they repeat, dashed.

    `labels` are methods in words, in the order of the table; its `minor` rows are off at first.
    """
    return {
        name: Method(
            name, i % len(PALETTE), i >= len(PALETTE), name == recommended, name not in minor, label
        )
        for i, (name, label) in enumerate(labels.items())
    }


@dataclass(frozen=True, eq=False)
class Page:
    """Hold a page."""

    title: str
    lead: str  # the line below it
    sections: Sequence[Section]  # the switches of the methods are below the first one
    methods: Sequence[Method] = ()  # methods that are drawn
    views: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # buttons: time ranges

    @property
    def plots(self) -> list[Chart]:
        """Return all plots."""
        return [plot for section in self.sections for plot in section.plots]


@dataclass(frozen=True)
class Usage:
    """Hold the command that made a result, and how to use its model."""

    commands: Sequence[tuple[str, str]] = ()  # what each does, and the command or Python code
    asked: str = ""  # the command that made the page
