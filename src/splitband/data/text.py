"""Read tables from text: find the separator, the names, the first row of numbers, the decimal sign.

pandas parses the rows; what it has to be told is found here. Numbers begin with the first row
without a word in any column of numbers. The names stand above it: in the line that has a word for
all of these columns, and of several in the one that names the time. What lies between are units,
what lies above is left out. Where this leaves a choice, the file is refused, with the lines and
what to do.
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

from splitband.data.signals import decimal_sign, is_text, number_pattern, plain_numbers, unit_of
from splitband.data.stamps import is_time, time_name
from splitband.runtime.errors import InputError, one_line

_SEPARATORS = (";", "\t", ",", "|", " ")
_SAMPLE = 400
"""Rows at the beginning of a file that decide its layout. Bounds the time."""
_STAMP = re.compile(
    r"(?:(?:[a-z]{2,3}\.?|\w+day),?\s+)?"
    r"(?:\d{1,4}([-/.])\d{1,2}\1\d{1,4}|\d{1,2}[-. /][a-z]{3,9}[-. /]\d{2,4}|\d+:\d\d|\d+ days? \d)"
    r"[\d:.,TZ+\s/-]*(?:[ap]\.?m\.?|[a-z]{3,4})?[\d:+-]*",
    re.IGNORECASE,
)
_TIME_AND_NUMBER = re.compile(r":\d\d(?:[.,]\d+)?\s+(?:\d+|-\d{1,3})$")
"""A time and the whole part of a number with a decimal comma, 10:00:00 0 of 10:00:00 0,5."""
_MISSING = {"", "na", "n/a", "#n/a", "#na", "null", "none", "<na>"}
"""Cells that pandas, too, reads as missing values."""
_BRACKETS = re.compile(r"\(.*\)|\[.*\]")
_COMMENT = re.compile(r"\s*[#%]\s*")
_ERRORS_OF_CELLS = r"N/A|DIV/0!|REF!|VALUE!|NAME\?|NUM!|NULL!"
"""Error values of spreadsheets after a "#", which then does not begin a comment."""
_EXCELS_SEPARATOR = re.compile(r"sep=(.)\s*", re.IGNORECASE)
_RAGGED = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
_TABLE: Any = {"header": None, "index_col": False, "skipinitialspace": True, "na_values": ["NAN"]}
"""Options of pandas for rows of cells alone."""


@dataclass(frozen=True)
class Layout:
    """Hold what a user says of the layout of a file.

    Attributes
    ----------
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
        raise InputError("it holds no data")
    sep = sep or _separator(lines, layout)
    lines = _joined(lines, sep)
    head, begin = _head(lines, written, sep, layout)
    lines[: begin - 1] = [""] * (begin - 1)
    body = [i for i, line in enumerate(lines, 1) if line]
    first = _Row.of(body[0], lines[body[0] - 1], sep).cells if body else ()
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
        first = [_Row.of(i, lines[i - 1], sep).cells for i in body[:_SAMPLE]]
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
            f"columns must have different names: {twice!r} stands {names.count(twice)} times"
        )


# ---------------------------------------------------------------- lines and rows


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


@dataclass(frozen=True)
class _Row:
    """Hold the cells of a line of the file, without blanks around them."""

    line: int
    cells: tuple[str, ...]
    quoted: bool = False

    @staticmethod
    def of(line: int, text: str, sep: str) -> _Row:
        """Split a line at a separator; " " stands for any blanks."""
        text = " ".join(text.split()) if sep == " " else text
        try:
            cells = next(csv.reader([text], delimiter=sep, skipinitialspace=True))
        except csv.Error as error:
            raise InputError(f"line {line} cannot be split into cells: {error}") from None
        return _Row(line, tuple(cell.strip() for cell in cells), text.lstrip().startswith('"'))

    def at(self, columns: Sequence[int]) -> list[str]:
        """Return the cells of some columns; empty beyond the end of the row."""
        return [self.cells[i] if i < len(self.cells) else "" for i in columns]

    @property
    def width(self) -> int:
        """Return the number of cells up to the last one that is not empty."""
        return max((i for i, cell in enumerate(self.cells, 1) if cell), default=0)

    @property
    def timed(self) -> bool:
        """Return whether a cell is the name of time stamps."""
        return any(map(is_time, self.cells))


