"""Check signals and their names, turn columns into numbers, find and fill gaps."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from mmap import mmap
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas.api.types import is_complex_dtype, is_numeric_dtype, is_object_dtype, is_string_dtype

from splitband.runtime.arrays import Array, Flags
from splitband.runtime.errors import InputError, one_line

LARGEST, SMALLEST = 1e120, 1e-120
"""Largest value and smallest range of a channel: sums of squares must not over- or underflow."""
Gaps = Literal["refuse", "mask"]
Column: TypeAlias = "pd.Series[Any]"
_NUMBERED = re.compile(r"[yu]\d*|\d+")
"""Default names such as "y", "u1" or "2", see `same_names`."""
_THOUSANDS = {".": "[,'\u2019\u00a0\u202f]", ",": "[.'\u2019\u00a0\u202f]"}
"""Pattern of the thousands separators beside each decimal sign."""
_INTEGER = r"\s*[-+]?\d+\s*"
_ON = "on true yes open open active enabled running t y"
_OFF = "off false no closed close inactive disabled stopped f n"
"""Words for the states of a switch, in small letters."""
MOST_BELOW = 9
"""Most rows below the samples, such as means, that a message takes for such."""
MOST_WORDS = 20
"""Most words of a column of categories, each of which becomes a column. By eye."""
_UNIT = re.compile(r"[ _][(\[]([^()\[\]]+)[)\]]$")
_NUMBER_WITH_UNIT = re.compile(r"[-+]?(?:\d+\.?|\d*\.\d+)(?:[eE][-+]?\d+)?(\s*(?:[%°]|[^\W\d])\D*)")


class ReadingWarning(UserWarning):
    """Warn that a column is left out, that its meaning was inferred, or that gaps were filled."""


def as_float(value: Any) -> float:
    """Return a value as a float; NaN for what is no finite number."""
    try:
        number = np.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError):
        return np.nan
    return number if np.isfinite(number) else np.nan


def positive_seconds(value: Any, what: str = "sampling_time") -> float:
    """Return a sampling time as a float; raises ValueError unless it is finite and positive."""
    seconds = as_float(value)
    if not seconds > 0:
        raise InputError(f"{what} must be a positive number of seconds: got {value!r}")
    return seconds


def signal_of(what: str, value: Any) -> Array:
    """Copy `value` into a read-only float64 array (time, channels), if it is not already one."""
    if type(value) is np.ndarray and value.ndim == 2 and value.shape[1]:
        as_kept = value.dtype == np.float64 and value.flags.c_contiguous
        if as_kept and _never_changes(value):
            return value
    try:
        is_complex = np.iscomplexobj(value)
        array = np.asarray(value if not is_complex else [], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} must be an array of numbers: {one_line(error)}") from error
    if is_complex:
        raise InputError(f"{what} must be real: it holds complex values")
    # The copy, not a view of it: slices of it are sent to other processes as parts of one file.
    array = np.array(array[:, None] if array.ndim == 1 else array, order="C")
    if array.ndim != 2 or array.shape[1] == 0:
        raise InputError(f"{what} must be (time,) or (time, channels): its shape is {array.shape}")
    array.setflags(write=False)
    return array


def _never_changes(array: Array) -> bool:
    """Return whether an array and what it is a view of are read-only."""
    base: Any = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return False
        base = base.base
    return base is None or (isinstance(base, mmap) and memoryview(base).readonly)


def require_finite(what: str, values: Array, columns: Sequence[str] = ()) -> None:
    """Raise ValueError, naming the place, for values not finite or beyond the limits above."""
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        column = f", column {columns[bad[0, 1]]!r}" if columns else ""
        rows = row_ranges(np.asarray(~np.isfinite(values).all(axis=1)))
        s, more = ("s", f"; {rows}") if len(bad) > 1 else ("", "")
        raise InputError(
            f"{what} must be finite: {len(bad)} bad value{s}, the first "
            f"({values[tuple(bad[0])]}) at row {bad[0, 0]}{column}{more}"
        )
    largest = np.abs(values).max(axis=0, initial=0.0)
    with np.errstate(over="ignore"):
        span = np.ptp(values, axis=0) if len(values) else largest
    for extent, rule, off in (
        (largest, f"of {LARGEST:g} at most", largest > LARGEST),
        (span, f"constant, or of a range of {SMALLEST:g} at least", (span > 0) & (span < SMALLEST)),
    ):
        if off.any():
            column = f" in column {columns[int(off.argmax())]!r}" if columns else ""
            raise InputError(
                f"{what} must be {rule}, in another unit if need be: got {extent[off][0]:g}{column}"
            )


def is_text(column: Column) -> bool:
    """Return whether a column may hold words."""
    return is_object_dtype(column) or is_string_dtype(column)


def has_number(column: Column) -> bool:
    """Return whether at least one cell of a column holds a number."""
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
            raise InputError(
                f"{what} must be numeric: row {bad[0]} holds {cell!r}{in_file(cells, bad[0])}"
                f"{hint_for(what, cell)}{below_samples(bad, len(cells))}"
            )
    if is_complex_dtype(column):
        raise InputError(f"{what} must be real: it holds complex values")
    return column.to_numpy(dtype=np.float64, na_value=np.nan)


def switch_of(column: Column) -> tuple[str, ...]:
    """Return the words for off and on of a column that holds one or both of them, else nothing."""
    spelled = _words(column)
    for states in zip(_OFF.split(), _ON.split(), strict=True):
        if spelled and spelled.keys() <= {*states}:
            return tuple(spelled.get(state, state) for state in states)
    return ()


def categories_of(column: Column) -> tuple[str, ...]:
    """Return the words of a column that holds at least two, or those of a switch; else nothing.

    Each begins with a letter: what does not may be a number with a unit.
    """
    spelled = _words(column)
    words = 1 < len(spelled) <= MOST_WORDS and all(word[:1].isalpha() for word in spelled)
    return switch_of(column) or (tuple(sorted(spelled.values())) if words else ())


def _words(column: Column) -> dict[str, str]:
    """Return the words of a column without numbers, by their small letters."""
    if not is_text(column) or has_number(column):
        return {}
    cells = column.dropna().astype(str).str.strip().unique()
    return {word.casefold(): word for word in sorted(cells, reverse=True)}


def category_names(name: str, words: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns for the words of one but the first: "mode=heat"."""
    return (name,) if len(words) == 2 else tuple(f"{name}={word}" for word in words[1:])


