"""`python -m reproduction`: the paper's tables and figures."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table as RichTable
from typer.exceptions import TyperException

from reproduction import horizons
from reproduction.costs import progress
from reproduction.figures import FIGURES, figure, needed
from reproduction.jobs import SYSTEMS
from reproduction.runs import complete, missing, write_json_lines
from reproduction.specs import SPECS, TITLES, Line, lines
from reproduction.tables import Table, table
from splitband.cli.display import workers
from splitband.comparison.methods import TRAINED
from splitband.report import pictures
from splitband.runtime.files import output_folder, write_json
from splitband.runtime.workers import Workers

console = Console(markup=False, emoji=False, highlight=False)

app = typer.Typer(
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


Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Trainings at once, each on one core.", show_default="one a core"),
]
Cluster = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="A Dask scheduler, such as tcp://10.0.0.5:8786, whose workers train instead.",
        show_default=False,
    ),
]


@app.command("list")
def list_names(seeds: Seeds = 5, out: Out = Path("paper")) -> None:
    """List the tables, figures and systems, and how many runs of each OUT has.

    A run counts with all of the paper's epochs. What is missing is estimated from the finished runs
    of the same method on the same system, or by the run times that the paper reports.
    """
    listed = RichTable(box=None)
    for heading in ("", "name", "runs", "missing", ""):
        listed.add_column(heading, no_wrap=heading != "")
    guessed = False
    for name in SPECS:
        jobs = [job for line in lines(name, seeds=seeds) for job in line.jobs]
        state = progress(jobs, out / "runs")
        guessed = guessed or not state.measured
        mark = "" if state.measured else " *"
        takes = "" if state.there == state.needed else _duration(state.seconds) + mark
        listed.add_row("table", name, f"{state.there} of {state.needed}", takes, TITLES[name])
    for name in FIGURES:
        listed.add_row("figure", name)
    for name, system in SYSTEMS.items():
        listed.add_row("system", name, "", "", system.title)
    console.print(listed)
    console.print("missing: time of one process, that of tables that share runs in each")
    if guessed:
        console.print("* partly by the run times that the paper reports")


@app.command("table")
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
    _run_missing((line for rows in of.values() for line in rows), out, _workers(jobs, cluster), run)
    for each, rows in of.items():
        made = table(each, rows, out / "runs")
        output_folder(out / "tables", "--out")
        asked = {"systems": systems, "methods": methods, "seeds": seeds, "epochs": epochs}
        facts = {
            "title": made.title,
            "asked": asked,
            "rows": made.facts,
            "markdown": made.markdown(),
        }
        write_json(out / "tables" / f"{each}.json", facts)
        console.print(_rich(made))
    console.print(f"tables: {out / 'tables'}/")


@app.command("horizons")
def make_horizons(out: Out = Path("paper")) -> None:
    """Measure the finished runs in the short and in the long term: OUT/horizons.json."""
    write_json_lines(out / "horizons.json", horizons.collected(out / "runs"))
    console.print(f"{out / 'horizons.json'}")


@app.command("figure")
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
    _run_missing(every, out, _workers(jobs, cluster), run)
    output_folder(out / "figures", "--out")
    for each, by_system in of.items():
        for system, rows in by_system.items():
            path = out / "figures" / f"{system}-{each}.png"
            pictures.save(figure(each, system, rows, out / "runs"), path)
            console.print(f"{path}")


def _duration(seconds: float) -> str:
    if seconds < 60:
        return "under a minute"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _run_missing(
    of: Iterable[Line], out: Path, where: AbstractContextManager[Executor | None], run: bool
) -> None:
    output_folder(out / "runs", "--out")
    if not run:
        return
    todo = missing((job for line in of for job in line.jobs), out / "runs")
    trainings = sum(job.method in TRAINED for job in todo)
    bar = Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty())
    with where as chosen, bar:
        whole = bar.add_task(f"{trainings} trainings", total=trainings)
        complete(todo, out / "runs", chosen, lambda job: bar.advance(whole, job.method in TRAINED))


@contextmanager
def _workers(jobs: int | None, cluster: str | None) -> Iterator[Executor | None]:
    """Yield what trains: this process, processes of this machine, or the workers of a cluster."""
    with workers(jobs, cluster) as where:
        if "executor" in where:
            yield where["executor"]
        elif where["cores"] == 1:
            yield None
        else:
            with Workers(where["cores"]) as executor:
                yield executor


def _chosen(name: str, possible: Iterable[str], what: str) -> list[str]:
    if name not in (*possible, "all"):
        raise ValueError(f"{what} must be one of {', '.join(possible)} or all, got {name}")
    return [*possible] if name == "all" else [name]


def _split(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _rich(made: Table) -> RichTable:
    shown = RichTable(title=made.title, title_justify="left", title_style="bold")
    for i, heading in enumerate(made.header):
        shown.add_column(heading, justify="left" if i < made.words else "right")
    for row in made.rows:
        shown.add_row(*row)
    return shown


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; bad input is one line on the error stream and exit status 2."""
    command = typer.main.get_command(app)
    try:
        status = command.main(arguments, "python -m reproduction", standalone_mode=False)
    except TyperException as error:
        message = error.format_message()
    except (ValueError, OSError) as error:
        message = str(error)
    else:
        return status if isinstance(status, int) else 0
    print(f"error: {message}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
