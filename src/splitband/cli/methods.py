"""Define `splitband methods`, which lists and explains the methods by group."""

from __future__ import annotations

from typing import NamedTuple

from rich.table import Column, Table
from rich.text import Text

from splitband.cli import showing
from splitband.forecasters.base import cells_of, parts_of
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.names import BASED, HYBRIDS, NAMES, QUICK, variants


class Group(NamedTuple):
    """Hold methods of one kind: what they are, and for which record they are worth trying."""

    title: str
    when: str
    names: tuple[str, ...]


def _alone(cells: int) -> tuple[str, ...]:
    """Return the methods of this number of networks (`cells`) and no simulator or fitted model."""
    return tuple(n for n, m in NAMES.items() if not parts_of(m) and len(cells_of(m)) == cells)


_SIMULATORS = tuple(n for n in QUICK if "simulator" in NAMES[n].needs or NAMES[n]._fits_simulator)
_BASELINES = tuple(name for name in QUICK if name not in _SIMULATORS)
GROUPS = (
    Group("one network", "any record; often sufficient with known inputs", _alone(1)),
    Group("two networks, a band each", "a record with a slow and a fast part", _alone(2)),
    Group(
        "a simulator and a network",
        "a simulator that is roughly right; + adds a network that learns its error",
        HYBRIDS,
    ),
    Group("a fitted model and a network", "a record with a simple slow part, no simulator", BASED),
    Group("the simulator itself", "judging what a network adds", _SIMULATORS),
    Group("simple baselines", "every record, as the reference to beat", _BASELINES),
)


def methods() -> None:
    """List the methods, what each is and when it is worth trying.

    A name that ends in -calibrated has its simulator calibrated first (gain, offset, delay, clock);
    in one that ends in -conditioned the network has the slower part's output as an input. Give
    names to --methods, separated by commas.
    """
    table = Table("what it is", Column("name", no_wrap=True), "also as", "needs", show_lines=False)
    for group in GROUPS:
        table.add_section()
        table.add_row(Text.assemble((group.title, "bold"), (f"\nfor {group.when}", "italic")))
        shown: set[str] = set()
        for name in group.names:
            if name in shown:
                continue
            method, others = NAMES[name], list[str]()
            if group.names != _SIMULATORS:
                made = variants(method, calibrate=True, conditioned=True)
                others = [each.name for each in made if each.name != name]
            shown.update(others)
            also = ", ".join(other[len(name) :] for other in others)
            fitted = any(isinstance(part, GreyBox) for part in (method, *parts_of(method)))
            required = sorted(method.needs | ({"simulator", "parameters"} if fitted else set()))
            needs = ", ".join(f"--{each}" for each in required)
            table.add_row(f"  {method.in_words()}", name, also, needs)
    showing.console.print(table)
    showing.as_json(
        {group.title: {name: NAMES[name].in_words() for name in group.names} for group in GROUPS}
    )
