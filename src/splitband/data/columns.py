"""Convert columns of a table to numbers."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from pandas.api.types import (
    is_complex_dtype,
    is_numeric_dtype,
    is_object_dtype,
    is_string_dtype,
)

from splitband.runtime.arrays import Array

Column: TypeAlias = "pd.Series[Any]"


def has_number(column: Column) -> bool:
    """Return whether at least one cell holds a number."""
    if is_object_dtype(column) or is_string_dtype(column):
        column = pd.to_numeric(column, errors="coerce")
    return is_numeric_dtype(column) and bool(column.notna().any())


def numbers(what: str, column: Column) -> Array:
    """Return a column as float64 numbers, (time,)."""
    if not is_numeric_dtype(column):
        cells = column.astype(object)
        column = pd.to_numeric(cells, errors="coerce")
        if (bad := np.flatnonzero(column.isna() & cells.notna())).size:
            cell = str(cells.iloc[bad[0]])[:40]
            raise ValueError(f"{what} must be numeric: row {bad[0]} holds {cell!r}")
    if is_complex_dtype(column):
        raise ValueError(f"{what} must be real: it holds complex values")
    return column.to_numpy(dtype=np.float64, na_value=np.nan)
