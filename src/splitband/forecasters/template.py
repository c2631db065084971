"""Define what a network makes its cells after."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from splitband.networks import Cell


@runtime_checkable
class Template(Protocol):
    """Describe a cell, or something else, that cells of the right sizes are made after."""

    def sized(self, ny: int, nu: int, warmup: int) -> Cell:
        """Return a new cell, its weights drawn by torch's generator.

        `ny` and `nu` are its channels and inputs, `warmup` is the number of measured samples that
        set its initial state.
        """


def as_template(cell: Any) -> Template:
    """Check that cells can be made after it; raises TypeError otherwise."""
    if not isinstance(cell, Template):
        raise TypeError(
            f"a cell must have a method sized(ny, nu, warmup) that makes one of these sizes, got "
            f"{type(cell).__name__}"
        )
    return cell


def label_of(template: Template) -> str:
    """Return what names and tables call a cell: its `label`, or its class."""
    return str(getattr(template, "label", type(template).__name__.lower()))
