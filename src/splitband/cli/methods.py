"""`splitband methods`: what there is to choose from, grouped and explained."""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table
from rich.text import Text

from splitband.cli import showing
from splitband.forecasters.names import (
    BASED,
    CALIBRATED,
    CONDITIONED,
    HYBRIDS,
    NAMES,
    TRAINED,
    base,
    named,
)
from splitband.report.page.words import in_words


@dataclass(frozen=True)
class Group:
    """Methods of one kind.

    Attributes
    ----------
    title, when : What they are, and for which record they are worth trying.
    names : Of the methods, in the order in which they are shown.
    """

    title: str
    when: str
    names: tuple[str, ...]


_SPLIT = tuple(name for name in TRAINED if name.startswith("split-"))
_SINGLE = tuple(name for name in TRAINED if name not in {*_SPLIT, *HYBRIDS, *BASED})
_SIMULATORS = tuple(name for name in NAMES if name.startswith("simulator"))
_BASELINES = tuple(name for name in NAMES if name not in {*TRAINED, *_SIMULATORS})
GROUPS = (
    Group("one network", "any record; with known inputs often enough", _SINGLE),
    Group("two networks, a band each", "a record with a slow and a fast part", _SPLIT),
    Group("a simulator and a network", "a simulator that is right in the large", HYBRIDS),
    Group(
        "a fitted model and a network",
        "a record with a simple slow part, no simulator",
        BASED,
    ),
    Group("the simulator itself", "seeing what a network adds to it", _SIMULATORS),
    Group("simple baselines", "every record: what learning has to be better than", _BASELINES),
)


def methods() -> None:
    """List the methods, what each is and when it is worth trying.

    A name that ends in -calibrated has its simulator calibrated first (gain, offset, delay, clock);
    in one that ends in -conditioned the faster network is told what the slower part says. Give
    names to --methods, separated by commas.
    """
    table = Table(show_lines=False)
    for heading in ("method", "what it is", "also as", "needs"):
        table.add_column(heading)
    for group in GROUPS:
        table.add_section()
        table.add_row(Text(group.title, "bold"), Text(f"for {group.when}", "italic"))
        for name in group.names:
            if name == base(name) or name in _SIMULATORS:
                table.add_row(f"  {name}", in_words(name), _variants(name), _needs(name))
    showing.console.print(table)
    showing.as_json(
        {group.title: {name: in_words(name) for name in group.names} for group in GROUPS}
    )


def _variants(name: str) -> str:
    """The suffixes under which there is another variant of a method."""
    if name.startswith("simulator"):
        return ""
    suffixes = (CALIBRATED, CONDITIONED, CALIBRATED + CONDITIONED)
    return ", ".join(suffix for suffix in suffixes if name + suffix in NAMES)


def _needs(name: str) -> str:
    return ", ".join(f"--{need}" for need in sorted(named(name).needs))