_VALUES = (
    *(re.compile(number_pattern(decimal)) for decimal in ".,"),
    re.compile(r"[-+]?(?:inf|infinity|nan)", re.IGNORECASE),
    _STAMP,
)


def _is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a date."""
    if _TIME_AND_NUMBER.search(cell):
        return False
    return any(pattern.fullmatch(cell) for pattern in _VALUES)


def _separator(lines: Sequence[str], layout: Layout) -> str:
    """Return what separates the columns, so that most cells are numbers or dates; " ": blanks."""
    lines = lines[layout.header_row or 0 :]
    sample = [*islice((line for line in lines if line.strip(" \t;,|")), _SAMPLE)]
    shares, no_values = {}, layout.no_values
    blanks_within = False  # words and dates
    for sep in _SEPARATORS:
        rows = _last([_Row.of(0, line, sep) for line in sample])
        cells = [c for row in rows for c in row.cells if c.lower() not in no_values]
        several = 2 * sum(len(row.cells) > 1 for row in rows) > len(rows)
        values = [cell for cell in cells if _is_value(cell) and not cell.endswith(",")]
        shares[sep] = len(values) / len(cells) if several and cells else -1.0
        torn = any(sum(map(_is_value, c.split())) > 1 for c in cells if not _is_value(c))
        if sep in ";\t|" and several and len({len(row.cells) for row in rows}) == 1:
            blanks_within |= not torn
    if blanks_within:
        del shares[" "]
    best = max(shares, key=shares.__getitem__)  # the first of equals
    return best if shares[best] >= 0 else ","


def _last(rows: Sequence[_Row]) -> Sequence[_Row]:
    """Return the last rows with content of the sample, which hold numbers if any do."""
    rows = [row for row in rows if row.width]
    return rows[-max(2, len(rows) // 4) :]


# ---------------------------------------------------------------- names and numbers


class _Columns:
    """Tell words from values in the columns of numbers, which the last rows of the sample show."""

    def __init__(self, rows: Sequence[_Row], no_values: set[str]) -> None:
        self._no_values = no_values
        last = _last(rows)
        self.numbers = []
        for i in range(max((len(row.cells) for row in last), default=0)):
            cells = [row.cells[i] for row in last if i < len(row.cells)]
            known = [cell for cell in cells if cell.lower() not in no_values]
            if len(last) < 2 * len(cells) and len(known) < 2 * sum(map(_is_value, known)):
                self.numbers.append(i)

    def words(self, row: _Row) -> list[str]:
        known = [cell for cell in row.at(self.numbers) if cell.lower() not in self._no_values]
        return [cell for cell in known if not _is_value(cell)]

    def values(self, row: _Row) -> list[str]:
        return [cell for cell in row.at(self.numbers) if _is_value(cell)]

    def begin(self, row: _Row) -> bool:
        """Return whether the row may be the first one of numbers."""
        return not self.words(row) and any(row.at(self.numbers))

    def mixed(self, row: _Row) -> bool:
        """Return whether the row has values among words; 1, 2, 3 may be names."""
        return _is_value(row.at(self.numbers)[0]) or not all(map(str.isdigit, self.values(row)))

    def full(self, row: _Row) -> bool:
        """Return whether the row has a name for each column of numbers; the first may have none."""
        return bool(self.words(row)) and all(row.at([i for i in self.numbers if i]))

    def check_unlike(self, rows: Sequence[_Row], below: _Row) -> None:
        """Raise ValueError for a row that has the stamp of a row of numbers, 'Jan 5 10:00'."""
        texts = [i for i in range(len(below.cells)) if i not in self.numbers]
        for row in rows:
            pairs = zip(row.at(texts), below.at(texts), strict=True)
            if any(cell != _alike(cell) == _alike(other) for cell, other in pairs):
                word = self.words(row)[0]
                raise InputError(
                    f"line {row.line} holds {word!r} where line {below.line} has a number: "
                    + _remedy(word, row)
                )

    def check(self, rows: Sequence[_Row]) -> None:
        """Raise ValueError for a row with numbers and words, which is nobody's header."""
        for row in rows:
            values = self.values(row)
            no_units = {*values} == {"1"} and not _is_value(row.at(self.numbers)[0])
            if values and not no_units:
                word = next(iter(self.words(row)), "")
                raise InputError(
                    f"line {row.line} holds {values[0]!r} and {word!r}, neither names nor a row of "
                    f"numbers: {_remedy(word, row)}"
                )


