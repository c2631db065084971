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
from splitband.evaluation.setup import default_names


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
            help="Samples to predict beyond the training part.",
            show_default="all",
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            help="What to compare, separated by commas; `splitband methods` lists what there is.",
            # With spaces, so that it is wrapped and not cut off.
            show_default=f"{', '.join(default_names(False))}; with a simulator "
            f"{', '.join(default_names(True))}; with --inputs linear, too",
        ),
    ] = None,
    seeds: Seeds = None,
    jobs: Jobs = None,
    out: Annotated[Path, typer.Option(help="Folder for results and pictures.")] = Path("out"),
    calibrate: Calibrate = False,
    conditioned: Conditioned = False,
    settings: SettingsFile = None,
    cluster: Cluster = None,
) -> None:
    """Compare models of a record with each other and with naive baselines.

    Every method is fitted on the first --train samples only and predicts under two protocols:
    "from the start" warms up on the first samples and simulates to the end of the record;
    "forecast" warms up on the last training samples and simulates beyond them. The table shows the
    RMSE of the free run over everything after the warm-up, in the record's unit.

    The recommended method is chosen on training samples only. Fitted on three quarters of them, it
    forecasts the rest best, from several beginnings (the table shows that error as "held out").
    Where what it forecast then of the time after the training part changes by more than that error
    explains once it is fitted on all of them, the change counts in the error's place (the table
    shows by how much it "changed"). The held-out errors also give each forecast an interval in
    which nine tenths of the measured samples should lie; the table says how many do.

    With --test every method is fitted to all of RECORD and warmed up on the first samples of the
    test record, to simulate it to its end; the table shows the RMSE of the seeds' mean there.

    OUT gets results.json, predictions.csv, pictures, report.html, and where a network is
    recommended recommended.json, with which `fit` and `forecast` train it as it was trained here
    (--settings). For each --test there is predictions-test-1.csv and so on; tests.png shows the
    errors there, each channel by itself.

    --calibrate and --conditioned add rows: each method that can be is also run that way.

    With --settings networks are trained as the recommended network of an earlier comparison;
    without --methods that network alone is compared, beside the baselines.
    """
    request = Request(
        record, reading, simulator, further, testing, model,
        train, horizon, methods, seeds, calibrate, conditioned, settings,
    )  # fmt: skip
    with worker_pool(jobs, cluster) as workers:
        result = carried_out(planned(request, workers.cores), workers, out)
    facts = {"command": context.info_name, "arguments": arguments(context.params)}
    used = save(result, out, facts)
    show(result, out, used)
