"""Format numbers for tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pandas as pd

from splitband.records import Record

_MISSING = "–"  # noqa: RUF001
_SMALLEST, _LARGEST = 1e-3, 1e5
"""Range of numbers without an exponent. Layout."""


def number(value: float | None) -> str:
    """Return a number with three significant digits; a dash for None and NaN."""
    if value is None or value != value:  # noqa: PLR0124  NaN
        return _MISSING
    if value and not _SMALLEST <= abs(value) < _LARGEST:
        return f"{value:.2e}"
    return f"{float(f'{value:.3g}'):,.12g}"


def gain_in_words(gain: float) -> str:
    """Return a static gain: inf of an integrator, NaN of a response that has not settled."""
    if math.isinf(gain):
        return "integrating"
    return "not settled" if math.isnan(gain) else number(gain)


def percent(share: float) -> str:
    """Return a share as a percentage."""
    digits = f"{100 * share:.0f}" if abs(share) >= 0.1 else f"{100 * share:.2g}"
    return f"{digits}\N{NO-BREAK SPACE}%"


def decimals(values: Sequence[float]) -> int:
    """Return the decimal places of a column: three digits of the smallest number, at most four."""
    sizes = [abs(v) for v in values if math.isfinite(v) and _SMALLEST <= abs(v) < _LARGEST]
    return min(max(2 - math.floor(math.log10(min(sizes))), 0), 4) if sizes else 1


def aligned(value: float, decimals: int) -> str:
    """Return a number with fixed decimal places; too large or small numbers by `number`."""
    if abs(value) >= _LARGEST or round(value, decimals) == 0 != value:
        return number(value)
    return f"{value:,.{decimals}f}"


def complex_in_words(value: complex) -> str:
    """Return a pair of conjugate numbers, such as 0.95 ± 0.1j, or a real number."""
    return f"{value.real:.5g}" + (f" ± {abs(value.imag):.5g}j" if value.imag else "")


def in_one_offset(stamps: pd.DatetimeIndex) -> pd.DatetimeIndex:
    """Return date stamps without a time zone, by the clock of the first one: evenly spaced."""
    offset = stamps[0].utcoffset() if len(stamps) else None
    return stamps.tz_localize(None) if offset is None else stamps.tz_convert(None) + offset


def squared(record: Record) -> str:
    """Return the unit of a record's outputs, squared."""
    units = {*record.units}
    return f"({units.pop()})²" if len(units) == 1 and "" not in units else "unit²"