def _remedy(word: str, row: _Row) -> str:
    return (
        f"missing={word!r} (--missing) if it stands for a missing value, skip_rows={row.line} "
        "(--skip-rows) with header_row=N (--header-row) leaves the line out"
    )


def _alike(cell: str) -> str:
    """Return what cells have in common that differ by their digits."""
    return re.sub(r"[-+]?\d+(?:\.\d+)?", "#", cell)


def _head(
    lines: Sequence[str], raw: Sequence[str], sep: str, layout: Layout
) -> tuple[tuple[str, ...] | None, int]:
    """Return the names of the columns, None without any, and the line of the first row of numbers.

    `lines` are those of `raw` with comments blanked out.
    """
    begin = layout.header_row or 0
    filled = ((i, line) for i, line in enumerate(lines[begin:], begin + 1) if line)
    rows = [_Row.of(i, line, sep) for i, line in islice(filled, _SAMPLE)]
    above = None
    if begin > len(raw):
        raise InputError(f"header_row is {begin}, but there are {len(raw)} lines")
    if layout.header_row == 0:
        return None, rows[0].line
    if begin:
        above = _Row.of(begin, _COMMENT.sub("", raw[begin - 1], count=1), sep)
    columns = _Columns(rows, layout.no_values)
    if not columns.numbers:  # words alone, below the names
        names = rows.pop(0) if above is None else above
        return names.cells, rows[0].line if rows else len(lines) + 1
    count = next((i for i, row in enumerate(rows) if columns.begin(row)), len(rows))
    if count == len(rows):
        columns.check(rows)
        raise InputError(f"none of the lines up to {rows[-1].line} holds numbers without words")
    rows, body = [row for row in rows[:count] if row.width], rows[count:]
    below = body[0]
    columns.check_unlike(rows if above else rows[1:], below)
    if above is not None:
        columns.check(rows)
        if above.width < below.width:
            raise InputError(
                f"header_row={above.line} (--header-row) must hold a name for each column: it has "
                f"{above.width}, line {below.line} has {below.width} cells; header_row=0 with "
                f"skip_rows={below.line - 1} (--skip-rows) reads without names"
            )
        return _named(above, rows, below, columns), below.line
    if rows:
        return _chosen(rows, body, columns), below.line
    found = _in_comments(raw, below, sep, columns)
    if found is None and _begins_with_numbered_names(body):
        return below.cells, below.line + 1
    return found, below.line


def _chosen(above: Sequence[_Row], body: Sequence[_Row], columns: _Columns) -> tuple[str, ...]:
    """Return the names that stand in one of the rows above those of the numbers."""
    below = body[0]
    dated = _STAMP.fullmatch(below.cells[0]) and above[-1].timed
    if below.quoted and above[-1].width == below.width - 1 and not dated:  # names of rows, of R
        above = [_Row(row.line, ("", *row.cells)) for row in above]
    mixed = [i for i, row in enumerate(above) if columns.mixed(row)]
    block = above[mixed[-1] + 1 :] if mixed else above
    columns.check(above[-1:] if not block else [])
    full = [row for row in block if columns.full(row)]
    full = full or [row for row in block if row.width == below.width and len(block) == 1]
    cells = max(len(row.cells) for row in body)
    if all(row.width > cells for row in full):
        line, width = block[-1].line, block[-1].width
        commas = "; decimal commas need ; or tabs between columns, or points in their place"
        raise InputError(
            f"line {line} holds {width} name{'s'[: width > 1]}, line {below.line} {below.width} "
            f"cells: skip_rows={line} (--skip-rows) leaves it out, header_row=N (--header-row) "
            f"says which line holds the names{commas if below.width == 2 * width else ''}"
        )
    found = [row for row in full if row.timed] or full
    if len(found) > 1:
        raise InputError(
            f"lines {' and '.join(str(row.line) for row in found)} may all hold the names of the "
            f"columns: header_row={found[0].line} (--header-row) says which"
        )
    names = found[0]
    if unit := next(filter(_BRACKETS.fullmatch, names.cells), ""):
        raise InputError(
            f"line {names.line} holds {unit!r} where a name is due: names with blanks need "
            f"quotes, skip_rows={names.line} (--skip-rows) leaves them out"
        )
    at = block.index(names)
    columns.check(block[at + 1 :])
    units = block[at + 1 :] or [row for row in block[:at] if _has_unit_of_time(row, names)]
    if len(units) > 2:
        raise InputError(
            f"lines {names.line} to {units[-1].line} hold names: header_row={names.line} "
            "(--header-row) says which line holds those of the columns"
        )
    return _named(names, units, below, columns)


