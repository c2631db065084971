"""Define `splitband benchmark`."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from splitband.cli import clock, in_words, setups, showing
from splitband.cli.cases import COLUMNS, OVERALL, Case, read_cases
from splitband.cli.comparing import Request, command_of, compared, planned, save, workers
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Cluster, Conditioned, Jobs, Methods, ModelOptions, Seeds
from splitband.cli.options.simulators import Calibrate
from splitband.cli.output import refuse_inputs, replaced
from splitband.cli.usage import usage
from splitband.evaluation.work import Work
from splitband.forecasters.names import with_variants
from splitband.report import benchmark as report
from splitband.report.environment import environment
from splitband.report.numbers import number
from splitband.report.page import document
from splitband.runtime.deadlines import now
from splitband.runtime.files import CHECKPOINTS, replacing
from splitband.runtime.outputs import FACTS, locked, staged, write_facts
from splitband.runtime.processes import map_jobs
from splitband.runtime.threads import available_cores

CORES_OF_A_CASE = 2
"""Cores for which a comparison's work is planned by default (`evaluation.search`). By eye."""
PROCESSES_OF_A_CORE = 4
"""Concurrent cases for each core of this machine with --cluster, as this machine still reads
records and draws pictures. By eye."""


@with_groups
def benchmark(
    context: typer.Context,
    listed: Annotated[
        Path,
        typer.Argument(
            metavar="LIST",
            help=f"A CSV file with a row for each case and columns out of {', '.join(COLUMNS)}; "
            "only record must be there.",
            show_default=False,
        ),
    ],
    model: ModelOptions,
    methods: Methods = None,
    seeds: Seeds = None,
    jobs: Jobs = None,
    out: Annotated[
        Path, typer.Option(help="Folder for the table, and for a folder for each case.")
    ] = Path("benchmark"),
    calibrate: Calibrate = False,
    conditioned: Conditioned = False,
    cluster: Cluster = None,
    at_once: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Cases at once, which share the cores.",
            rich_help_panel="Time",
            show_default="one for every two cores",
        ),
    ] = None,
) -> None:
    """Compare models of many records, and put them into one table.

    A row of LIST is a case, which is compared as by `splitband compare`; the columns are options of
    that command. Files are relative to the list's folder; several of them (test, more and their
    simulators) are separated by ";". A case is called by its name, or after its record. The options
    of this command hold for all cases; a warm-up in LIST overrides --warmup.

    OUT/NAME has for each case what `compare` writes. The table over all of them (table.csv,
    results.json, report.html) has the error of the recommended method, on the test
    records where there are any, else of the forecast, as a multiple of the record's standard
    deviation; which method was the best; the regret, which is the recommended method's error over
    the best one's; and how much of the forecast was in its interval.

    A case that fails has a row that says why. Given again, the command goes on: cases whose results
    are there, of the same options and files, are not computed again.
    """
    shared = Request(
        "", model=model, methods=methods, seeds=seeds,
        calibrate=calibrate, conditioned=conditioned,
    )  # fmt: skip
    cases = read_cases(listed, shared)
    # Check the options that all cases share before the first record is read.
    setups.options_of(model, 1)
    if methods is not None:
        with_variants(setups.names(methods), calibrate, conditioned)
    _check_out(out, listed, cases)
    with workers(jobs, cluster) as work:
        cores = work.cores
    side_by_side = cases_at_once(len(cases), cores, at_once, available_cores() if cluster else None)
    rows = _rows(cases, out, cores, cluster, side_by_side)
    _save(rows, out, command_of(context))
    _show(rows, out)


def _check_out(out: Path, listed: Path, cases: Sequence[Case]) -> None:
    """Raise ValueError if the results would replace the list or a file that it names."""
    inputs = {path: f"{listed}, case {case.name}" for case in cases for path in case.files.values()}
    targets = [
        path for folder in (out, *(out / c.name for c in cases)) for path in replaced(folder)
    ]
    refuse_inputs(out, targets, inputs | {listed: "LIST"})