def indicators(name: str, column: Column, words: Sequence[str]) -> dict[str, Column]:
    """Return the columns for the words of a column but the first: 1 where it holds the word.

    The first word is 0 in all of them, as a further column would be the rest of the others. Raises
    ValueError for a cell that holds no such word.
    """
    cells = column.astype("string").str.strip().str.casefold()
    if (other := np.flatnonzero(cells.notna() & ~cells.isin([w.casefold() for w in words]))).size:
        row = int(other[0])
        raise InputError(
            f"column {name!r} must hold one of {', '.join(words)}: row {row} holds "
            f"{str(column.iloc[row])[:40]!r}{in_file(column, row)}"
        )
    return {
        each: (cells == word.casefold()).astype("Float64").astype(np.float64)
        for each, word in zip(category_names(name, words), words[1:], strict=True)
    }


def in_file(column: Column, row: int) -> str:
    """Return where a row stands in its text file, as " (line 5)"; empty for other files."""
    return f" (line {column.index[row]})" if column.index.name == "line" else ""


def hint_for(what: str, cell: str) -> str:
    """Return what to do about a cell that is the name of its column."""
    again = "; the names stand again there: remove the line, or split the file if runs were joined"
    return again if repr(cell) in what else ""


def below_samples(bad: NDArray[Any], rows: int) -> str:
    """Return what to do about bad rows, if they are the last few of so many."""
    few = 0 < len(bad) <= MOST_BELOW and bad[-1] - bad[0] == len(bad) - 1 and bad[-1] == rows - 1
    return "; remove what stands below the samples, such as a line of means" if few else ""


