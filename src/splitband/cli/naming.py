"""Names that options list, and the methods that they stand for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import NAMES, TRAINED
from splitband.runtime.arguments import did_you_mean

FITTED = tuple(name for name in NAMES if name in TRAINED or "simulator" not in NAMES[name].needs)
"""Methods whose saved models `simulate` reads: all that learn something of the record."""


def names(text: str) -> list[str]:
    """The parts of a comma-separated option."""
    return [part.strip() for part in text.split(",") if part.strip()]


def method_names(text: str) -> list[str]:
    """The names of an option that lists methods; raises ValueError for unknown ones."""
    asked = names(text)
    check_names("--methods", asked, NAMES)
    return asked


def check_names(option: str, asked: Sequence[str], possible: Iterable[str]) -> None:
    """Raise ValueError, with the closest name, for a name that is not possible."""
    possible = [*possible]
    unknown = [name for name in asked if name not in possible]
    if not unknown and asked:
        return
    raise ValueError(
        f"{option} must name methods that `splitband methods` lists, "
        f"got {', '.join(unknown) or 'none'}{did_you_mean(unknown, possible)}"
        + (", which this command cannot use" if {*unknown} & {*NAMES} else "")
    )


def check_needs(methods: Sequence[Forecaster], record: Record) -> None:
    """Raise ValueError, which names the option, where a record lacks what a method needs."""
    for what, need, given in (
        ("a simulator", "simulator", record.y_sim),
        ("known inputs", "inputs", record.u),
    ):
        lacking = next((m for m in methods if need in m.needs and given is None), None)
        if lacking is not None:
            raise ValueError(f"{lacking.name} needs {what} (--{need}), {record.name} has none")
