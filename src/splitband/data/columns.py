"""Convert columns of a table to numbers."""

from __future__ import annotations

from collections.abc import Sequence
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


def is_text(column: Column) -> bool:
    """Return whether a column may hold words."""
    return is_object_dtype(column) or is_string_dtype(column)


def has_number(column: Column) -> bool:
    """Return whether at least one cell holds a number."""
    if is_text(column):
        column = pd.to_numeric(column, errors="coerce")
    return is_numeric_dtype(column) and bool(column.notna().any())


def numbers(what: str, column: Column) -> Array:
    """Return a column as float64 numbers, (time,)."""
    if not is_numeric_dtype(column):
        cells = column.astype(object)
        column = pd.to_numeric(cells, errors="coerce")
        if (bad := np.flatnonzero(column.isna() & cells.notna())).size:
            cell = str(cells.iloc[bad[0]])[:40]
            raise ValueError(
                f"{what} must be numeric: row {bad[0]} holds {cell!r}{in_file(cells, bad[0])}"
            )
    if is_complex_dtype(column):
        raise ValueError(f"{what} must be real: it holds complex values")
    return column.to_numpy(dtype=np.float64, na_value=np.nan)


def in_file(column: Column, row: int) -> str:
    """Return where a row stands in its text file, as " (line 5)"; empty for other files."""
    return f" (line {column.index[row]})" if column.index.name == "line" else ""


def without(column: Column, words: Sequence[str]) -> Column:
    """Return a column without the cells that stand for missing values."""
    values = pd.to_numeric(column, errors="coerce") if is_text(column) else column
    missing = values.isin([value for word in words if np.isfinite(value := _number(word))])
    if is_text(column):
        missing |= column.astype(str).str.strip().isin(words)
    column = column.mask(missing) if missing.any() else column
    values = pd.to_numeric(column, errors="coerce") if is_text(column) else column
    return column if (values.isna() & column.notna()).any() else values


def _number(word: str) -> float:
    try:
        return float(word.replace(",", "."))
    except ValueError:
        return float("nan")
