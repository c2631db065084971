"""`splitband tune`."""

from __future__ import annotations

import math
import shutil
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from splitband.cli import naming, setups, showing
from splitband.cli.comparing import Request, arguments, prepared
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Device, ModelOptions, Warmup
from splitband.cli.options.records import FurtherRecords, RecordArgument, RecordOptions, Train
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.options.workers import Cluster, Jobs
from splitband.cli.simulators import refuse_bases
from splitband.cli.worker_pool import worker_pool
from splitband.evaluation.trials import StudyTrial, hidden
from splitband.evaluation.tuned import FILE
from splitband.evaluation.tuning import Effort, Tuning
from splitband.evaluation.tuning import tune as search_settings
from splitband.forecasters.names import TRAINED
from splitband.report import tuning as report
from splitband.runtime.files import CHECKPOINTS

SHOWN = 5
"""Trials in the table."""

Trials = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="How many trials, with those that --storage has already.",
        show_default="as many as --budget allows",
    ),
]
TimeBudget = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="How long trials are begun and run, such as 90s, 10m or 1h; the first one may take "
        "longer.",
        show_default="10m, with --trials no limit",
    ),
]
Storage = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="A database that keeps the trials: sqlite:///tune.db, postgresql://USER@HOST/NAME. "
        "The same command goes on with what is there, and on several machines at once they share "
        "the work.",
        show_default="a file in --out until the results are there",
    ),
]


@with_groups
def tune(
    context: typer.Context,
    record: RecordArgument,
    reading: RecordOptions,
    simulator: SimulatorOptions,
    further: FurtherRecords,
    train: Train = None,
    methods: Annotated[
        str | None,
        typer.Option(
            help="Networks to search, separated by commas; `splitband methods` lists them.",
            show_default="every kind with a GRU that the record has what it needs for",
        ),
    ] = None,
    trials: Trials = None,
    budget: TimeBudget = None,
    storage: Storage = None,
    seed: Annotated[int, typer.Option(min=0, max=2**31 - 1, help="Of what is tried.")] = 0,
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder for settings, results, pictures.")] = Path(
        "tuned"
    ),
    warmup: Warmup = None,
    device: Device = "cpu",
    cluster: Cluster = None,
) -> None:
    """Search for the network and the settings that forecast held-out training samples best.

    Kind of model, sizes, windows, training, cut-off, order and down-sampling are tried together.
    Each trial is trained on the first three quarters of the training part and forecasts the rest of
    it from several beginnings, then likewise on shorter parts of it; what trails is given up. The
    first trials are the default recipe. No sample after --train is looked at.

    OUT gets settings.json, which `compare`, `fit` and `forecast` take by --settings, results.json
    with all trials, history.png and importances.png.
    """
    refuse_bases(simulator, "tune, whose --methods name it")
    seconds = None if budget is None else setups.seconds(budget)
    effort = Effort(trials, seconds, seed, storage)
    model = ModelOptions(warmup=warmup, device=device)
    setups.check_model_options(model)
    if cluster is not None and storage is None:
        raise ValueError(
            "--storage must be given with --cluster: an address that its workers reach, too"
        )
    request = Request(
        record, reading, simulator, further, model=model, train=train, methods=methods
    )
    names = None if methods is None else naming.names(methods)
    if names is not None:
        naming.check_names("--methods", names, TRAINED)
    with worker_pool(jobs, cluster) as workers:
        task = prepared(request, workers.cores, ahead=0)
        with showing.progress("tuning") as progress:
            result = search_settings(
                task.record,
                methods=names,
                others=task.others,
                effort=effort,
                setup=task.setup,
                work=workers.work(progress, out),
                device=device,
            )
    given_values = arguments(context.params)
    if storage is not None:
        given_values["storage"] = hidden(storage)
    report.save(result, out, {"command": context.info_name, "arguments": given_values})
    shutil.rmtree(out / CHECKPOINTS, ignore_errors=True)
    _say(result, record, out)


def _say(result: Tuning, record: str, out: Path) -> None:
    showing.console.print(_table(result))
    best, default = result.best, result.default
    given_up = sum(each.value is None for each in result.attempts)
    said = f"{len(result.attempts)} trials, {given_up} of them given up or failed"
    if default is None:
        said += "; the default recipe failed"
    elif not result.improved:
        said += "; nothing better than the default recipe was found"
    else:
        assert best.value is not None
        assert default.value is not None
        less = 1 - best.value / default.value
        said += f"; held-out error {less:.0%} lower than by the default recipe"
    showing.console.print(said)
    showing.console.print(
        f"settings: {out / FILE}; to use them: splitband compare {record} ... --settings "
        f"{out / FILE}\nresults and pictures: {out}/"
    )
    showing.results_file(out / "results.json")


def _table(result: Tuning) -> Table:
    """The best trials, and the default recipe."""
    table = Table(
        title=f"{result.record.name}: error on held-out parts of {len(result.record)} training "
        "samples, channels scaled to deviation 1",
        title_justify="left",
        title_style="bold",
    )
    shown = result.ranked[:SHOWN]
    if result.default is not None and result.default not in shown:
        shown.append(result.default)
    table.add_column("trial")
    table.add_column("held out", justify="right")
    table.add_column("by part", justify="right")
    longest = max(len(each.tuned.method) for each in shown if each.tuned is not None)
    table.add_column("method", min_width=longest)
    table.add_column("settings", style="dim", overflow="fold")
    table.add_column("seconds", justify="right")
    for each in shown:
        table.add_row(*_cells(each), style="bold" if each is result.best else "")
    return table


def _cells(attempt: StudyTrial) -> list[str]:
    assert attempt.tuned is not None
    scores = " ".join(f"{score:.3g}" for score in attempt.scores)
    value = math.nan if attempt.value is None else attempt.value
    label = f"{attempt.number}{' (default)' if attempt.usual else ''}"
    tuned = attempt.tuned
    return [label, f"{value:.3g}", scores, tuned.method, tuned.in_words(),
            f"{attempt.seconds:.0f}"]  # fmt: skip