def _in_comments(
    raw: Sequence[str], below: _Row, sep: str, columns: _Columns
) -> tuple[str, ...] | None:
    """Return the names in a comment above the numbers, as NumPy writes "# time,x"."""
    above = enumerate(raw[: below.line - 1], 1)
    rows = [
        _Row.of(i, line[mark.end() :], sep) for i, line in above if (mark := _COMMENT.match(line))
    ]
    rows = [row for row in rows if len(row.cells) == len(below.cells) > 1]
    rows = [row for row in rows if columns.full(row) and not columns.values(row)]
    timed = [row for row in rows if row.timed]
    plain = [row for row in rows if not any(" " in c and not unit_of(c) for c in row.cells)]
    if len(timed) == 1 or (len(plain) == 1 and sep != " "):  # blanks also separate words
        names = timed[0] if len(timed) == 1 else plain[0]
        return _named(names, rows[rows.index(names) + 1 :], below, columns)
    if len(rows) == 1 and sep != " ":
        line = rows[0].line
        raise InputError(
            f"line {line} is a comment, {', '.join(rows[0].cells)}, and may hold the names of the "
            f"columns: header_row={line} (--header-row) makes it names, header_row=0 a comment"
        )
    return None


def _begins_with_numbered_names(body: Sequence[_Row]) -> bool:
    """Return whether the first row has the names 0, 1, ... of a DataFrame, after its index."""
    (first, *names), *rows = (row.cells for row in body)
    counted = [str(i) for i in range(len(names) + len(rows) + 1)]
    numbered = not first or [first, *names] == counted[: len(names) + 1]
    if not numbered or not all(map(str.isdigit, names)):
        return False
    index = [row[0] for row in rows]
    if not first and (names == counted[: len(names)] or index == counted[: len(rows)]):
        return True
    later = [cell for row in rows for cell in row[first == "" :]]
    if later and not any(map(str.isdigit, later)):
        line = body[0].line
        raise InputError(
            f"line {line} may hold names or numbers: header_row={line} (--header-row) makes them "
            "names, header_row=0 numbers"
        )
    return False


def _has_unit_of_time(row: _Row, names: _Row) -> bool:
    """Return whether a row has a unit for a column of time stamps."""
    pairs = zip(names.cells, row.cells, strict=False)
    units = [unit.strip("[]()") for name, unit in pairs if is_time(name)]
    return any(time_name(f"t [{unit}]")[1] for unit in units)


def _named(names: _Row, units: Sequence[_Row], below: _Row, columns: _Columns) -> tuple[str, ...]:
    """Return names with the units of the line below them, such as "x [mm]"."""
    found = list(names.cells)
    if not units or not (units[0].width > 1 or _has_unit_of_time(units[0], names)):
        return names.cells
    for i in columns.numbers:
        (written,), (cell,), (name,) = units[0].at([i]), below.at([i]), names.at([i])
        unit = written.strip("[]() -")
        if name and unit and not _STAMP.fullmatch(cell):
            named = unit_of(name) or name.endswith((f"{unit})", f"{unit}]"))
            found[i] = name if named else f"{name} [{unit}]"
    return tuple(found)


# ---------------------------------------------------------------- numbers


def _with_decimal(text: str, sep: str, names: list[Any]) -> pd.DataFrame:
    """Parse rows of cells, with the decimal sign that they show."""
    if ('"' if sep == "," else ",") not in text and sep not in ";\t":
        return _parsed(text, sep, names)  # no cell can hold a comma
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
