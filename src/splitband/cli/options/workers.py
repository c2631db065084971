"""Options that say what carries out the trainings."""

from __future__ import annotations

from typing import Annotated

import typer

Jobs = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Trainings at once, each a process on one core; the numbers do not depend on it "
        "but for rounding.",
        show_default="one a core",
    ),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="A Dask scheduler, such as tcp://10.0.0.5:8786, whose workers train in place of this "
        "machine; one training a core.",
        show_default=False,
    ),
]
