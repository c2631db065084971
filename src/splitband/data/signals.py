"""Check signals: shapes, finite values, and a range in which their squares can be summed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splitband.data.gaps import places
from splitband.runtime.arrays import Array

LARGEST, SMALLEST = 1e120, 1e-120
"""Largest value and smallest range of a channel: sums of squares must not over- or underflow."""


def positive_seconds(value: Any) -> float:
    """Return a sampling time as a float; raises ValueError unless it is finite and positive."""
    try:
        seconds = float(value)
    except (TypeError, ValueError):
        seconds = np.nan
    if not (np.isfinite(seconds) and seconds > 0):
        raise ValueError(f"sampling_time must be a positive number of seconds: got {value!r}")
    return seconds


def signal_of(what: str, value: Any) -> Array:
    """Copy `value` into a read-only float64 array (time, channels)."""
    try:
        is_complex = np.iscomplexobj(value)
        array = np.array(value if not is_complex else [], dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} must be an array of numbers: {one_line(error)}") from error
    if is_complex:
        raise ValueError(f"{what} must be real: it holds complex values")
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] == 0:
        raise ValueError(f"{what} must be (time,) or (time, channels): its shape is {array.shape}")
    array.setflags(write=False)
    return array


def require_finite(what: str, values: Array, columns: Sequence[str] = ()) -> None:
    """Raise ValueError, naming the place, for values not finite or beyond the limits above."""
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        column = f", column {columns[bad[0, 1]]!r}" if columns else ""
        raise ValueError(
            f"{what} must be finite: {len(bad)} bad value{'s' if len(bad) > 1 else ''}, "
            f"the first ({values[tuple(bad[0])]}) at row {bad[0, 0]}{column}"
            + (f"; {places(np.asarray(~np.isfinite(values).all(axis=1)))}" if len(bad) > 1 else "")
        )

    low, high = values.min(axis=0, initial=0.0), values.max(axis=0, initial=0.0)
    largest = np.maximum(-low, high)
    with np.errstate(over="ignore"):
        span = np.ptp(values, axis=0) if len(values) else largest
    for extent, rule, off in (
        (largest, f"of {LARGEST:g} at most", largest > LARGEST),
        (span, f"constant, or of a range of {SMALLEST:g} at least", (span > 0) & (span < SMALLEST)),
    ):
        if off.any():
            column = f" in column {columns[int(off.argmax())]!r}" if columns else ""
            raise ValueError(
                f"{what} must be {rule}, in another unit if need be: got {extent[off][0]:g}{column}"
            )


def one_line(error: BaseException) -> str:
    """Return the message of another library's error on one line."""
    return " ".join(str(error).split())[:300] or type(error).__name__
