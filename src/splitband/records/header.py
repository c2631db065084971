"""Find the names of a text table's columns, and its first row of numbers.

Numbers begin with the first row without a word in any column of numbers; the names stand above it,
in the row that has a name for all of these columns and, of several, names the time, or alone has
a name for the first column. What lies between are units, what lies above is left out. Where this
leaves a choice, the file is refused, with the lines and what to do.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal

from splitband.records.signals import number_pattern, unit_of
from splitband.records.stamps import is_time, time_name
from splitband.runtime.errors import InputError

SAMPLE = 400
"""Rows at the beginning of a file that decide its layout. Bounds the time."""
_STAMP = re.compile(
    r"(?:(?:[a-z]{2,3}\.?|\w+day),?\s+)?"
    r"(?:\d{1,4}([-/.])\d{1,2}\1\d{1,4}|\d{1,2}[-. /][a-z]{3,9}[-. /]\d{2,4}|\d+:\d\d|\d+ days? \d)"
    r"[\d:.,TZ+\s/-]*(?:[ap]\.?m\.?|[a-z]{3,4})?[\d:+-]*",
    re.IGNORECASE,
)
_TIME_AND_NUMBER = re.compile(r":\d\d(?:[.,]\d+)?\s+(?:\d+|-\d{1,3})$")
"""A time and the whole part of a number with a decimal comma, 10:00:00 0 of 10:00:00 0,5."""
_VALUES = (
    *(re.compile(number_pattern(decimal)) for decimal in ".,"),
    re.compile(r"[-+]?(?:inf|infinity|nan)", re.IGNORECASE),
    _STAMP,
)
_BRACKETS = re.compile(r"\(.*\)|\[.*\]")
_REMARKS = "comment", "comments", "remark", "remarks", "note", "notes"
_COMMENT = re.compile(r"\s*[#%]\s*")


@dataclass(frozen=True)
class Row:
    """Hold the cells of a line, without blanks around them, and whether the first is quoted."""

    line: int
    cells: tuple[str, ...]
    quoted: bool

    @staticmethod
    def of(line: int, text: str, sep: str) -> Row:
        """Split a line at a separator; " " stands for any blanks."""
        text = " ".join(text.split()) if sep == " " else text
        try:
            cells = next(csv.reader([text], delimiter=sep, skipinitialspace=True))
        except csv.Error as error:
            raise InputError(f"line {line} cannot be split into cells: {error}") from None
        return Row(line, tuple(cell.strip() for cell in cells), text.lstrip().startswith('"'))

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


def is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a date."""
    if _TIME_AND_NUMBER.search(cell):
        return False
    return any(pattern.fullmatch(cell) for pattern in _VALUES)


