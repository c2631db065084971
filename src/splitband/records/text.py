"""Read tables from text: find the separator, the names, the first row of numbers, the decimal sign.

pandas parses the rows; what it has to be told is found here, and the names in `header`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import pandas as pd

from splitband.records.header import SAMPLE, Row, find_header, is_value, last
from splitband.records.signals import decimal_sign, is_text, plain_numbers
from splitband.runtime.errors import InputError, one_line

_SEPARATORS = (";", "\t", ",", "|", " ")
_MISSING = {"", "na", "n/a", "#n/a", "#na", "null", "none", "<na>"}
"""Cells that pandas, too, reads as missing values."""
_ERRORS_OF_CELLS = r"N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!"
"""Error values of spreadsheets after a "#", which then does not begin a comment."""
_EXCELS_SEPARATOR = re.compile(r"sep=(.)\s*", re.IGNORECASE)
_LABVIEWS_END = "***End_of_Header***"
_RAGGED = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
_TABLE: Any = {"header": None, "index_col": False, "skipinitialspace": True, "na_values": ["NAN"]}
if pd.__version__ < "3.1":  # newer ones read every digit, and warn of the option
    _TABLE["float_precision"] = "round_trip"
"""Options of pandas for rows of cells alone."""


@dataclass(frozen=True)
class Layout:
    """Hold what a user says of the layout of a file.

    skip_rows : Lines at the top of the file that are left out.
    header_row : Line of the names, from 1; 0 for a file without names; None if it is to be found.
    missing : Words and numbers that stand for missing values.
    """

    skip_rows: int = 0
    header_row: int | None = None
    missing: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, value in (("skip_rows", self.skip_rows), ("header_row", self.header_row)):
            if value is not None and value < 0:
                raise InputError(f"{name} must be a number of lines, 0 or more: got {value}")

    def check_no_lines(self, kind: str) -> None:
        """Raise ValueError for lines of a file that has none."""
        if self.skip_rows or self.header_row is not None:
            raise InputError(f"skip_rows and header_row are for text, this is {kind}")

    @property
    def no_values(self) -> set[str]:
        """Return the cells without a value, in small letters."""
        return _MISSING | {word.lower() for word in self.missing}


def read_table(raw: bytes, suffix: str, layout: Layout) -> pd.DataFrame:
    """Read the columns of a text file, with or without a header; the index holds its lines.

    Numbers have a decimal point or a decimal comma, the same in the whole file, and may have
    thousands separators.
    """
    written = re.split("\r\n?|\n", _decoded(raw))
    lines = _without_comments(written, mark_inside=suffix not in (".csv", ".tsv"))
    begin = next((i for i, line in enumerate(lines) if line), 0)
    sep = "\t" if suffix == ".tsv" else ""
    if excels := _EXCELS_SEPARATOR.fullmatch(lines[begin]):
        sep, lines[begin] = excels[1], ""
    skipped = max(layout.skip_rows, _labviews_head(lines))
    lines[:skipped] = [""] * min(skipped, len(lines))
    if not any(lines):
        raise InputError("it holds no data")
    sep = sep or _separator(lines, layout)
    lines = _joined(lines, sep)
    head, begin = find_header(lines, written, sep, layout.header_row, layout.no_values)
    lines[: begin - 1] = [""] * (begin - 1)
    body = [i for i, line in enumerate(lines, 1) if line]
    first = Row.of(body[0], lines[body[0] - 1], sep).cells if body else ()
    names: list[Any] = [*range(len(first))]
    if head is not None:  # pandas would number names that stand twice
        check_different([name for name in head if name])
        more = ("",) * (len(first) - len(head))
        names = [name or f"Unnamed: {i}" for i, name in enumerate((*head, *more))]
    elif len(body) == 1:  # a single row of numbers is read as a column
        cells = first if first[-1] else first[:-1]
        lines, body, names = [f'"{cell or "nan"}"' for cell in cells], body * len(cells), [0]
    if len(names) == 1 and body:
        _check_empty(written, body)
    _check_rows(lines, body, sep, names, head is not None)
    frame = _with_decimal("\n".join(lines), sep, names)
    if len(frame) == len(body):
        frame.index = pd.Index(body, name="line")
    filled = np.flatnonzero(frame.notna().any(axis=1))  # spreadsheets may end with empty rows
    return frame.iloc[: filled[-1] + 1 if filled.size else 0]


def _labviews_head(lines: Sequence[str]) -> int:
    """Return how many lines the head of a LabVIEW file has, with that of its first part."""
    ends = [i for i, line in enumerate(lines, 1) if line.startswith(_LABVIEWS_END)]
    below = lines[ends[0] : ends[1]] if len(ends) > 1 else []
    samples = any(is_value(cell) for line in below for cell in line.split()[:1])
    return max(ends[: 1 if samples else 2], default=0)


def _check_empty(written: Sequence[str], body: Sequence[int]) -> None:
    """Raise ValueError for empty lines of a single column, unless every second one is empty."""
    empty = [i for i in range(body[0], body[-1]) if not written[i - 1].strip()]
    if empty and 2 * len(empty) < body[-1] - body[0]:
        raise InputError(
            f"line {empty[0]} is empty: write nan for a missing value, or remove the line"
        )


def _check_rows(
    lines: Sequence[str], body: Sequence[int], sep: str, names: Sequence[Any], named: bool
) -> None:
    """Raise ValueError for rows whose missing cells, or whose decimal commas, leave a choice."""
    if sep == " " and len(names) > 1:
        short = (i for i in body if len(lines[i - 1].split()) < len(names))
        if (line := next(short, None)) is not None and '"' not in lines[line - 1]:
            raise InputError(
                f"line {line} has {len(lines[line - 1].split())} cells instead of {len(names)}: "
                "between blanks nothing tells which is missing; write nan in its place"
            )
    if sep == "," and not named and len(names) % 2 == 0:
        first = [Row.of(i, lines[i - 1], sep).cells for i in body[:SAMPLE]]
        cells = [cell for row in first for cell in row]
        fractions = [cell for row in first for cell in row[1::2]]
        told = "-0" in cells or any(re.fullmatch(r"0\d+", cell) for cell in fractions)
        if told and all(map(str.isdigit, fractions)) and not any("." in cell for cell in cells):
            raise InputError(
                f"line {body[0]} may hold decimal commas, which between columns need ; or tabs, or "
                "whole numbers, which a line of names above them tells"
            )


def check_different(names: Sequence[str]) -> None:
    """Raise ValueError where two columns have the same name."""
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(
            f"columns must have different names: {twice!r} stands {names.count(twice)} times; "
            "rename all but one of them in the file"
        )


def _decoded(raw: bytes) -> str:
    wide = raw.startswith((b"\xff\xfe", b"\xfe\xff"))
    if b"\0" in raw and not wide:
        raise InputError("it is a binary file; save a spreadsheet as CSV")
    try:
        return raw.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError as error:
        if wide:
            raise InputError(f"cannot be read as text: {one_line(error)}") from None
        return raw.decode("latin-1")


def _without_comments(lines: Sequence[str], mark_inside: bool) -> list[str]:
    """Blank out lines that begin with # or "% ", with `mark_inside` also what follows a " #"."""
    whole = re.compile(rf"^\s*(?:#(?!{_ERRORS_OF_CELLS}|[,;])|%(?:\s|$)).*")
    inside = re.compile(rf'^([^"#]*\s)#(?!{_ERRORS_OF_CELLS}).*')
    kept = []
    for line in lines:
        if "#" in line or "%" in line:
            line = whole.sub("", line)  # noqa: PLW2901
            line = inside.sub(r"\1", line) if mark_inside else line  # noqa: PLW2901
        kept.append(line if line.strip(" ") else "")
    return kept  # blank lines stay, so that pandas' messages have the file's line numbers


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
        raise InputError(f"line {begin + 1} has a quote that is not closed: {error}") from None
    return joined


