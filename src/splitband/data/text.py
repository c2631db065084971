"""Read tables from text: decode, parse with pandas, and find the decimal sign."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_object_dtype, is_string_dtype

from splitband.data.columns import Column
from splitband.data.layout import SIGNS, Layout, Row, find_head, number_pattern, separator

_ERRORS_OF_CELLS = r"N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!"
"""Error values of spreadsheets after a "#", which then does not begin a comment."""
_EXCELS_SEPARATOR = re.compile(r"sep=(.)\s*", re.IGNORECASE)
_RAGGED = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")


def read_table(raw: bytes, suffix: str, layout: Layout) -> pd.DataFrame:
    """Read the columns of a text file, with or without a header; the index holds its lines.

    Numbers have a decimal point or a decimal comma, the same in the whole file, and may have
    thousands separators.

    Raises ValueError for a file without data, for duplicate column names, for rows of different
    length, and for an ambiguous layout or decimal sign.
    """
    written = re.split("\r\n?|\n", _decoded(raw))
    lines = _without_comments(written, mark_inside=suffix not in (".csv", ".tsv"))
    begin = next((i for i, line in enumerate(lines) if line), 0)
    sep = "\t" if suffix == ".tsv" else ""
    if excels := _EXCELS_SEPARATOR.fullmatch(lines[begin]):
        sep, lines[begin] = excels[1], ""
    lines[: layout.skip_rows] = [""] * min(layout.skip_rows, len(lines))
    if not any(lines):
        raise ValueError("it holds no data")
    sep = sep or separator(lines, layout)
    lines = _joined(lines, sep)
    head = find_head(lines, written, sep, layout)
    lines[: head.first - 1] = [""] * (head.first - 1)
    body = [i for i, line in enumerate(lines, 1) if line]
    first = Row.of(body[0], lines[body[0] - 1], sep).cells if body else ()
    names: list[Any] = [*range(len(first))]
    if head.names is not None:  # pandas would number names that stand twice
        check_different([name for name in head.names if name])
        more = ("",) * (len(first) - len(head.names))
        names = [name or f"Unnamed: {i}" for i, name in enumerate((*head.names, *more))]
    elif len(body) == 1:  # a single row of numbers is read as a column
        cells = first if first[-1] else first[:-1]
        lines, body, names = [f'"{cell or "nan"}"' for cell in cells], body * len(cells), [0]
    frame = _with_decimal("\n".join(lines), sep, names)
    if len(frame) == len(body):
        frame.index = pd.Index(body, name="line")
    filled = np.flatnonzero(frame.notna().any(axis=1))  # spreadsheets may end with empty rows
    return frame.iloc[: filled[-1] + 1 if filled.size else 0]


def _with_decimal(text: str, sep: str, names: list[Any]) -> pd.DataFrame:
    """Parse rows of cells, with the decimal sign that they show."""
    parsed = partial(_parsed, text, sep, names)
    if ('"' if sep == "," else ",") not in text and sep not in ";\t":
        return parsed()  # no cell can hold a comma
    cells_as_text = parsed(dtype=str)
    decimal = _decimal(cells_as_text, sep)
    frame = parsed(decimal=decimal)
    for name in frame.columns:
        if is_string_dtype(frame[name]) or is_object_dtype(frame[name]):
            frame[name] = _without_separators(cells_as_text[name], decimal)
    return frame


def _parsed(text: str, sep: str, names: list[Any], **options: Any) -> pd.DataFrame:
    file, between = io.StringIO(text), r"\s+" if sep == " " else sep
    try:
        return pd.read_csv(
            file, sep=between, header=None, names=names, index_col=False, skipinitialspace=True,
            na_values=["NAN"], **options,
        )  # fmt: skip
    except pd.errors.ParserError as error:
        if not (ragged := _RAGGED.search(str(error))):
            raise
        expected, line, found = ragged.groups()
        raise ValueError(
            f"line {line} holds {found} cells instead of {expected}: a cell with a separator in it "
            "needs quotes, lines above the names may be left out by skip_rows (--skip-rows)"
        ) from None


def check_different(names: Sequence[str]) -> None:
    """Raise ValueError where two columns have the same name."""
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(
            f"columns must have different names: {twice!r} stands {names.count(twice)} times"
        )


def _decoded(raw: bytes) -> str:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return raw.decode("utf-16")
    if b"\0" in raw:
        raise ValueError("it is a binary file; save a spreadsheet as CSV")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def _without_comments(lines: Sequence[str], mark_inside: bool) -> list[str]:
    """Blank out lines that begin with # or "% ", with `mark_inside` also what follows a " #".

    Blank lines stay, so that the line numbers in pandas' messages are those of the file.
    """
    whole = re.compile(rf"^\s*(?:#(?!{_ERRORS_OF_CELLS}|[,;])|%(?:\s|$)).*")
    inside = re.compile(rf'^([^"#]*\s)#(?!{_ERRORS_OF_CELLS}).*')
    kept = []
    for line in lines:
        if "#" in line or "%" in line:
            line = whole.sub("", line)  # noqa: PLW2901
            line = inside.sub(r"\1", line) if mark_inside else line  # noqa: PLW2901
        kept.append(line if line.strip(" ") else "")
    return kept


def _joined(lines: list[str], sep: str) -> list[str]:
    """Put a row whose quoted cells have line breaks on one line, and leave the others empty."""
    if not any(line.count('"') % 2 for line in lines):
        return lines
    joined = [""] * len(lines)
    rows = csv.reader((f"{line}\n" for line in lines), delimiter=sep, strict=True)
    begin = 0
    try:
        for _ in rows:
            joined[begin] = " ".join(lines[begin : rows.line_num])
            begin = rows.line_num
    except csv.Error as error:
        raise ValueError(f"line {begin + 1} has a quote that is not closed: {error}") from None
    return joined


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
        matches = {sign: column.str.fullmatch(number_pattern(sign), na=False) for sign in SIGNS}
        either = matches["."] | matches[","]
        if not 2 * int(either.sum()) > int(column.notna().sum()):
            continue  # a text column: its numbers may be written differently
        for sign, other in SIGNS.items():
            only = matches[sign] & ~matches[other]
            if only.any():
                found.setdefault(sign, _cell(name, column, only))
        both = matches["."] & matches[","]
        for sign in SIGNS:
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
    is_number = column.str.fullmatch(number_pattern(decimal), na=False)
    plain = column.str.replace(SIGNS[decimal], "", regex=False)
    plain = column.where(~is_number, plain.str.replace(decimal, ".", regex=False))
    values = pd.to_numeric(plain, errors="coerce")
    return plain if (values.isna() & plain.notna()).any() else values
