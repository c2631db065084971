"""Read tables from text: detect separator, header and decimal sign, and parse with pandas."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import pandas as pd
from pandas.api.types import is_object_dtype, is_string_dtype

from splitband.data.columns import Column

_SIGNS = {".": ",", ",": "."}
"""Decimal signs, each with its thousands separator."""
_ERRORS_OF_CELLS = r"N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!"
"""Error values of spreadsheets after a "#", which then does not begin a comment."""
_DIGIT_BLANK_DIGIT = re.compile(r"\d,\d+\s+[-+]?\d+,\d")


def read_table(raw: bytes, suffix: str) -> pd.DataFrame:
    """Read the columns of a text file, with or without a header.

    Numbers have a decimal point or a decimal comma, the same in the whole file, and may have
    thousands separators.

    Raises ValueError for a file without data, for duplicate column names, and for an ambiguous
    decimal sign; pandas raises its own errors for text that is not a table.
    """
    lines = _lines(raw, mark_inside=suffix not in (".csv", ".tsv"))
    body = [line for line in lines if line]
    if not body:
        raise ValueError("it holds no data")
    sep = _separator(body, suffix)
    parsed = partial(_parsed, sep=sep)
    first = parsed(body[0], header=None, dtype=str).iloc[0].str.strip()
    header = _is_header([*first.dropna()])
    if header:  # pandas would number them
        check_different([*first.dropna()])
    elif len(body) == 1:  # a single row of numbers is read as a column
        cells = first.iloc[:-1] if body[0].rstrip(" ").endswith(sep) else first
        lines = [f'"{cell}"' for cell in cells.fillna("nan")]
    text = "\n".join(lines)
    parsed = partial(parsed, header=0 if header else None)
    warnings.simplefilter("error", pd.errors.ParserWarning)  # rows longer than the header
    if ('"' if sep == "," else ",") not in text and sep not in ";\t":
        return parsed(text)  # no cell can hold a comma
    cells_as_text = parsed(text, dtype=str)
    decimal = _decimal(cells_as_text, sep)
    frame = parsed(text, decimal=decimal)
    for name in frame.columns:
        if is_string_dtype(frame[name]) or is_object_dtype(frame[name]):
            frame[name] = _without_separators(cells_as_text[name], decimal)
    return frame


def _parsed(text: str, *, sep: str, **options: Any) -> pd.DataFrame:
    file, between = io.StringIO(text), r"\s+" if sep == " " else sep
    return pd.read_csv(file, sep=between, index_col=False, skipinitialspace=True, **options)


def check_different(names: Sequence[str]) -> None:
    """Raise ValueError where two columns have the same name."""
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(
            f"columns must have different names: {twice!r} stands {names.count(twice)} times"
        )


def _lines(raw: bytes, mark_inside: bool) -> list[str]:
    """Decode the file and blank out comments, with `mark_inside` also those within a line.

    Blank lines stay, so that the line numbers in pandas' messages are those of the file.
    """
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = raw.decode("utf-16")
    elif b"\0" in raw:
        raise ValueError("it is a binary file; save a spreadsheet as CSV")
    else:
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
    mark = rf"#(?!{_ERRORS_OF_CELLS}).*"
    comment = re.compile(mark if mark_inside else rf"^\s*{mark}")
    lines = (comment.sub("", line) if "#" in line else line for line in re.split("\r\n?|\n", text))
    return [line if line.strip(" ") else "" for line in lines]


def _separator(body: Sequence[str], suffix: str) -> str:
    """Return the separator of the columns; " " stands for any spaces."""
    if suffix == ".tsv":
        return "\t"
    line = body[min(1, len(body) - 1)]
    found = next((sep for sep in ";\t," if sep in line), "," if suffix == ".csv" else " ")
    return " " if found == "," and _DIGIT_BLANK_DIGIT.search(line) else found


def _is_header(cells: Sequence[str]) -> bool:
    """Return whether some cell is a word, and the only numbers are bare 0, 1, 2..."""
    words = False
    for cell in cells:
        if _is_number(cell):
            if not cell.isdigit():
                return False
        else:
            words = words or not (re.match(r"\d+[-/.:]\d", cell) or cell == "")
    return words


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return any(re.fullmatch(_number(decimal), cell) for decimal in _SIGNS)
    return True


def _number(decimal: str) -> str:
    """Return the pattern of a number with this decimal sign, thousands separators included."""
    sign, thousands = re.escape(decimal), re.escape(_SIGNS[decimal])
    return (
        rf"\s*[-+]?(?:(?:\d+{sign}?\d*|{sign}\d+)(?:[eE][-+]?\d+)?"
        rf"|[1-9]\d{{0,2}}(?:{thousands}\d{{3}})+(?:{sign}\d*)?)\s*"
    )


def _decimal(cells: pd.DataFrame, sep: str) -> str:
    """Return the decimal sign of a file from all of its cells.

    "0,5" has a decimal comma, "1,234.5" a decimal point, and "1,234" is ambiguous. If all cells of
    the file are ambiguous, the sign counts as decimal sign, unless it separates the columns or its
    column also contains integers without it (999 before 1.006).

    Raises ValueError if cells contradict each other, or if the sign stays ambiguous; the message
    names columns and cells.
    """
    found: dict[str, str] = {}
    open_signs: dict[str, str] = {}
    doubtful = ""
    for name, column in cells.items():
        matches = {sign: column.str.fullmatch(_number(sign), na=False) for sign in _SIGNS}
        either = matches["."] | matches[","]
        if not 2 * int(either.sum()) > int(column.notna().sum()):
            continue  # a text column: its numbers may be written differently
        for sign, other in _SIGNS.items():
            only = matches[sign] & ~matches[other]
            if only.any():
                found.setdefault(sign, _cell(name, column, only))
        both = matches["."] & matches[","]
        for sign in _SIGNS:
            unclear = both & column.str.contains(sign, regex=False, na=False)
            if unclear.any():
                open_signs.setdefault(sign, _cell(name, column, unclear))
                if sign == sep or column[both].str.fullmatch(r"\s*[-+]?\d+\s*").any():
                    doubtful = doubtful or open_signs[sign]
    if len(found) == 2:
        raise ValueError(
            f"numbers must have one decimal sign in the whole file: {found['.']}, {found[',']}"
        )
    if not found and (doubtful or len(open_signs) == 2):
        raise ValueError(
            f"the decimal sign cannot be told from a thousands separator: "
            f"{doubtful or open_signs[',']}; save the file without thousands separators"
        )
    return next(iter(found or open_signs), ".")


def _cell(name: Any, column: Column, where: pd.Series[bool]) -> str:
    """Return a description of the first marked cell for a message."""
    row = int(where.to_numpy().argmax())
    return f"column {str(name)!r} holds {column.iloc[row]!r} at row {row}"


def _without_separators(column: Column, decimal: str) -> Column:
    """Return a column as numbers; if a cell is not a number, as text that `float` can read."""
    is_number = column.str.fullmatch(_number(decimal), na=False)
    plain = column.str.replace(_SIGNS[decimal], "", regex=False)
    plain = column.where(~is_number, plain.str.replace(decimal, ".", regex=False))
    values = pd.to_numeric(plain, errors="coerce")
    return plain if (values.isna() & plain.notna()).any() else values
