"""`splitband compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from splitband.cli.comparing import Request, arguments, carried_out, planned, save
from splitband.cli.options.groups import with_groups
from splitband.cli.options.models import Conditioned, ModelOptions, Seeds, SettingsFile
from splitband.cli.options.records import (
    FurtherRecords,
    RecordArgument,
    RecordOptions,
    TestRecords,
    Train,
)
from splitband.cli.options.simulators import Calibrate, SimulatorOrBaseOptions
from splitband.cli.options.workers import Cluster, Jobs
from splitband.cli.outcome import show
from splitband.cli.worker_pool import worker_pool


@with_groups
def compare(
    context: typer.Context,
    record: RecordArgument,
    reading: RecordOptions,
    simulator: SimulatorOrBaseOptions,
    further: FurtherRecords,
    testing: TestRecords,
    model: ModelOptions,
    train: Train = None,
    horizon: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Samples to predict after the training part.",
            show_default="all",
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Methods, separated by commas; see splitband methods.",
            show_default="what suits the record",
        ),
    ] = None,
    seeds: Seeds = None,
    jobs: Jobs = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for results, pictures and page.")
    ] = Path("out"),
    calibrate: Calibrate = False,
    conditioned: Conditioned = False,
    refit: Annotated[
        bool,
        typer.Option(
            "--refit", help="Fit the recommended method to the whole record for OUT/model."
        ),
    ] = False,
    settings: SettingsFile = None,
    cluster: Cluster = None,
) -> None:
    """Compare models of a record, and recommend one.

    Every method is trained on the first --train samples and predicts the rest, and with --test
    other records. The table shows fit % and RMSE. OUT gets a page to send on (report.html),
    pictures, predictions and results.json.

    The recommended method is chosen on training samples only: trained on three quarters of them,
    it predicts the last quarter best. An interval around its forecast should hold 90 % of what is
    measured.

    OUT/model is the recommended method as it was trained, for `splitband simulate`; --refit trains
    it on the whole record.

    --budget or --effort limit the search for how to train; --window, --epochs, --learning-rate,
    --lr-milestones and --recipe paper replace it. --calibrate and --conditioned add rows.
    """
    request = Request(
        record, reading, simulator, further, testing, model,
        train, horizon, methods, seeds, calibrate, conditioned, settings, refit=refit,
    )  # fmt: skip
    with worker_pool(jobs, cluster) as workers:
        result = carried_out(planned(request, workers.cores), workers, out)
    facts = {"command": context.info_name, "arguments": arguments(context.params)}
    used = save(result, out, facts)
    show(result, out, used)
