"""`splitband benchmark`."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from splitband.cli import clock, in_words, naming, setups, showing
from splitband.cli.cases import COLUMNS, OVERALL, Case, read_cases
from splitband.cli.comparing import Request, arguments, carried_out, planned, save
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Conditioned, ModelOptions, Seeds
from splitband.cli.options.simulators import Calibrate
from splitband.cli.options.workers import Cluster, Jobs
from splitband.cli.output import refuse_inputs, replaced
from splitband.cli.usage import usage
from splitband.cli.worker_pool import WorkerPool, cases_at_once, worker_pool
from splitband.report import benchmark as report
from splitband.report import page, pictures, results
from splitband.runtime.deadlines import now
from splitband.runtime.files import CHECKPOINTS, replacing
from splitband.runtime.outputs import locked, staged, write_facts
from splitband.runtime.processes import over
from splitband.runtime.threads import available_cores


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
    methods: Annotated[
        str | None,
        typer.Option(
            help="What to compare, separated by commas; `splitband methods` lists what there is.",
            show_default="for each case what `compare` takes",
        ),
    ] = None,
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
    of this command hold for all cases; a warm-up in the list comes before --warmup.

    OUT/NAME has for each case what `compare` writes. The table over all of them (table.csv,
    results.json, cases.png, report.html) has the error of the recommended method, on the test
    records where there are any, else of the forecast, as a multiple of the record's standard
    deviation; which method was the best; the regret, which is the recommended method's error over
    the best one's; and how much of the forecast was in its interval.

    A case that fails has a row that says why. Given again, the command goes on: cases whose results
    are there, of the same options and files, are not computed again.
    """
    request = Request(
        "", model=model, methods=methods, seeds=seeds,
        calibrate=calibrate, conditioned=conditioned,
    )  # fmt: skip
    cases = read_cases(listed, request)
    if methods is not None:
        naming.method_names(methods)
    setups.check_model_options(model)
    _check_out(out, listed, cases)
    with worker_pool(jobs, cluster) as workers:
        cores = workers.cores
    commanding = None if cluster is None else available_cores()
    side_by_side = cases_at_once(len(cases), cores, at_once, commanding)
    rows = _rows(cases, out, side_by_side, _Workers(cores, cluster))
    _save(rows, out, {"command": context.info_name, "arguments": arguments(context.params)})
    _say(rows, out)


def _check_out(out: Path, listed: Path, cases: Sequence[Case]) -> None:
    """Raise ValueError where the results of a case would replace a file of the list."""
    inputs = {path: f"{listed}, case {case.name}" for case in cases for path in case.files.values()}
    targets = [path for case in cases for path in replaced("compare", out / case.name)]
    refuse_inputs(out, [*replaced("benchmark", out), *targets], inputs | {listed: "LIST"})


@dataclass(frozen=True)
class _Workers:
    """The workers that all cases share.

    Attributes
    ----------
    cores : Trainings at once, of all cases together.
    cluster : Address of the scheduler whose workers they are; None for this machine.
    """

    cores: int
    cluster: str | None


def _rows(cases: Sequence[Case], out: Path, at_once: int, workers: _Workers) -> list[report.Row]:
    """Compare all cases, so many at once; return their rows in the order of the list."""
    share = replace(workers, cores=-(-workers.cores // at_once))
    starting = None
    if at_once > 1:
        starting = clock.starting()
        _silence_tracker()
        showing.console.print(
            f"{at_once} cases at once, each on {share.cores} of {workers.cores} cores"
        )
    rows: dict[str, report.Row] = {}
    for row in over(partial(_compared, out, share, starting), cases, at_once):
        rows[row.name] = row
        showing.console.print(f"{len(rows)} of {len(cases)}, {row.name}: {_in_short(row)}")
    return [rows[case.name] for case in cases]


def _silence_tracker() -> None:
    """Keep Python from warning on Ctrl-C of semaphores that ended processes have left.

    Its resource tracker, which removes them, is a process that begins with this environment.
    """
    before = os.environ.get("PYTHONWARNINGS")
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [before, "ignore:resource_tracker"]))


