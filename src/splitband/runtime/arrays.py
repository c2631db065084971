"""Define the types of arrays in signatures."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

# Not NumPy's NDArray: from 2.5 on it is another kind of type, for which checks of fields fail.
Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
Flags: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]
