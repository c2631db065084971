"""Find where the names of a text file's columns stand, and where its numbers begin."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

from splitband.data.names import unit_of
from splitband.data.stamps import is_time, time_name

SIGNS = {".": ",", ",": "."}
"""Decimal signs, each with its thousands separator."""
_SEPARATORS = (";", "\t", ",", "|", " ")
_SAMPLE = 400
"""Rows at the beginning of a file that decide its layout. By eye."""
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
        for name in ("skip_rows", "header_row"):
            if (value := getattr(self, name)) is not None and value < 0:
                raise ValueError(f"{name} must be a number of lines, 0 or more: got {value}")

    def check_no_lines(self, kind: str) -> None:
        """Raise ValueError for lines of a file that has none."""
        if self.skip_rows or self.header_row is not None:
            raise ValueError(f"skip_rows and header_row are for text, this is {kind}")


@dataclass(frozen=True)
class Row:
    """Hold the cells of a line of the file, without blanks around them."""

    line: int
    cells: tuple[str, ...]
    quoted: bool = False

    @staticmethod
    def of(line: int, text: str, sep: str) -> Row:
        """Split a line at a separator; " " stands for any blanks."""
        text = " ".join(text.split()) if sep == " " else text
        cells = next(csv.reader([text], delimiter=sep, skipinitialspace=True))
        return Row(line, tuple(cell.strip() for cell in cells), text.lstrip().startswith('"'))

    def at(self, columns: Sequence[int]) -> list[str]:
        """Return the cells of some columns; empty beyond the end of the row."""
        return [self.cells[i] if i < len(self.cells) else "" for i in columns]

    @property
    def blanks(self) -> bool:
        """Return whether a cell without a unit has blanks in it."""
        return any(" " in cell and not unit_of(cell) for cell in self.cells)

    @property
    def width(self) -> int:
        """Return the number of cells up to the last one that is not empty."""
        return max((i for i, cell in enumerate(self.cells, 1) if cell), default=0)


@dataclass(frozen=True)
class Head:
    """Hold the names of the columns, and the line of the first row of numbers."""

    names: tuple[str, ...] | None
    first: int


def number_pattern(decimal: str) -> str:
    """Return the pattern of a number with this decimal sign, thousands separators included."""
    sign, thousands = re.escape(decimal), re.escape(SIGNS[decimal])
    return (
        rf"\s*[-+]?(?:(?:\d+{sign}?\d*|{sign}\d+)(?:[eE][-+]?\d+)?"
        rf"|[1-9]\d{{0,2}}(?:{thousands}\d{{3}})+(?:{sign}\d*)?)\s*"
    )


_NUMBERS = tuple(re.compile(number_pattern(decimal)) for decimal in SIGNS)


def _is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a date."""
    if _TIME_AND_NUMBER.search(cell):
        return False
    try:
        float(cell)
    except ValueError:
        patterns = (*_NUMBERS, _STAMP)
        return any(pattern.fullmatch(cell) for pattern in patterns)
    return True


def separator(lines: Sequence[str], layout: Layout) -> str:
    """Return what separates the columns: the sign between which most cells are numbers or dates.

    " " stands for any blanks.
    """
    lines = lines[layout.header_row or 0 :]
    sample = [*islice((line for line in lines if line.strip(" \t;,|")), _SAMPLE)]
    shares = {}
    for sep in _SEPARATORS:
        rows = _last([Row.of(0, line, sep) for line in sample])
        cells = [c for row in rows for c in row.cells if c.lower() not in _missing(layout)]
        several = 2 * sum(len(row.cells) > 1 for row in rows) > len(rows)
        shares[sep] = sum(map(_is_value, cells)) / len(cells) if several and cells else -1.0
    best = max(_SEPARATORS, key=shares.__getitem__)  # the first of equals
    return best if shares[best] >= 0 else ","


def _alike(cell: str) -> str:
    """Return what cells have in common that differ by their digits."""
    return re.sub(r"[-+]?\d+(?:\.\d+)?", "#", cell)


def _missing(layout: Layout) -> set[str]:
    return _MISSING | {word.lower() for word in layout.missing}