def _compared(
    out: Path, share: _Workers, starting: float | None, case: Case, _: Callable[[Any], None]
) -> report.Row:
    """Compare one case, in this process or in one of those for cases (where `starting` is given).

    `starting` is how many seconds the command took to load.
    """
    if starting is not None:
        clock.begin_again(starting)
        showing.console.quiet = True
    # A scheduler that is gone ends the command, not the case.
    with worker_pool(None if share.cluster else share.cores, share.cluster) as workers:
        return _row(case, out / case.name, replace(workers, cores=share.cores))


def _row(case: Case, folder: Path, workers: WorkerPool) -> report.Row:
    """The result of a case that is there, or that is computed now."""
    try:
        with locked(folder):  # `compare` may be at work there, too
            identity = case.identity()
            found = _finished(case.name, folder, identity)
            if found is not None:
                return found
            began, plan = now(), planned(case.request, workers.cores)
            result = carried_out(plan, workers, folder, case.name, began)
            facts = {"command": "benchmark", **identity, "seconds": now() - began}
            save(result, folder, facts)
            return report.Row.of(case.name, _read(folder))
    except ConnectionError:
        raise  # without its cluster no case goes on
    except Exception as error:  # whatever is wrong with one case, the others go on
        return report.Row(case.name, failed=in_words(error))


def _finished(name: str, folder: Path, identity: dict[str, Any]) -> report.Row | None:
    """The row of a case whose results are there; None where they are others', or damaged."""
    try:
        facts = _read(folder)
        if not json.loads(json.dumps(identity)).items() <= facts.items():
            return None
        row = report.Row.of(name, facts)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    # They are still there where the command was killed just before it removed them.
    shutil.rmtree(folder / CHECKPOINTS, ignore_errors=True)
    return row


def _read(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    return found


def _save(rows: Sequence[report.Row], out: Path, facts: dict[str, Any]) -> None:
    facts |= {"summary": report.summary(rows), "cases": [row.as_json() for row in rows]}
    with staged(out) as new:
        _, table_file, picture_file, page_file = (new / name for name in OVERALL)
        with replacing(table_file) as temporary:
            report.table(rows).to_csv(temporary)
        pictures.save(report.picture(rows), picture_file)
        page.of_rows(rows, page_file, usage("benchmark", facts["arguments"]))
        write_facts(new, facts | {"environment": results.environment()})


def _say(rows: Sequence[report.Row], out: Path) -> None:
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
    showing.console.print(f"results, table and picture: {out}/, and of each case in its folder")
    showing.console.print(f"page: {out / page.NAME}")
    showing.results_file(out / OVERALL[0])


def _table(rows: Sequence[report.Row]) -> Table:
    table = Table(
        title="errors of the mean over seeds, as multiples of the standard deviation",
        title_justify="left",
        title_style="bold",
    )
    table.add_column("case", overflow="fold")
    table.add_column("of")
    table.add_column("fit %", justify="right")
    for heading in ("recommended", "best"):
        table.add_column(heading)
    for heading in ("error", "regret", "in interval", "seconds"):
        table.add_column(heading, justify="right")
    noted = any(row.note for row in rows)
    if noted:
        table.add_column("note", style="dim")
    for row in rows:
        table.add_row(
            row.name, row.protocol, "-" if row.fit is None else f"{row.fit:.1f}",
            row.recommended, row.best,
            _number(row.error), _number(row.regret),
            "-" if row.held is None else f"{row.held:.0%}",
            "-" if row.seconds is None else f"{row.seconds:.0f}",
            *([row.note] if noted else []),
        )  # fmt: skip
    return table


def _in_short(row: report.Row) -> str:
    if row.failed:
        return row.note
    return f"{row.recommended}, fit {_number(row.fit)} %, {row.seconds:.0f} s"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
