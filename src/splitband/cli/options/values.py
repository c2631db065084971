"""Read the values of options that are lists, times or pairs."""

from __future__ import annotations

import csv

from splitband.runtime.errors import InputError


def names(text: str, blank: bool = False) -> list[str]:
    """Return the parts of a comma-separated option; one in double quotes may have commas.

    Empty parts are left out unless they may be `blank`.
    """
    line = " ".join(text.splitlines())
    parts = next(csv.reader([line], skipinitialspace=True))
    return [part.strip() for part in parts if blank or part.strip()]


def seconds(duration: str, option: str = "--budget") -> float:
    """Return the length of a duration such as 90s, 10m or 1h; raises ValueError for other text."""
    number, unit = duration.strip()[:-1], duration.strip()[-1:].lower()
    try:
        length = float(number) * {"s": 1, "m": 60, "h": 3600}[unit]
    except (KeyError, ValueError):
        length = 0.0
    if not 0 < length < float("inf"):
        raise InputError(f"{option} must be a time such as 90s, 10m or 1h, got {duration}")
    return length


def milestones(text: str) -> tuple[tuple[int, float], ...]:
    """Return the pairs of --lr-milestones."""
    try:
        pairs = [part.split(":") for part in names(text)]
        return tuple((int(epoch), float(rate)) for epoch, rate in pairs)
    except ValueError:
        raise InputError(f"--lr-milestones must be EPOCH:RATE,EPOCH:RATE,..., got {text}") from None


def hidden(text: str) -> tuple[int, int]:
    """Return the two sizes of --hidden."""
    try:
        high, low = (int(part) for part in names(text))
    except ValueError:
        raise InputError(f"--hidden must be HIGH,LOW, two whole numbers, got {text}") from None
    return high, low
