"""Find and fill gaps: samples that were not measured."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitband.runtime.arrays import Array, Flags

Gaps = Literal["refuse", "mask"]


class ReadingWarning(UserWarning):
    """Warn that a column is left out, that its meaning was inferred, or that gaps were filled."""


def filled(what: str, values: Array, hold: bool = False) -> tuple[Array, Flags]:
    """Fill values that are not finite; return the result and a mask of finite values.

    Both have the shape of `values`, `(time, n)`. A gap is a straight line, or the value before it
    with `hold`; before the first and after the last finite value of a channel that value is held.

    Raises ValueError for a channel without finite values.
    """
    known = np.isfinite(values)
    index = np.arange(len(values))
    whole = np.array(values)
    for channel, seen in enumerate(known.T):
        if not seen.any():
            raise ValueError(f"{what} must have a finite value in channel {channel}: it has none")
        held = np.maximum.accumulate(np.where(seen, index, seen.argmax()))
        at = held if hold else index
        whole[~seen, channel] = np.interp(at[~seen], index[seen], values[seen, channel])
    return whole, known


def stretches(rows: Flags) -> list[tuple[int, int]]:
    """Return the first and last index of each stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def places(rows: Flags, most: int = 6) -> str:
    """Describe the stretches of true values for a message: "rows 3, 7 to 9"."""
    gaps = stretches(rows)
    named = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in gaps[:most])
    more = f" and {len(gaps) - most} more stretches" if len(gaps) > most else ""
    return f"row{'s' if len(gaps) > 1 or gaps[0][0] != gaps[0][1] else ''} {named}{more}"


def last_before(complete: Flags, length: int, at: int) -> int | None:
    """Return the last index up to `at` directly after `length` complete samples, or None."""
    ends = _ends(complete[:at], length)
    return int(ends[-1]) if len(ends) else None


def first_after(complete: Flags, length: int) -> int | None:
    """Return the first index directly after `length` complete samples, or None."""
    ends = _ends(complete, length)
    return int(ends[0]) if len(ends) else None


def _ends(complete: Flags, length: int) -> NDArray[Any]:
    count = np.concatenate([[0], np.cumsum(complete)])
    return np.flatnonzero(count[length:] - count[:-length] == length) + length
