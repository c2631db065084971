"""Name the channels and inputs of records, and compare their names."""

from __future__ import annotations

import re
from collections.abc import Sequence

_NUMBERED = re.compile(r"[yu]\d*|\d+")
"""Default names such as "y", "u1" or "2", see `same_names`."""

_UNIT = re.compile(r"[ _][(\[]([^()\[\]]+)[)\]]$")


def numbered(letter: str, count: int) -> tuple[str, ...]:
    """Return default names of signals: the letter, with a number if there are several."""
    return (letter,) if count == 1 else tuple(f"{letter}{i}" for i in range(count))


def check_names(field: str, names: tuple[str, ...], what: str, count: int) -> None:
    """Raise ValueError unless there are `count` different names."""
    if len(names) != count:
        raise ValueError(f"{field} must name {what}: got {names}")
    if len(set(names)) < count:
        raise ValueError(f"{field} must differ: got {names}")


def unit_of(name: str) -> str:
    """Return the unit in brackets at the end of a name, "m" of "x (m)" or "x [m]", or ""."""
    found = _UNIT.search(name)
    return found[1] if found else ""


def bare_name(name: str) -> str:
    """Return a name without the unit in brackets at its end."""
    return _UNIT.sub("", name)


def same_names(names: Sequence[str], others: Sequence[str]) -> bool:
    """Return whether two lists can name the same signals; numbered names match any others.

    Numbered names are the defaults of `Record`, and column positions in a file.
    """
    if sorted(names) == sorted(others) or len(names) != len(others):
        return tuple(names) == tuple(others)
    return any(all(map(_NUMBERED.fullmatch, each)) for each in (names, others))


def described(columns: Sequence[str], inputs: Sequence[str]) -> str:
    """Return the names of a record's inputs and outputs for a message."""
    return f"inputs: {', '.join(inputs) or 'none'}; outputs: {', '.join(columns)}"