def _last(rows: Sequence[Row]) -> Sequence[Row]:
    """Return the last rows with content of the sample, which hold numbers if any do."""
    rows = [row for row in rows if row.width]
    return rows[-max(2, len(rows) // 4) :]


class _Columns:
    """Tell words from values in the columns of numbers, which the last rows of the sample show."""

    def __init__(self, rows: Sequence[Row], layout: Layout) -> None:
        self._missing = _missing(layout)
        last = _last(rows)
        self.numbers = []
        for i in range(max((len(row.cells) for row in last), default=0)):
            cells = [row.cells[i] for row in last if i < len(row.cells)]
            known = [cell for cell in cells if cell.lower() not in self._missing]
            if len(last) < 2 * len(cells) and len(known) < 2 * sum(map(_is_value, known)):
                self.numbers.append(i)

    def words(self, row: Row) -> list[str]:
        known = [cell for cell in row.at(self.numbers) if cell.lower() not in self._missing]
        return [cell for cell in known if not _is_value(cell)]

    def values(self, row: Row) -> list[str]:
        return [cell for cell in row.at(self.numbers) if _is_value(cell)]

    def begin(self, row: Row) -> bool:
        """Return whether the row may be the first one of numbers."""
        return not self.words(row) and any(row.at(self.numbers))

    def mixed(self, row: Row) -> bool:
        """Return whether the row has values among words; 1, 2, 3 may be names."""
        first, values = row.at(self.numbers)[0], self.values(row)
        return _is_value(first) or not all(map(str.isdigit, values))

    def full(self, row: Row) -> bool:
        """Return whether the row has a name for each column of numbers; the first may have none."""
        return bool(self.words(row)) and all(row.at([i for i in self.numbers if i]))

    def check_unlike(self, rows: Sequence[Row], below: Row) -> None:
        """Raise ValueError for a row that has the stamp of a row of numbers, 'Jan 5 10:00'."""
        texts = [i for i in range(len(below.cells)) if i not in self.numbers]
        for row in rows:
            pairs = zip(row.at(texts), below.at(texts), strict=True)
            if any(cell != _alike(cell) == _alike(other) for cell, other in pairs):
                word = self.words(row)[0]
                raise ValueError(
                    f"line {row.line} holds {word!r} where line {below.line} has a number: "
                    f"missing={word!r} (--missing) if it stands for a missing value, "
                    f"skip_rows={row.line} (--skip-rows) with header_row=N (--header-row) leaves "
                    "it out"
                )

    def check(self, rows: Sequence[Row]) -> None:
        """Raise ValueError for a row with numbers and words, which is nobody's header."""
        for row in rows:
            values = self.values(row)
            no_units = {*values} == {"1"} and not _is_value(row.at(self.numbers)[0])
            if values and not no_units:
                word = next(iter(self.words(row)), "")
                raise ValueError(
                    f"line {row.line} holds {values[0]!r} and {word!r}, neither names nor a row of "
                    f"numbers: missing={word!r} (--missing) if the word stands for a missing "
                    f"value, skip_rows={row.line} (--skip-rows) with header_row=N (--header-row) "
                    "for lines above the numbers"
                )


def find_head(lines: Sequence[str], raw: Sequence[str], sep: str, layout: Layout) -> Head:
    """Return where the table begins; `lines` are those of `raw` with comments blanked out.

    Numbers begin with the first row without a word in any column of numbers. The names stand above
    it: in the line that has a word for all of these columns, and of several in the one that names
    the time. What lies between are units, what lies above is left out.

    Raises ValueError, with the lines and what to do, where this leaves a choice.
    """
    begin = layout.header_row or 0
    filled = ((i, line) for i, line in enumerate(lines[begin:], begin + 1) if line)
    rows = [Row.of(i, line, sep) for i, line in islice(filled, _SAMPLE)]
    if layout.header_row == 0:
        return Head(None, rows[0].line)
    above = None
    if layout.header_row is not None:
        above = Row.of(layout.header_row, _line(raw, layout.header_row), sep)
    columns = _Columns(rows, layout)
    if not columns.numbers:  # words alone, below the names
        names = rows.pop(0) if above is None else above
        return Head(names.cells, rows[0].line if rows else len(lines) + 1)
    count = next((i for i, row in enumerate(rows) if columns.begin(row)), len(rows))
    if count == len(rows):
        columns.check(rows)
        raise ValueError(f"none of the lines up to {rows[-1].line} holds numbers without words")
    rows, body = [row for row in rows[:count] if row.width], rows[count:]
    below = body[0]
    columns.check_unlike(rows if above else rows[1:], below)
    if above is not None:
        columns.check(rows)
        if above.width < below.width:
            raise ValueError(
                f"header_row={above.line} (--header-row) must hold a name for each column: it has "
                f"{above.width}, line {below.line} has {below.width} cells; header_row=0 with "
                f"skip_rows={below.line - 1} (--skip-rows) reads without names"
            )
        return Head(_named(above, rows, below, columns), below.line)
    if rows:
        return _chosen(rows, body, columns)
    if _is_of_pandas(body):
        return Head(below.cells, below.line + 1)
    found = _in_comments(raw, below, sep, columns)
    if found is None:
        _check_no_numbers_for_names(body)
    return Head(found, below.line)


def _line(raw: Sequence[str], number: int) -> str:
    """Return a line without the mark of a comment before it."""
    if number > len(raw):
        raise ValueError(f"header_row is {number}, but there are {len(raw)} lines")
    return _COMMENT.sub("", raw[number - 1], count=1)


def _in_comments(
    raw: Sequence[str], below: Row, sep: str, columns: _Columns
) -> tuple[str, ...] | None:
    """Return the names in a comment above the numbers, as NumPy writes "# time,x"."""
    above = enumerate(raw[: below.line - 1], 1)
    found = [(i, line, mark) for i, line in above if (mark := _COMMENT.match(line))]
    rows = [Row.of(i, line[mark.end() :], sep) for i, line, mark in found]
    rows = [row for row in rows if len(row.cells) == len(below.cells) > 1]
    rows = [row for row in rows if columns.full(row) and not columns.values(row)]
    timed = [row for row in rows if any(map(is_time, row.cells))]
    plain = [row for row in rows if not row.blanks]
    if len(timed) == 1 or (len(plain) == 1 and sep != " "):  # blanks also separate words
        names = timed[0] if len(timed) == 1 else plain[0]
        return _named(names, rows[rows.index(names) + 1 :], below, columns)
    if len(rows) == 1 and sep != " ":
        line = rows[0].line
        raise ValueError(
            f"line {line} is a comment, {', '.join(rows[0].cells)}, and may hold the names of the "
            f"columns: header_row={line} (--header-row) makes it names, header_row=0 a comment"
        )
    return None


def _is_of_pandas(body: Sequence[Row]) -> bool:
    """Return whether the first row has the names of a DataFrame without names, after its index."""
    first, *names = body[0].cells
    index = [row.cells[0] for row in body[1:]]
    if first or not all(map(str.isdigit, names)):
        return False
    counted = index == [str(i) for i in range(len(index))]
    return counted or names == [str(i) for i in range(len(names))]


def _check_no_numbers_for_names(body: Sequence[Row]) -> None:
    """Raise ValueError where the first row may be a DataFrame's names 0, 1, 2 or ..."""
    first, *others = body[0].cells
    counted = [first, *others] == [str(i) for i in range(len(others) + 1)]
    later = [cell for row in body[1:] for cell in row.cells[first == "" :]]
    names = all(map(str.isdigit, others)) and (counted or first == "")
    if names and later and not any(map(str.isdigit, later)):
        line = body[0].line
        raise ValueError(
            f"line {line} may hold names or numbers: header_row={line} (--header-row) makes them "
            "names, header_row=0 numbers"
        )


def _chosen(above: Sequence[Row], body: Sequence[Row], columns: _Columns) -> Head:
    """Return the head whose names stand in one of the rows above those of the numbers."""
    below = body[0]
    dated = _STAMP.fullmatch(below.cells[0]) and any(map(is_time, above[-1].cells))
    if below.quoted and above[-1].width == below.width - 1 and not dated:  # names of rows, of R
        above = [Row(row.line, ("", *row.cells)) for row in above]
    mixed = [i for i, row in enumerate(above) if columns.mixed(row)]
    block = above[mixed[-1] + 1 :] if mixed else above
    columns.check(above[-1:] if not block else [])
    full = [row for row in block if columns.full(row)]
    full = full or [row for row in block if row.width == below.width and len(block) == 1]
    cells = max(len(row.cells) for row in body)
    if all(row.width > cells for row in full):
        line, width = block[-1].line, block[-1].width
        commas = "; decimal commas need ; or tabs between columns, or points in their place"
        raise ValueError(
            f"line {line} holds {width} name{'s'[: width > 1]}, line {below.line} {below.width} "
            f"cells: skip_rows={line} (--skip-rows) leaves it out, header_row=N (--header-row) "
            f"says which line holds the names{commas if below.width == 2 * width else ''}"
        )
    timed = [row for row in full if any(map(is_time, row.cells))]
    found = timed or full
    if len(found) > 1:
        raise ValueError(
            f"lines {' and '.join(str(row.line) for row in found)} may all hold the names of the "
            f"columns: header_row={found[0].line} (--header-row) says which"
        )
    if unit := next(filter(_BRACKETS.fullmatch, found[0].cells), ""):
        raise ValueError(
            f"line {found[0].line} holds {unit!r} where a name is due: names with blanks need "
            f"quotes, skip_rows={found[0].line} (--skip-rows) leaves them out"
        )
    at = block.index(found[0])
    units = block[at + 1 :]
    columns.check(units)
    units = units or [row for row in block[:at] if _has_unit_of_time(row, found[0])]
    if len(units) > 2:
        raise ValueError(
            f"lines {found[0].line} to {units[-1].line} hold names: header_row={found[0].line} "
            "(--header-row) says which line holds those of the columns"
        )
    return Head(_named(found[0], units, below, columns), below.line)


def _has_unit_of_time(row: Row, names: Row) -> bool:
    """Return whether a row has a unit for a column of time stamps."""
    pairs = zip(names.cells, row.cells, strict=False)
    units = [unit.strip("[]()") for name, unit in pairs if is_time(name)]
    return any(time_name(f"t [{unit}]")[1] for unit in units)


def _named(names: Row, units: Sequence[Row], below: Row, columns: _Columns) -> tuple[str, ...]:
    """Return names with the units of the line below them, such as "x [mm]"."""
    found = list(names.cells)
    several = bool(units) and (units[0].width > 1 or _has_unit_of_time(units[0], names))
    if several:
        for i, written, cell in zip(
            columns.numbers, units[0].at(columns.numbers), below.at(columns.numbers), strict=True
        ):
            unit = written.strip("[]() -") if i < len(found) and found[i] else ""
            if unit and not _STAMP.fullmatch(cell):
                named = unit_of(found[i]) or found[i].endswith((f"{unit})", f"{unit}]"))
                found[i] += "" if named else f" [{unit}]"
    return tuple(found)
