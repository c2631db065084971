"""Names that options list, and the methods that they stand for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import NAMES, TRAINED

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
    """Raise ValueError, with what may have been meant, unless all that is asked for is possible."""
    possible = [*possible]
    unknown = [name for name in asked if name not in possible]
    if not unknown and asked:
        return
    meant = [close for name in unknown for close in get_close_matches(name, possible, 1)]
    raise ValueError(
        f"{option} must be among those that `splitband methods` lists, "
        f"got {', '.join(unknown) or 'none'}"
        + (f"; {', '.join(meant)} is there" if meant else "")
        + ("" if len(possible) == len(NAMES) else f" (here {', '.join(possible)})")
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