def cases_at_once(cases: int, cores: int, asked: int | None, commanding: int | None = None) -> int:
    """Return how many cases run in parallel, each in a process that holds its record.

    Parameters
    ----------
    cases : Number of cases.
    cores : Cores that train, shared by all cases.
    asked : Value of --at-once; None if it is not given.
    commanding : Cores of this machine, which runs the processes, if a cluster trains.
    """
    most = cores if commanding is None else PROCESSES_OF_A_CORE * commanding
    return max(1, min(cases, asked or min(cores // CORES_OF_A_CASE, most)))


def _rows(
    cases: Sequence[Case], out: Path, cores: int, cluster: str | None, at_once: int
) -> list[report.Row]:
    """Compare all cases, `at_once` in parallel; return their rows in the order of the list."""
    share, starting = -(-cores // at_once), None
    if at_once > 1:
        starting = clock.starting()
        # On Ctrl-C Python's resource tracker, a process that inherits this environment, would warn
        # of semaphores that ended processes have left.
        before = os.environ.get("PYTHONWARNINGS")
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, "ignore:resource_tracker"]))
        showing.console.print(f"{at_once} cases at once, each on {share} of {cores} cores")
    rows: dict[str, report.Row] = {}
    for row in map_jobs(partial(_compared, out, share, cluster, starting), cases, at_once):
        rows[row.name] = row
        short = row.note
        if not row.failed:
            short = f"{row.recommended}, fit {number(row.fit)} %, {row.seconds:.0f} s"
        showing.console.print(f"{len(rows)} of {len(cases)}, {row.name}: {short}")
    return [rows[case.name] for case in cases]


def _compared(
    out: Path,
    cores: int,
    cluster: str | None,
    starting: float | None,
    case: Case,
    _: Callable[[Any], None],
) -> report.Row:
    """Compare one case, in the command's process or in a worker process.

    `starting` is the seconds that the command took to load; None in the command's process.
    """
    if starting is not None:
        clock.begin_again(starting)
        showing.console.quiet = True
    # A lost scheduler ends the whole command, not only this case.
    with workers(None if cluster else cores, cluster) as work:
        return _row(case, out / case.name, replace(work, jobs=cores))


def _row(case: Case, folder: Path, work: Work) -> report.Row:
    """Return the row of a case: the stored one, or else compare the case now."""
    try:
        with locked(folder):  # `compare` may be writing to it
            identity = case.identity()
            found = _finished(case.name, folder, identity)
            if found is not None:
                return found
            began = now()
            result = compared(planned(case.request, work.cores), work, folder, case.name, began)
            facts = {"command": "benchmark", **identity, "seconds": now() - began}
            save(result, folder, facts)
            return report.Row.of(case.name, _read(folder))
    except ConnectionError:
        raise  # without the cluster no case can go on
    except Exception as error:  # an error in one case does not stop the others
        return report.Row(case.name, failed=in_words(error))


def _finished(name: str, folder: Path, identity: dict[str, Any]) -> report.Row | None:
    """Return the stored row of a case; None if its results are missing, outdated or damaged."""
    try:
        facts = _read(folder)
        if not json.loads(json.dumps(identity)).items() <= facts.items():
            return None
        row = report.Row.of(name, facts)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    # Checkpoints remain if the command was killed just before it removed them.
    shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)
    return row


def _read(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / FACTS).read_text(encoding="utf-8"))
    return found


def _save(rows: Sequence[report.Row], out: Path, facts: dict[str, Any]) -> None:
    facts |= {"summary": report.summary(rows), "cases": [row.as_json() for row in rows]}
    with staged(out) as new:
        _, table_file, page_file = (new / name for name in OVERALL)
        with replacing(table_file) as temporary:
            report.table(rows).to_csv(temporary)
        document.of_rows(rows, page_file, usage("benchmark", facts["arguments"]))
        write_facts(new, facts | {"environment": environment()})


def _show(rows: Sequence[report.Row], out: Path) -> None:
    showing.console.print(_table(rows))
    found = report.summary(rows)
    if found["failed"] == found["cases"]:
        raise ValueError(f"no case could be compared; {rows[0].name}: {rows[0].failed}")
    said = [
        f"the recommended method was the best one in {found['recommended_is_best']} of "
        f"{found['with_regret']}"
    ]
    for what, key in (
        ("median fit %", "median_fit"),
        ("median regret", "median_regret"),
        ("worst regret", "worst_regret"),
        ("median error", "median_error"),
    ):
        said += [] if found[key] is None else [f"{what} {found[key]:.3g}"]
    said += [f"{found['failed']} failed"] if found["failed"] else []
    showing.console.print("; ".join(said))
    showing.console.print(f"results and table: {out}/, and of each case in its folder")
    showing.results_of(out)


def _table(rows: Sequence[report.Row]) -> Table:
    title = "errors of the median over seeds, as multiples of the standard deviation"
    table = Table(title=title, title_justify="left", title_style="bold")
    shown = [c for c in report.COLUMNS if any(c.entry(row) for row in rows)]
    for column in shown:
        table.add_column(
            column.heading,
            justify="left" if column.show is None else "right",
            overflow="fold" if column is shown[0] else "ellipsis",
        )
    for row in rows:
        table.add_row(*(column.entry(row) for column in shown))
    return table
