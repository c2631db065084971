"""Define `splitband data`: the public records of the paper."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Column, Table

from splitband.cli import printing
from splitband.records import PUBLIC, fetch
from splitband.records.named import RECORDS


def data(
    download: Annotated[
        bool, typer.Option("--fetch", help="Download the records and check them.")
    ] = False,
) -> None:
    """List the public records of the paper, which commands know by name.

    A record is downloaded when it is first used, or read from the folder SPLITBAND_DATA_DIR.
    """
    said = "path" if download else "what"
    names = (Column(name, overflow="fold") for name in ("file", said, "licence"))
    table = Table(*names, Column("size", justify="right"))
    found = {n: str(fetch(n)) if download else each.description for n, each in PUBLIC.items()}
    for name, each in PUBLIC.items():
        table.add_row(name, found[name], each.licence, f"{each.size / 1000:.0f} kB")
    printing.console.print(table)
    printing.console.print(f"named records: {', '.join(RECORDS)}")
    printing.as_json({"files": found, "named": [*RECORDS]})