def _separator(lines: Sequence[str], layout: Layout) -> str:
    """Return what separates the columns, so that most cells are numbers or dates; " ": blanks."""
    lines = lines[layout.header_row or 0 :]
    sample = [*islice((line for line in lines if line.strip(" \t;,|")), SAMPLE)]
    shares, no_values = {}, layout.no_values
    blanks_within = False  # words and dates
    for sep in _SEPARATORS:
        rows = last([Row.of(0, line, sep) for line in sample])
        cells = [c for row in rows for c in row.cells if c.lower() not in no_values]
        several = 2 * sum(len(row.cells) > 1 for row in rows) > len(rows)
        values = [cell for cell in cells if is_value(cell) and not cell.endswith(",")]
        shares[sep] = len(values) / len(cells) if several and cells else -1.0
        torn = any(sum(map(is_value, c.split())) > 1 for c in cells if not is_value(c))
        if sep in ";\t|" and several and len({len(row.cells) for row in rows}) == 1:
            blanks_within |= not torn
    if blanks_within:
        del shares[" "]
    best = max(shares, key=shares.__getitem__)  # the first of equals
    return best if shares[best] >= 0 else ","


def _with_decimal(text: str, sep: str, names: list[Any]) -> pd.DataFrame:
    """Parse rows of cells, with the decimal sign that they show."""
    if ('"' if sep == "," else ",") not in text and sep not in ";\t":
        frame = _parsed(text, sep, names)  # no cell can hold a comma
        for name in frame.columns:
            if is_text(frame[name]) and is_value(str(next(iter(frame[name]), ""))):
                frame[name] = plain_numbers(frame[name], ".")
        return frame
    cells_as_text = _parsed(text, sep, names, dtype=str)
    decimal = decimal_sign(cells_as_text, sep)
    frame = _parsed(text, sep, names, decimal=decimal)
    for name in frame.columns:
        if is_text(frame[name]):
            frame[name] = plain_numbers(cells_as_text[name], decimal)
    return frame


def _parsed(text: str, sep: str, names: list[Any], **options: Any) -> pd.DataFrame:
    try:
        sep = r"\s+" if sep == " " else sep
        return pd.read_csv(io.StringIO(text), sep=sep, names=names, **_TABLE, **options)
    except pd.errors.ParserError as error:
        if not (ragged := _RAGGED.search(str(error))):
            raise InputError(f"cannot be read as text: {one_line(error)}") from None
        expected, line, found = ragged.groups()
        raise InputError(
            f"line {line} holds {found} cells instead of {expected}: a cell with a separator in it "
            "needs quotes, lines above the names may be left out by skip_rows (--skip-rows)"
        ) from None
