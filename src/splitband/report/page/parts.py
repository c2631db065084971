"""Define the parts of a page, without Bokeh, which loads slowly."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from splitband.report.colors import PALETTE
from splitband.report.table import Table

if TYPE_CHECKING:
    from splitband.report.page.charts import Chart

MOST_DRAWN = 6
"""Largest number of methods with curves. Layout."""
DASHES = (), (9, 4), (2, 3), (9, 3, 2, 3), (16, 4), (4, 4)
"""Lengths of dashes and gaps, in pixels: curves differ without their colours, too. Layout."""


@dataclass(frozen=True, eq=False)
class Section:
    """A part of the page with a heading."""

    name: str  # the anchor
    title: str  # the heading
    words: Sequence[str] = ()  # paragraphs
    plots: Sequence[Chart] = ()
    tables: Sequence[Table] = ()
    warnings: Sequence[str] = ()  # what a reader of the paragraphs must know
    items: Sequence[str] = ()  # notes
    code: Sequence[tuple[str, str]] = ()  # pairs of a purpose and lines to copy
    facts: Sequence[tuple[str, str]] = ()  # pairs of a name and a value


@dataclass(frozen=True)
class Key:
    """An entry of a legend; that of a curve shows and hides it."""

    name: str
    color: str  # the name of the colour in the style
    dash: tuple[int, ...] = ()
    shaded: bool = False  # whether it is an area
    hidden: bool = False  # at first


def looks(
    labels: Mapping[str, str], minor: Collection[str] = (), needed: Collection[str] = ()
) -> dict[str, Key]:
    """Return the curves of the methods, alike in all plots: the first ones that are not `minor`.

    `labels` are methods in words, in the order of the table; `needed` ones have curves, too.
    """
    first = [name for name in labels if name not in {*minor} - {*needed}][:MOST_DRAWN]
    drawn = [*first, *(name for name in labels if name in needed and name not in first)]
    return {
        name: Key(labels[name], f"c{i % len(PALETTE)}", DASHES[i % len(DASHES)])
        for i, name in enumerate(drawn)
    }


@dataclass(frozen=True, eq=False)
class Page:
    """A page."""

    title: str
    lead: str  # the line below the title
    sections: Sequence[Section]
    views: Mapping[str, tuple[float, float]] = field(default_factory=dict)  # buttons: time ranges

    @property
    def plots(self) -> list[Chart]:
        """Return all plots."""
        return [plot for section in self.sections for plot in section.plots]


@dataclass(frozen=True)
class Usage:
    """The command of a result, its data files, and commands for its model."""

    commands: Sequence[tuple[str, str]] = ()  # pairs of a purpose and a command or Python code
    asked: str = ""  # the command of the page
    files: Sequence[str] = ()  # paths of records