def number_pattern(decimal: str) -> str:
    """Return the pattern of a number with this decimal sign, thousands separators included."""
    sign, thousands = re.escape(decimal), _THOUSANDS[decimal]
    return (
        rf"\s*[-+]?(?:(?:\d+{sign}?\d*|{sign}\d+)(?:[eE][-+]?\d+|[dD][-+]\d\d+)?"
        rf"|[1-9]\d{{0,2}}(?:{thousands}\d{{3}})+(?:{sign}\d*)?"
        rf"|[1-9]\d{{0,2}}(?: \d{{3}})+{sign}\d+)\s*"  # without a sign, it may be two numbers
    )


def decimal_sign(cells: pd.DataFrame, separator: str) -> str:
    """Return the decimal sign of a file from all of its cells, which are text.

    "0,5" has a decimal comma, "1,234.5" a decimal point, and "1,234" is ambiguous. If all cells of
    the file are ambiguous, the sign counts as decimal sign, unless it separates the columns or its
    column also contains integers without it (999 before 1.006).
    """
    found: dict[str, str] = {}
    unclear: dict[str, str] = {}
    doubtful = ""
    for name, column in cells.items():
        point, comma = (column.str.fullmatch(number_pattern(sign), na=False) for sign in ".,")
        if not 2 * int((point | comma).sum()) > int(column.notna().sum()):
            continue  # a text column: its numbers may be written differently

        def cell(where: pd.Series[bool], name: Any = name, column: Column = column) -> str:
            row = int(where.to_numpy().argmax())
            return f"column {str(name)!r} holds {column.iloc[row]!r} at row {row}"

        for sign, only in ((".", point & ~comma), (",", comma & ~point)):
            if only.any():
                found.setdefault(sign, cell(only))
            either = point & comma & column.str.contains(sign, regex=False, na=False)
            if either.any():
                unclear.setdefault(sign, cell(either))
                if sign == separator or column[point & comma].str.fullmatch(_INTEGER).any():
                    doubtful = doubtful or unclear[sign]
    if len(found) == 2:
        raise InputError(
            f"numbers must have one decimal sign in the whole file: {found['.']}, {found[',']}"
        )
    if not found and (doubtful or len(unclear) == 2):
        raise InputError(
            f"the decimal sign cannot be told from a thousands separator: "
            f"{doubtful or unclear[',']}; save the file without thousands separators"
        )
    return next(iter(found or unclear), ".")


def plain_numbers(column: Column, decimal: str) -> Column:
    """Return a column as numbers; if a cell is not a number, as text that `float` can read."""
    is_number = column.str.fullmatch(number_pattern(decimal), na=False)
    plain = column.str.replace(f" |{_THOUSANDS[decimal]}", "", regex=True)
    plain = plain.str.replace("[dD]", "e", regex=True)  # Fortran's exponents
    plain = column.where(~is_number, plain.str.replace(decimal, ".", regex=False))
    values = pd.to_numeric(plain, errors="coerce")
    return plain if (values.isna() & plain.notna()).any() else values


def filled(what: str, values: Array, held: Flags | bool = False) -> tuple[Array, Flags]:
    """Fill values that are not finite; return the result and a mask of finite values.

    Both have the shape of `values`, `(time, n)`. A gap is a straight line, or the value before it
    in channels that are `held`, `(n,)`; before the first and after the last finite value of a
    channel that value is held.
    """
    known = np.isfinite(values)
    if not (some := known.any(axis=0)).all():
        raise InputError(f"{what} must have a finite value in channel {some.argmin()}: it has none")
    seen = pd.DataFrame(np.where(known, values, np.nan))
    lines, steps = seen.interpolate(limit_direction="both"), seen.ffill().bfill()
    return np.where(held, steps, lines), known


def refilled(y: Array, seen: Array) -> Array:
    """Return `seen` with its gaps (NaN) filled; a channel without values is that of `y`."""
    whole, known = np.array(y), np.isfinite(seen).any(axis=0)
    whole[:, known] = filled("y", seen[:, known])[0]
    return whole


