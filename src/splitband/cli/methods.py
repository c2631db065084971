"""Define `splitband methods`: the methods by name."""

from __future__ import annotations

from rich.table import Column, Table

from splitband.cli import printing
from splitband.comparison.methods import NAMES, variants
from splitband.forecasters.base import all_parts
from splitband.forecasters.grey_box import GreyBox


def methods() -> None:
    """List the methods by name: what each is, and the options that it needs.

    One network (gru, euler-mlp, state-space) suits any record, split-... one with a slow and a fast
    part, filtered-... and residual-... one with a simulator that is roughly right, or with a simple
    slow part. The others are references to beat. In a name that ends in -calibrated the simulator
    is calibrated first (gain, offset, delay, clock); in one that ends in -conditioned the network
    has the slower part's output as an input. Give names to --methods, separated by commas.
    """
    table = Table(Column("name", no_wrap=True), "also as", "what it is", "needs")
    listed: set[str] = set()
    for name, method in NAMES.items():
        if name in listed:
            continue
        others = [each.name for each in variants(method, calibrate=True, conditioned=True)[1:]]
        listed.update(others)
        fitted = any(isinstance(part, GreyBox) for part in all_parts(method))
        needs = method.needs | ({"simulator", "parameters"} if fitted else set())
        also = ", ".join(other.removeprefix(name) for other in others)
        table.add_row(name, also, method.in_words(), ", ".join(f"--{n}" for n in sorted(needs)))
    printing.console.print(table)
    printing.as_json({name: method.in_words() for name, method in NAMES.items()})
