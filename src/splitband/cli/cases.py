"""Read the list of `splitband benchmark`: a row is a case, a column an option of `compare`."""

from __future__ import annotations

import csv
import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, get_args

from splitband.cli.comparing import Request, arguments
from splitband.cli.options.simulators import parts_of
from splitband.data.gaps import Gaps
from splitband.data.named import RECORDS
from splitband.forecasters.names import BASES
from splitband.simulators.named import SIMULATORS
from splitband.simulators.sources import digest, source_files

COLUMNS = (
    "record", "name", "columns", "inputs", "time_column", "sampling_time", "gaps", "missing",
    "skip_rows", "header_row", "train", "warmup", "test", "test_simulator", "more",
    "more_simulator", "simulator", "simulator_columns", "simulator_reads",
)  # fmt: skip
_SEVERAL = {"test", "test_simulator", "more", "more_simulator", "simulator_reads"}
_NAMED: dict[str, tuple[str, ...]] = {
    "record": tuple(RECORDS), "test": (), "more": (), "simulator_reads": (),
    **dict.fromkeys(("simulator", "test_simulator", "more_simulator"), (*SIMULATORS, *BASES)),
}  # fmt: skip
"""Columns that name files, and the other names that each accepts."""
OVERALL = ("results.json", "table.csv", "report.html")
"""Files in the output folder, next to the folders of the cases."""


@dataclass(frozen=True)
class Case:
    """Hold a row of the list.

    Attributes
    ----------
    name : Name of the case and of its folder.
    request : The comparison, with paths of files that can be opened.
    listed : The same, with files as written in the list.
    files : Path of each file, by its name in the list.
    """

    name: str
    request: Request
    listed: Request
    files: Mapping[str, Path]

    def identity(self) -> dict[str, Any]:
        """Return what determines a comparison's numbers: its options and its files' digests.

        Cores and cluster are left out, as they change the numbers by rounding only.
        """
        values: dict[str, Any] = {}
        for field in fields(self.listed):
            value = getattr(self.listed, field.name)
            values |= asdict(value) if is_dataclass(value) else {field.name: value}  # type: ignore[arg-type]
        for name in ("settings", "refit"):  # no options of `benchmark`
            del values[name]
        digests = {}
        for listed, path in self.files.items():
            digests[listed] = hashlib.sha256(path.read_bytes()).hexdigest()
            modules = source_files(path)[1:] if path.suffix == ".py" else []
            if modules:
                digests[f"{listed}: imports"] = digest(modules)
        return {"arguments": arguments(values), "digests": digests}


def read_cases(path: Path, shared: Request) -> list[Case]:
    """Return the cases of a CSV file, checked before anything is computed.

    Parameters
    ----------
    path : The CSV file; files that it names are relative to its folder.
    shared : The options of all cases; its record is ignored.

    Raises
    ------
    ValueError
        For an unknown column, an invalid value, a missing file, two cases of the same name and a
        list without cases; the message names row, column, rule and value.
    """
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "does not exist"
        raise ValueError(
            f"LIST must be a CSV file with a row for each case, got {path}, which {what}"
        )
    cases: dict[str, Case] = {}
    rows: dict[str, int] = {}
    for row, cells in _rows(path):
        where = f"{path}, row {row}"
        case = _case(where, cells, path.parent, shared)
        key = case.name.casefold()  # some file systems ignore case
        if key in cases:
            raise ValueError(
                f"{where}, column name: must differ from that of row {rows[key]} (without a name a "
                f"case is called after its record), got {case.name}"
            )
        cases[key], rows[key] = case, row
    if not cases:
        raise ValueError(f"{path}: must have a row for each case below its header, got none")
    return [*cases.values()]


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the line number of each row (the header is 1) and its non-empty cells by column."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as opened:
            reader = csv.reader(opened, strict=True)
            header = [cell.strip() for cell in next(reader, [])]
            for i, name in enumerate(header):
                if name not in COLUMNS or name in header[:i]:
                    rule = "there once" if name in COLUMNS else f"one of {', '.join(COLUMNS)}"
                    raise ValueError(f"{path}, row 1, column {i + 1}: must be {rule}, got {name}")
            if "record" not in header:
                said = ", ".join(header) or "nothing"
                raise ValueError(f"{path}, row 1: must have a column record, got {said}")
            for cells in reader:
                values = [cell.strip() for cell in cells]
                if len(values) > len(header):
                    raise ValueError(
                        f"{path}, row {reader.line_num}: must have a cell for each of the "
                        f"{len(header)} columns, one with commas in quotes, got {len(values)}"
                    )
                if any(values):
                    named = zip(header, values, strict=False)
                    yield reader.line_num, {name: value for name, value in named if value}
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"LIST must be a CSV file in UTF-8, got {path}: {error}") from None


def _case(where: str, cells: Mapping[str, str], folder: Path, shared: Request) -> Case:
    if "record" not in cells:
        raise ValueError(f"{where}, column record: must be a file or a named record, got nothing")
    values, files = {}, {}
    for column, cell in cells.items():
        try:
            values[column] = value = _value(column, cell)
            for each in value if column in _SEVERAL else [value]:
                if column in _NAMED and each not in _NAMED[column]:
                    listed = parts_of(each)[0] if "simulator" in column else each
                    files[listed] = folder / listed
                    if not files[listed].is_file():
                        raise ValueError(f"must be a file{_or_named(column)}")
        except ValueError as error:
            raise ValueError(f"{where}, column {column}: {error}, got {cell}") from None
    name = values.pop("name", Path(cells["record"]).stem)
    if name.startswith(".") or set(name) & set('/\\:*?"<>|\0') or name.casefold() in OVERALL:
        raise ValueError(
            f"{where}, column name: must be the name of a folder, without a dot before it, and "
            f"none of {', '.join(OVERALL)}, got {name}"
        )

    def opened(column: str, value: Any) -> Any:
        if column not in _NAMED or value in _NAMED[column]:
            return value
        return str(folder / value)

    placed = {
        column: [opened(column, each) for each in value]
        if column in _SEVERAL
        else opened(column, value)
        for column, value in values.items()
    }
    return Case(name, _request(placed, shared), _request(values, shared), files)


def _value(column: str, cell: str) -> Any:
    """Convert a cell to the value that the option of its column takes."""
    if column in _SEVERAL:
        return [part.strip() for part in cell.split(";") if part.strip()]
    if (column, cell) == ("warmup", "auto"):
        return None
    if column in ("train", "warmup", "skip_rows", "header_row"):
        try:
            return int(cell)
        except ValueError:
            raise ValueError("must be a whole number") from None
    if column == "sampling_time":
        try:
            seconds = float(cell)
        except ValueError:
            seconds = math.nan
        if not 0 < seconds < math.inf:
            raise ValueError("must be a number of seconds above 0")
        return seconds
    if column == "gaps" and cell not in get_args(Gaps):
        raise ValueError(f"must be one of {', '.join(get_args(Gaps))}")
    return cell


def _or_named(column: str) -> str:
    named = _NAMED[column]
    function = ", FILE.py:FUNCTION" if "simulator" in column else ""
    return f"{function} or one of {', '.join(named)}" if named else ""


def _request(values: Mapping[str, Any], shared: Any) -> Any:
    """Return a group of options with some values replaced, also in nested groups."""
    changed = {}
    for field in fields(shared):
        value = getattr(shared, field.name)
        if is_dataclass(value):
            changed[field.name] = _request(values, value)
        elif field.name in values:
            changed[field.name] = values[field.name]
    return replace(shared, **changed)
