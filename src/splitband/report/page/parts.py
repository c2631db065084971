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
    """A part of the page with a heading."""

    name: str  # the anchor
    title: str  # the heading
    words: Sequence[str] = ()  # paragraphs
    items: Sequence[str] = ()  # warnings, above the paragraphs
    tables: Sequence[Table] = ()  # below the paragraphs
    plots: Sequence[Chart] = ()
    code: Sequence[tuple[str, str]] = ()  # pairs of a purpose and lines to copy
    facts: Sequence[tuple[str, str]] = ()  # pairs of a name and a value
    folded: bool = False  # whether the section is closed until clicked


@dataclass(frozen=True)
class Method:
    """A method with a switch on the page."""

    name: str  # name of the forecaster
    color: int = 0  # index of the colour in the palette
    dashed: bool = False  # whether the colour repeats another method's
    recommended: bool = True
    shown: bool = True  # whether the switch is on at first
    label: str = ""  # the method in words

    @property
    def tags(self) -> list[str]:
        """Return the tags of curves, for colours and switches in the page's script."""
        return [f"c{self.color}", "method", *([] if self.shown else ["hidden"])]


def method_styles(
    labels: Mapping[str, str], recommended: str, minor: Collection[str] = ()
) -> dict[str, Method]:
    """Return the styles by method; if colours run out, they repeat, dashed.

    `labels` are methods in words, in the order of the table; `minor` rows are off at first.
    """
    return {
        name: Method(
            name, i % len(PALETTE), i >= len(PALETTE), name == recommended, name not in minor, label
        )
        for i, (name, label) in enumerate(labels.items())
    }


@dataclass(frozen=True, eq=False)
class Page:
    """A page."""

    title: str
    lead: str  # the line below the title
    sections: Sequence[Section]  # the switches of the methods are below the first one
    methods: Sequence[Method] = ()  # methods with curves
    views: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # buttons: time ranges

    @property
    def plots(self) -> list[Chart]:
        """Return all plots."""
        return [plot for section in self.sections for plot in section.plots]


@dataclass(frozen=True)
class Usage:
    """The command of a result, and commands for its model."""

    commands: Sequence[tuple[str, str]] = ()  # pairs of a purpose and a command or Python code
    asked: str = ""  # the command of the page
