"""Name the channels and inputs of records, and compare their names."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBERED = re.compile(r"[yu]\d*|\d+")
"""Names that are only a letter or a number, see `same_names`."""

_UNIT = re.compile(r"[ _][(\[]([^()\[\]]+)[)\]]$")


def numbered(letter: str, count: int) -> tuple[str, ...]:
    """Return the names of signals without names: the letter, numbered where there are several."""
    return (letter,) if count == 1 else tuple(f"{letter}{i}" for i in range(count))


def check_names(field: str, names: tuple[str, ...], what: str, count: int) -> None:
    """Raise ValueError unless there are so many names, no two of them the same."""
    if len(names) != count:
        raise ValueError(f"{field} must name {what}: got {names}")
    if len(set(names)) < count:
        raise ValueError(f"{field} must differ: got {names}")


def unit_of(name: str) -> str:
    """Return the unit that ends a column's name in brackets, "m" of "x (m)" or "x [m]"; or ""."""
    found = _UNIT.search(name)
    return found[1] if found else ""


def same_names(names: Sequence[str], others: Sequence[str]) -> bool:
    """Tell whether two lists can name the same signals; names by number alone fit any others.

    These are what `Record` calls signals without names, and positions in a file.
    """
    if sorted(names) == sorted(others) or len(names) != len(others):
        return tuple(names) == tuple(others)
    return any(all(map(_NUMBERED.fullmatch, each)) for each in (names, others))


def described(columns: Sequence[str], inputs: Sequence[str]) -> str:
    """Return inputs and outputs of a record, by name, for messages."""
    return f"inputs: {', '.join(inputs) or 'none'}; outputs: {', '.join(columns)}"
