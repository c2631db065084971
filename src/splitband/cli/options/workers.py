"""Options that say what carries out the trainings."""

from __future__ import annotations

from typing import Annotated

import typer

Jobs = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Trainings at once, one on each core.",
        rich_help_panel="Time",
        show_default="all cores",
    ),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Dask scheduler whose workers train: tcp://...:8786.",
        rich_help_panel="Time",
        show_default=False,
    ),
]