def last(rows: Sequence[Row]) -> Sequence[Row]:
    """Return the last rows with content of the sample, which hold numbers if any do."""
    rows = [row for row in rows if row.width]
    return rows[-max(2, len(rows) // 4) :]


class Columns:
    """Tell what rows hold in the columns of numbers, which the last rows of the sample show."""

    def __init__(self, rows: Sequence[Row], no_values: set[str]) -> None:
        self._no_values = no_values
        below = last(rows)
        self.numbers = []
        for i in range(max((len(row.cells) for row in below), default=0)):
            cells = [row.cells[i] for row in below if i < len(row.cells)]
            known = [cell for cell in cells if cell.lower() not in no_values]
            if len(below) < 2 * len(cells) and len(known) < 2 * sum(map(is_value, known)):
                self.numbers.append(i)

    def values(self, row: Row) -> list[str]:
        """Return the cells of these columns that hold numbers or dates."""
        return [cell for cell in row.at(self.numbers) if is_value(cell)]

    def words(self, row: Row) -> list[str]:
        """Return the cells of these columns that hold neither these nor a missing value."""
        known = [cell for cell in row.at(self.numbers) if cell.lower() not in self._no_values]
        return [cell for cell in known if not is_value(cell)]

    def kind(self, row: Row) -> Literal["numbers", "names", "units", "neither"]:
        """Return what the row holds; names are complete, but for the first, and may be 1, 2, 3."""
        cells, words = row.at(self.numbers), self.words(row)
        if not words and any(cells):
            return "numbers"
        if is_value(cells[0]) or not all(map(str.isdigit, self.values(row))):
            return "neither"
        return "names" if words and all(row.at([i for i in self.numbers if i])) else "units"

    def check_units(self, rows: Sequence[Row], below: Row) -> None:
        """Raise ValueError for a row with values, or a stamp, as in the row of numbers below it."""
        texts = [i for i in range(len(below.cells)) if i not in self.numbers]
        for row in rows:
            pairs = zip(row.at(texts), below.at(texts), strict=True)
            found = [cell for cell, other in pairs if cell != _alike(cell) == _alike(other)]
            values = self.values(row)
            if {*values} != {"1"} or is_value(row.at(self.numbers)[0]):  # 1 stands for no unit
                found += values
            if found:
                word = next(iter(self.words(row)), "")
                raise InputError(
                    f"line {row.line} holds {found[0]!r} and {word!r}, neither names nor a row of "
                    f"numbers: missing={word!r} (--missing) if it stands for a missing value, "
                    f"skip_rows={row.line} (--skip-rows) with header_row=N (--header-row) leaves "
                    "the line out"
                )


def _alike(cell: str) -> str:
    """Return what cells have in common that differ by their digits."""
    return re.sub(r"[-+]?\d+(?:\.\d+)?", "#", cell)


def find_header(
    lines: Sequence[str],
    written: Sequence[str],
    sep: str,
    header_row: int | None,
    no_values: set[str],
) -> tuple[tuple[str, ...] | None, int]:
    """Return the names of the columns, None without any, and the line of the first row of numbers.

    `lines` are those of the file, as they are `written`, without comments. `header_row` is the line
    of the names, from 1, or 0 for none; `no_values` are the cells without a value.
    """
    begin = header_row or 0
    if begin > len(written):
        raise InputError(f"header_row is {begin}, but there are {len(written)} lines")
    filled = ((i, line) for i, line in enumerate(lines[begin:], begin + 1) if line)
    rows = [Row.of(i, line, sep) for i, line in islice(filled, SAMPLE)]
    if header_row == 0:
        return None, rows[0].line
    given = Row.of(begin, _COMMENT.sub("", written[begin - 1], count=1), sep) if begin else None
    columns = Columns(rows, no_values)
    if not columns.numbers:  # words alone, below the names
        names = given or rows.pop(0)
        return names.cells, rows[0].line if rows else len(lines) + 1
    kinds = [columns.kind(row) for row in rows]
    if "numbers" not in kinds:
        columns.check_units(rows, rows[-1])
        raise InputError(f"none of the lines up to {rows[-1].line} holds numbers without words")
    count = kinds.index("numbers")
    above, body = [row for row in rows[:count] if row.width], rows[count:]
    below = body[0]
    if given is not None:
        columns.check_units(above, below)
        if given.width < below.width:
            raise InputError(
                f"header_row={given.line} (--header-row) must hold a name for each column: it has "
                f"{given.width}, line {below.line} has {below.width} cells; header_row=0 with "
                f"skip_rows={below.line - 1} (--skip-rows) reads without names"
            )
        return _with_units(given, above, below, columns), below.line
    if above:
        return _chosen(above, body, columns), below.line
    found = _in_comments(written, below, sep, columns)
    if found is None and _begins_with_numbered_names(body):
        return below.cells, below.line + 1
    return found, below.line


def _chosen(above: Sequence[Row], body: Sequence[Row], columns: Columns) -> tuple[str, ...]:
    """Return the names that stand in one of the rows above those of the numbers."""
    below = body[0]
    dated = _STAMP.fullmatch(below.cells[0]) and above[-1].timed
    if below.quoted and above[-1].width == below.width - 1 and not dated:  # names of rows, of R
        above = [replace(row, cells=("", *row.cells)) for row in above]
    kinds = [columns.kind(row) for row in above]
    begin = max((i for i, kind in enumerate(kinds, 1) if kind == "neither"), default=0)
    cells = max(len(row.cells) for row in body)
    block, kinds = [_without_remarks(row, cells) for row in above[begin:]], kinds[begin:]
    columns.check_units([] if block else above[-1:], below)
    full = [row for row, kind in zip(block, kinds, strict=True) if kind == "names"]
    full = full or [row for row in block if row.width == below.width and len(block) == 1]
    if all(row.width > cells for row in full):
        line, width = block[-1].line, block[-1].width
        commas = "; decimal commas need ; or tabs between columns, or points in their place"
        raise InputError(
            f"line {line} holds {width} name{'s'[: width > 1]}, line {below.line} {below.width} "
            f"cells: skip_rows={line} (--skip-rows) leaves it out, header_row=N (--header-row) "
            f"says which line holds the names{commas if below.width == 2 * width else ''}"
        )
    names, *more = [row for row in full if row.timed] or full
    of_units = names.cells[0] and not any(row.cells[0] for row in more)  # the time's has none
    if more and not of_units:
        raise InputError(
            f"each of the lines {' and '.join(str(row.line) for row in (names, *more))} may hold "
            f"the names of the columns: header_row={names.line} (--header-row) takes the first, "
            "and the next one as units"
        )
    if unit := next(filter(_BRACKETS.fullmatch, names.cells), ""):
        raise InputError(
            f"line {names.line} holds {unit!r} where a name is due: names with blanks need "
            f"quotes, skip_rows={names.line} (--skip-rows) leaves them out"
        )
    at = block.index(names)
    units = block[at + 1 :] or [row for row in block[:at] if _has_unit_of_time(row, names)]
    columns.check_units(block[at + 1 :], below)
    if len(units) > 2:
        raise InputError(
            f"lines {names.line} to {units[-1].line} hold names: header_row={names.line} "
            "(--header-row) says which line holds those of the columns"
        )
    return _with_units(names, units, below, columns)


def _without_remarks(names: Row, cells: int) -> Row:
    """Leave out the name of a column that the rows below do not have, as LabVIEW's "Comment"."""
    more = names.width == cells + 1 and names.cells[cells].lower() in _REMARKS
    return replace(names, cells=names.cells[:cells]) if more else names


def _in_comments(
    written: Sequence[str], below: Row, sep: str, columns: Columns
) -> tuple[str, ...] | None:
    """Return the names in a comment above the numbers, as NumPy writes "# time,x"."""
    above = enumerate(written[: below.line - 1], 1)
    marked = [(i, line[mark.end() :]) for i, line in above if (mark := _COMMENT.match(line))]
    rows = [Row.of(i, line, sep) for i, line in marked]
    rows = [row for row in rows if len(row.cells) == len(below.cells) > 1]
    rows = [row for row in rows if columns.kind(row) == "names" and not columns.values(row)]
    plain = [row for row in rows if not any(" " in c and not unit_of(c) for c in row.cells)]
    timed = [row for row in rows if row.timed]
    found = timed or plain or rows
    if len(found) != 1 or (sep == " " and not timed):  # blanks also separate words
        return None
    names = found[0]
    if names not in (*timed, *plain):
        raise InputError(
            f"line {names.line} is a comment, {', '.join(names.cells)}, and may hold the names of "
            f"the columns: header_row={names.line} (--header-row) makes it names, header_row=0 a "
            "comment"
        )
    return _with_units(names, rows[rows.index(names) + 1 :], below, columns)


def _begins_with_numbered_names(body: Sequence[Row]) -> bool:
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


def _has_unit_of_time(row: Row, names: Row) -> bool:
    """Return whether a row has a unit for a column of time stamps."""
    pairs = zip(names.cells, row.cells, strict=False)
    units = [unit.strip("[]()") for name, unit in pairs if is_time(name)]
    return any(time_name(f"t [{unit}]")[1] for unit in units)


def _with_units(names: Row, units: Sequence[Row], below: Row, columns: Columns) -> tuple[str, ...]:
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
