"""Define `splitband summary`: one table of the results of many records."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import typer

from splitband.cli import printing
from splitband.forecasters.held_out import so_far_ahead
from splitband.report.results import write_csv
from splitband.report.table import OVER_ALL, Column, Table, Unit
from splitband.runtime.errors import InputError
from splitband.runtime.files import write_json
from splitband.runtime.outputs import FACTS, FORMAT, LOCK, unfinished

_TIME = "time (s)"


def summary(
    folders: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIR...", help="Result folders of `splitband compare`.", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Also write the table to a .csv or .json file.", show_default=False
        ),
    ] = None,
) -> None:
    """Put the results of several comparisons into one table, in the given order.

    Each folder has a row for every output and test record, with the numbers of the recommended
    method. An unfinished comparison is marked, and has the numbers that it has so far.
    """
    if out is not None and out.suffix not in (".csv", ".json"):
        raise InputError(f"--out must end in .csv or .json, got {out}")
    units: dict[str, Unit] = {}
    rows = [row for folder in dict.fromkeys(folders) for row in _rows(folder, units)]
    said = dict[str, str]()
    values: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        name = f"{row['folder']}: {row['recommended'] or '-'}"
        said[name] = f"unfinished: {row['unfinished']}" if row["unfinished"] else ""
        several = sum(row["folder"] == other["folder"] for other in rows) > 1
        line = ", ".join(filter(None, (row["record"], row["output"]))) if several else ""
        for heading in [each for each in units if each in row]:
            of = "" if units[heading] in OVER_ALL else line
            values.setdefault((heading, of), {})[name] = row[heading]
    keys = sorted(values, key=lambda key: (units[key[0]] != "percent", [*units].index(key[0])))
    columns = [Column(h, units[h], values[h, line], line, ranked=False) for h, line in keys]
    printing.table(Table("", columns, said, "folder: recommended"))
    if out is not None:
        if out.suffix == ".csv":
            write_csv(out, pd.DataFrame(rows))
        else:
            write_json(out, rows)
    printing.as_json(rows)


def _rows(folder: Path, units: dict[str, Unit]) -> list[dict[str, Any]]:
    """Return the rows of a result, and add the units of their headings."""
    path = folder / FACTS if folder.is_dir() else folder
    try:
        begun = {"recommended": "", "table": [], "unfinished": "no result yet"}
        facts: dict[str, Any] = begun | {"format": FORMAT}
        if path.exists() or not (folder / LOCK).exists():
            facts = json.loads(path.read_text(encoding="utf-8"))
        best, written = facts["recommended"], facts.get("format")
        table = facts["table"] if written == FORMAT else []
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"DIR must be a folder that splitband compare wrote, with {FACTS}, got {folder}"
        ) from None
    if written != FORMAT:
        raise InputError(
            f"DIR must hold results of format {FORMAT}, got {written} in {folder}: make them again "
            "with `splitband compare`"
        )
    own = facts.get("record", {}).get("name", "")
    state = unfinished(facts)
    over_all = {_TIME: facts["time"]["used_seconds"]} if "time" in facts else {}
    lines: dict[tuple[str, str], dict[str, Any]] = {} if table else {(own, ""): {}}
    for column in table:
        # What is 12 samples ahead in one folder is 50 in another.
        ahead, heading = column.get("ahead"), column["heading"]
        heading = f"fit % {so_far_ahead(ahead)}" if ahead else heading
        units[heading] = column["unit"]
        of = column.get("record", own), column.get("channel", "")
        line = over_all if column["unit"] in OVER_ALL else lines.setdefault(of, {})
        line |= {heading: column["values"][best]} if best in column["values"] else {}
    units.setdefault(_TIME, units.pop(_TIME, "seconds"))  # it comes last
    kept = {"folder": str(folder), "recommended": best, "unfinished": state}
    return [kept | {"record": r, "output": o} | line | over_all for (r, o), line in lines.items()]
