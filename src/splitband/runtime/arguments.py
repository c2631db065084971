"""Check common arguments of several packages."""

from __future__ import annotations

import operator
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

from splitband.runtime.errors import InputError
from splitband.runtime.optional import require_torch

LARGEST_SIZE = 10_000
"""Largest order, down-sampling or size of a network. Bounds the memory."""


def whole(name: str, value: Any, least: int | None = 1, most: int | None = None) -> int:
    """Return a whole number as an `int`, including NumPy's integers."""
    try:
        number = operator.index(value)
    except TypeError:
        number = None
    if number is None or isinstance(value, bool):
        raise InputError(f"{name} must be a whole number, got {str(value)[:60]!r}") from None
    if least is not None and most is not None and not least <= number <= most:
        raise InputError(f"{name} must be between {least} and {most}, got {number}")
    if least is not None and number < least:
        raise InputError(f"{name} must be at least {least}, got {number}")
    return number


def did_you_mean(unknown: Iterable[str], possible: Iterable[str]) -> str:
    """Return " (did you mean ...?)" with the closest names to the unknown ones, or nothing."""
    possible = [*possible]
    close = [match for name in unknown for match in get_close_matches(name, possible, 1)]
    return f" (did you mean {', '.join(close)}?)" if close else ""


def check_device(name: Any) -> None:
    """Raise ValueError for an unavailable device of networks."""
    if name == "cpu":
        return
    require_torch(f"the device {name}")
    import torch  # noqa: PLC0415  only for another device

    try:
        torch.zeros(1, dtype=torch.float64, device=name).item()
    except (RuntimeError, AssertionError, NotImplementedError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"device must be one that is there and has float64, got {name}: {reason}"
        ) from None
