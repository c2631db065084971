"""Define the types of arrays that signatures use."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

# NumPy's NDArray is another kind of type from 2.5 on; fields are checked by what they are made of.
Array: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.float64]]
Flags: TypeAlias = np.ndarray[tuple[Any, ...], np.dtype[np.bool_]]
