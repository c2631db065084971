"""Define `splitband summary`: one table of the results of many records."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from splitband.cli import showing
from splitband.runtime.outputs import FACTS, FORMAT


def summary(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Folders that compare wrote.", show_default=False),
    ],
) -> None:
    """Put the results of several comparisons into one table, a row for each folder.

    The numbers are those of the recommended method: its fit and error on the test record if there
    is one, else on the forecast, and the share of the forecast in its interval.
    """
    rows = [_row(folder) for folder in folders]
    table = Table(*("folder", "record", "recommended", "fit %", "RMSE", "in interval", "seconds"))
    for row in rows:
        numbers = (row["fit"], row["rmse"], row["in interval"], row["seconds"])
        table.add_row(
            row["folder"], row["record"], row["recommended"],
            *("" if number is None else f"{number:.4g}" for number in numbers),
        )  # fmt: skip
    showing.console.print(table)
    showing.as_json(rows)


def _row(folder: Path) -> dict[str, Any]:
    """Return the numbers of a result; raises ValueError for another folder."""
    path = folder / FACTS if folder.is_dir() else folder
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
        best, written = facts["recommended"], facts.get("format")
        table = facts["table"] if written == FORMAT else []
        record = facts["record"]["name"] if "record" in facts else ""
    except (OSError, ValueError, KeyError, TypeError):
        raise ValueError(
            f"DIR must be a folder that splitband compare wrote, with {FACTS}, got {folder}"
        ) from None
    if written != FORMAT:
        raise ValueError(
            f"DIR must hold results of format {FORMAT}, got {written} in {folder}: make them again "
            "with `splitband compare`"
        )

    def value(*headings: str) -> float | None:
        found = [c["values"].get(best) for h in headings for c in table if c["heading"] == h]
        return next((each for each in found if each is not None), None)

    return {
        "folder": str(folder),
        "record": record,
        "recommended": best + (" (unfinished)" if "unfinished" in facts else ""),
        "fit": value("test fit %", "forecast fit %"),
        "rmse": value("test RMSE", "forecast RMSE", "held-out RMSE"),
        "in interval": value("in interval"),
        "seconds": facts.get("time", {}).get("used_seconds"),
    }
