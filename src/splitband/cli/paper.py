"""`splitband paper`: the paper's tables and figures."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table as RichTable

from splitband.cli import naming, showing
from splitband.cli.crew import Crew, crew
from splitband.cli.options.workers import Cluster, Jobs
from splitband.forecasters.names import TRAINED
from splitband.paper.costs import progress
from splitband.paper.figures import FIGURES, figure, needed
from splitband.paper.jobs import SYSTEMS
from splitband.paper.runs import complete, missing
from splitband.paper.specs import SPECS, Line, lines
from splitband.paper.tables import Table, table
from splitband.report import pictures
from splitband.runtime.files import output_folder, replacing, write_json

paper = typer.Typer(
    help="Reproduce the tables and figures of the paper.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

Systems = Annotated[
    str | None,
    typer.Option(
        help=f"Which, separated by commas, out of {', '.join(SYSTEMS)}.", show_default="all of it"
    ),
]
Methods = Annotated[
    str | None,
    typer.Option(help="Which, separated by commas.", show_default="all of it"),
]
Seeds = Annotated[int, typer.Option(min=1, help="Trainings of each network.")]
Epochs = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Passes over the training part; the number stands beside the value.",
        show_default="the paper's",
    ),
]
Out = Annotated[
    Path, typer.Option(help="Folder of results: runs, one file each, tables and figures.")
]
Run = Annotated[
    bool,
    typer.Option("--run/--no-run", help="Whether to run what is missing; without, it is an error."),
]


@paper.command("list")
def list_names(seeds: Seeds = 5, out: Out = Path("paper")) -> None:
    """List the tables, figures and systems, and how many runs of each table are in OUT/runs.

    A run counts with all of the paper's epochs. What is missing is estimated from the finished runs
    of the same method on the same system, or by the run times that the paper reports.
    """
    listed = RichTable(box=None)
    for heading in ("", "name", "runs", "missing", ""):
        listed.add_column(heading, no_wrap=heading != "")
    guessed = False
    for name, spec in SPECS.items():
        jobs = [job for line in lines(name, seeds=seeds) for job in line.jobs]
        state = progress(jobs, out / "runs")
        guessed = guessed or not state.measured
        mark = "" if state.measured else " *"
        takes = "" if state.there == state.needed else _duration(state.seconds) + mark
        listed.add_row("table", name, f"{state.there} of {state.needed}", takes, spec.title)
    for name in FIGURES:
        listed.add_row("figure", name)
    for name, system in SYSTEMS.items():
        listed.add_row("system", name, "", "", system.title)
    showing.console.print(listed)
    showing.console.print("missing: time of one process, that of tables that share runs in each")
    if guessed:
        showing.console.print("* partly by the run times that the paper reports")


@paper.command("table")
def make_table(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help=f"One of {', '.join(SPECS)}, or all.")
    ],
    systems: Systems = None,
    methods: Methods = None,
    seeds: Seeds = 5,
    epochs: Epochs = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    out: Out = Path("paper"),
    run: Run = True,
) -> None:
    """Make a table of the paper: ours beside the published values.

    Every run of a method with a seed is one file in OUT/runs. What is there is not run again, so
    that a long table can be stopped, and the same command goes on; several at once may share a
    folder.
    """
    chosen = _chosen(name, SPECS, "table")
    if len(chosen) > 1 and (systems or methods):
        raise ValueError(f"--systems and --methods must be used with one table, got {name}")
    of = {each: lines(each, _split(systems), _split(methods), seeds, epochs) for each in chosen}
    _run_missing((line for rows in of.values() for line in rows), out, crew(jobs, cluster), run)
    for each, rows in of.items():
        made = table(each, rows, out / "runs")
        output_folder(out / "tables", "--out")
        with replacing(out / "tables" / f"{each}.md") as temporary:
            temporary.write_text(made.markdown(), encoding="utf-8")
        asked = {"systems": systems, "methods": methods, "seeds": seeds, "epochs": epochs}
        facts = {"title": made.title, "asked": asked, "rows": made.facts}
        write_json(out / "tables" / f"{each}.json", facts)
        showing.console.print(_rich(made))
    showing.console.print(f"tables: {out / 'tables'}/")


@paper.command("figure")
def make_figure(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help=f"One of {', '.join(FIGURES)}, or all.")
    ],
    systems: Systems = None,
    methods: Methods = None,
    seeds: Seeds = 5,
    epochs: Epochs = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    out: Out = Path("paper"),
    run: Run = True,
) -> None:
    """Draw a figure of the paper for every system; runs are shared with the tables."""
    chosen = _chosen(name, FIGURES, "figure")
    of = {each: needed(each, _split(systems), _split(methods), seeds, epochs) for each in chosen}
    every = (line for by_system in of.values() for rows in by_system.values() for line in rows)
    _run_missing(every, out, crew(jobs, cluster), run)
    output_folder(out / "figures", "--out")
    for each, by_system in of.items():
        for system, rows in by_system.items():
            path = out / "figures" / f"{system}-{each}.png"
            pictures.save(figure(each, system, rows, out / "runs"), path)
            showing.console.print(f"{path}")


def _duration(seconds: float) -> str:
    if seconds < 60:
        return "under a minute"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _run_missing(
    of: Iterable[Line], out: Path, workers: AbstractContextManager[Crew], run: bool
) -> None:
    output_folder(out / "runs", "--out")
    if not run:
        return
    todo = missing((job for line in of for job in line.jobs), out / "runs")
    trainings = sum(job.method in TRAINED for job in todo)
    with workers as chosen, showing.progress(f"{trainings} trainings", trainings) as report:
        complete(todo, out / "runs", chosen.executor or chosen.cores, report)


def _chosen(name: str, possible: Iterable[str], what: str) -> list[str]:
    if name not in (*possible, "all"):
        raise ValueError(f"{what} must be one of {', '.join(possible)} or all, got {name}")
    return [*possible] if name == "all" else [name]


def _split(text: str | None) -> list[str] | None:
    return None if text is None else naming.names(text)


def _rich(made: Table) -> RichTable:
    shown = RichTable(title=made.title, title_justify="left", title_style="bold")
    for i, heading in enumerate(made.header):
        shown.add_column(heading, justify="left" if i < made.words else "right")
    for row in made.rows:
        shown.add_row(*row)
    return shown
