"""Define the types of arrays in signatures."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from splitband.runtime.errors import InputError

# Not NumPy's NDArray: from 2.5 on it is another kind of type, for which checks of fields fail.
Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
Flags: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]


def check_shape(name: str, array: Array | None, *shape: int | None) -> None:
    """Raise ValueError for an array that has not this shape; None stands for any length."""
    found = () if array is None else array.shape
    fits = zip(found, shape, strict=False)
    if len(found) != len(shape) or any(n is not None and n != size for size, n in fits):
        raise InputError(f"{name} must have the shape {shape}, got {found}".replace("None", "any"))