def stretches(rows: Flags) -> list[tuple[int, int]]:
    """Return the first and last index of each stretch of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def row_ranges(rows: Flags, most: int = 6) -> str:
    """Describe the stretches of true values for a message: "rows 3, 7 to 9"."""
    gaps = stretches(rows)
    named = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in gaps[:most])
    more = f" and {len(gaps) - most} more stretches" if len(gaps) > most else ""
    return f"row{'s' if len(gaps) > 1 or gaps[0][0] != gaps[0][1] else ''} {named}{more}"


def last_before(y: Array, length: int, at: int) -> int | None:
    """Return the last of the `warm_ends` up to `at`, or None."""
    ends = warm_ends(y[:at], length)
    return int(ends[-1]) if len(ends) else None


def first_after(y: Array, length: int) -> int | None:
    """Return the first of the `warm_ends`, or None."""
    ends = warm_ends(y, length)
    return int(ends[0]) if len(ends) else None


def warm_ends(y: Array, length: int) -> NDArray[Any]:
    """Return the indices directly after `length` samples that a warm-up may hold.

    `y` has NaN in gaps. The last sample is a measured one, as the next one of a slow channel is not
    known at an origin; where channels are never measured together, it is any.
    """
    count = np.concatenate([[0], np.cumsum(covered(y))])
    ends = np.flatnonzero(count[length:] - count[:-length] == length) + length
    measured = ends[np.asarray(np.isfinite(y).all(axis=1))[ends - 1]]
    return measured if len(measured) else ends


def usual_distance(known: Flags) -> int:
    """Return every how many samples one is usually known; 1 for fewer than two."""
    at = np.flatnonzero(known)
    return int(np.median(np.diff(at))) if len(at) > 1 else 1


def covered(y: Array) -> Flags:
    """Return a mask of the samples that a warm-up may hold, `(time,)`; `y` has NaN in gaps.

    Every channel is measured there, or between two samples that are as far apart as its samples
    usually are: a channel that is slower than the others is interpolated in a warm-up.
    """
    known = np.isfinite(y)
    if known.all():
        return np.ones(len(y), np.bool_)
    index = np.arange(len(y))
    for i, channel in enumerate(known.T):
        if (usual := usual_distance(channel)) < 2:
            continue
        own = np.flatnonzero(channel)
        at = np.clip(np.searchsorted(own, index), 1, len(own) - 1)
        near = own[at] - own[at - 1] <= 1.75 * usual
        known[:, i] |= near & (own[0] <= index) & (index <= own[-1])
    return np.asarray(known.all(axis=1))


def numbered(letter: str, count: int) -> tuple[str, ...]:
    """Return default names of signals: the letter, with a number if there are several."""
    return (letter,) if count == 1 else tuple(f"{letter}{i}" for i in range(count))


def channel_names(field: str, names: Sequence[str], letter: str, count: int) -> tuple[str, ...]:
    """Return the names of signals, by default numbered; raises ValueError unless they differ."""
    names = tuple(names) or (numbered(letter, count) if count else ())
    if len(names) != count:
        raise InputError(f"{field} must name each of the {count} channels of {letter}: got {names}")
    if len(set(names)) < count:
        raise InputError(f"{field} must differ: got {names}")
    return names


def unit_of(name: str) -> str:
    """Return the unit in brackets at the end of a name, "m" of "x (m)" or "x [m]", or ""."""
    found = _UNIT.search(name)
    return found[1] if found else ""


def common_unit(cells: Iterable[str]) -> str:
    """Return what follows the number in every cell, " V" of "3.2 V" and "-3 V", or ""."""
    found = [_NUMBER_WITH_UNIT.fullmatch(cell) for cell in cells]
    units = {match[1] if match else "" for match in found}
    return units.pop() if len(units) == 1 else ""


def bare_name(name: str) -> str:
    """Return a name without the unit in brackets at its end."""
    return _UNIT.sub("", name)


def same_names(names: Sequence[str], others: Sequence[str]) -> bool:
    """Return whether two lists can name the same signals; numbered names match any others."""
    if sorted(names) == sorted(others) or len(names) != len(others):
        return tuple(names) == tuple(others)
    return any(all(map(_NUMBERED.fullmatch, each)) for each in (names, others))


def listed(names: Sequence[str]) -> str:
    """Return names as options of commands take them: separated by commas, if need be in quotes."""
    return ",".join(f'"{name}"' if "," in name else name for name in names)


def described(columns: Sequence[str], inputs: Sequence[str]) -> str:
    """Return the names of a record's inputs and outputs for a message."""
    return f"inputs: {', '.join(inputs) or 'none'}; outputs: {', '.join(columns)}"
