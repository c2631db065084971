"""Define `splitband data`: the public records of the paper."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Column, Table

from splitband.cli import showing
from splitband.data import PUBLIC, fetch
from splitband.data.named import RECORDS

data = typer.Typer(name="data", help="The public records of the paper.", no_args_is_help=True)


@data.command("list")
def list_records() -> None:
    """List the named records and the public files behind them."""
    table = Table("file", "what", "licence", Column("size", justify="right"))
    for public in PUBLIC.values():
        size = f"{public.size / 1000:.0f} kB"
        table.add_row(public.name, public.description, public.licence, size)
    showing.console.print(table)
    showing.console.print(f"named records: {', '.join(RECORDS)}")
    showing.as_json(
        {"files": {p.name: p.description for p in PUBLIC.values()}, "named": [*RECORDS]}
    )


@data.command("fetch")
def fetch_records(
    names: Annotated[
        list[str] | None, typer.Argument(help="Files to fetch.", show_default="all")
    ] = None,
) -> None:
    """Download public files, or find them in SPLITBAND_DATA_DIR, and check them."""
    paths = {}
    for name in names or PUBLIC:
        paths[name] = str(fetch(name))
        showing.console.print(f"{name}: {paths[name]}")
    showing.as_json(paths)
