"""`python -m reproduction`: the paper's tables and figures."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from rich.console import Console
from rich.progress import Progress
from rich.table import Table as RichTable
from typer.exceptions import TyperException

from reproduction import horizons
from reproduction.costs import progress
from reproduction.figures import FIGURES, figure, needed
from reproduction.figures import NUMBERED as FIGURES_OF_PAPER
from reproduction.jobs import SYSTEMS
from reproduction.runs import complete, missing, write_json_lines
from reproduction.specs import NUMBERED, SPECS, TITLES, Line, chosen, lines
from reproduction.tables import Table, table
from splitband.cli.display import workers
from splitband.comparison.methods import TRAINED
from splitband.report import pictures
from splitband.runtime.files import output_folder, write_json
from splitband.runtime.workers import Workers

T = TypeVar("T")
console = Console(markup=False, emoji=False, highlight=False)

app = typer.Typer(
    help="Reproduce the tables and figures of the paper.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

_NAMED = "The paper's number, such as '{} 2' or 2; one of {}; or all."
TableName = Annotated[
    str, typer.Argument(metavar="NAME", help=_NAMED.format("Table", ", ".join(SPECS)))
]
FigureName = Annotated[
    str, typer.Argument(metavar="NAME", help=_NAMED.format("Figure", ", ".join(FIGURES)))
]
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
Cutoff = Annotated[
    float | None,
    typer.Option(
        help="w of split and filtered models, in the unit of the paper's tables: 0.4 for (i).",
        show_default="the paper's",
    ),
]
Downsampling = Annotated[
    int | None,
    typer.Option(min=1, help="k of split models.", show_default="the paper's"),
]
Update = Annotated[
    bool, typer.Option("--update", help="Replace tables and figures that OUT has already.")
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
    for number, parts in FIGURES_OF_PAPER.items():
        said = ", ".join(f"({system}) {kind}" for kind, system in parts)
        listed.add_row("figure", f"{number}", "", "", said)
    for name, system in SYSTEMS.items():
        listed.add_row("system", name, "", "", system.title)
    console.print(listed)
    console.print("missing: time of one process, that of tables that share runs in each")
    if guessed:
        console.print("* partly by the run times that the paper reports")


@app.command("table")
def make_table(
    name: TableName,
    systems: Systems = None,
    methods: Methods = None,
    seeds: Seeds = 5,
    epochs: Epochs = None,
    cutoff: Cutoff = None,
    downsampling: Downsampling = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    out: Out = Path("paper"),
    run: Run = True,
    update: Update = False,
) -> None:
    """Make a table of the paper: ours beside the published values.

    Every run of a method with a seed is one file in OUT/runs. What is there is not run again, so
    that a long table can be stopped, and the same command goes on; several at once may share a
    folder. A table that OUT has already is printed, and replaced with --update alone.
    """
    numbered = {number: [table] for number, table in NUMBERED.items()}
    tables = _chosen(name, {table: [table] for table in SPECS}, numbered, "table")
    if len(tables) > 1 and (systems or methods):
        raise ValueError(f"--systems and --methods must be used with one table, got {name}")
    change = {"epochs": epochs, "cutoff": cutoff, "downsampling": downsampling}
    of = {each: lines(each, _split(systems), _split(methods), seeds, **change) for each in tables}
    _run_missing((line for rows in of.values() for line in rows), out, _workers(jobs, cluster), run)
    other = [(k, v) for k, v in (("w", cutoff), ("k", downsampling)) if v is not None]
    marks, said = (
        "".join(form.format(*each) for each in other) for form in ("-{}{:g}", ", {} = {:g}")
    )
    for each, rows in of.items():
        made = table(each, rows, out / "runs")
        made = replace(made, title=made.title + said)
        console.print(_rich(made))
        asked = {"systems": systems, "methods": methods, "seeds": seeds, **change}
        facts = {
            "title": made.title,
            "asked": asked,
            "rows": made.facts,
            "markdown": made.markdown(),
        }
        if (path := _replaceable(out / "tables" / f"{each}{marks}.json", update)) is not None:
            write_json(path, facts)
            console.print(f"{path}")


@app.command("horizons")
def make_horizons(out: Out = Path("paper"), update: Update = False) -> None:
    """Measure the finished runs in the short and in the long term: OUT/horizons.json."""
    if (path := _replaceable(out / "horizons.json", update)) is not None:
        write_json_lines(path, horizons.collected(out / "runs"))
        console.print(f"{path}")


@app.command("figure")
def make_figure(
    name: FigureName,
    systems: Systems = None,
    methods: Methods = None,
    seeds: Seeds = 5,
    epochs: Epochs = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    out: Out = Path("paper"),
    run: Run = True,
    update: Update = False,
) -> None:
    """Draw a figure of the paper, or one kind of it for every system.

    Runs are shared with the tables. A figure that OUT has already is replaced with --update alone.
    """
    named = chosen("systems", _split(systems), SYSTEMS)
    kinds = {kind: [(kind, system) for system in SYSTEMS] for kind in FIGURES}
    parts = _chosen(name, kinds, FIGURES_OF_PAPER, "figure")
    of = {
        (kind, system): rows
        for kind, system in parts
        if system in named
        if (rows := needed(kind, system, _split(methods), seeds, epochs=epochs)) is not None
    }
    _run_missing((line for rows in of.values() for line in rows), out, _workers(jobs, cluster), run)
    for (kind, system), rows in of.items():
        path = _replaceable(out / "figures" / f"{system}-{kind}.png", update)
        if path is not None:
            pictures.save(figure(kind, system, rows, out / "runs"), path)
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


def _replaceable(path: Path, update: bool) -> Path | None:
    """Return a path that may be written, in a folder that is there; None for what is kept."""
    if path.exists() and not update:
        console.print(f"{path} was there before and is kept; --update replaces it")
        return None
    output_folder(path.parent, "--out")
    return path


def _chosen(
    name: str,
    possible: Mapping[str, Iterable[T]],
    numbered: Mapping[int, Iterable[T]],
    what: str,
) -> list[T]:
    """Return what a name stands for: one of ours, the paper's number, or all of ours."""
    word = name.lower().removeprefix(what).strip()
    if name == "all":
        return [each for of in possible.values() for each in of]
    if word.isdecimal() and int(word) in numbered:
        return [*numbered[int(word)]]
    if name not in possible:
        numbers = ", ".join(map(str, numbered))
        raise ValueError(
            f"{what} must be one of {', '.join(possible)}, a number of the paper's ({numbers}) "
            f"or all, got {name}"
        )
    return [*possible[name]]


def _split(text: str | None) -> list[str] | None:
    return None if text is None else [part.strip() for part in text.split(",") if part.strip()]


def _rich(made: Table) -> RichTable:
    shown = RichTable(title=made.title, title_justify="left", title_style="bold", box=None)
    for i, heading in enumerate(made.header):
        word = i < made.words
        shown.add_column(heading, justify="left" if word else "right", no_wrap=word)
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
