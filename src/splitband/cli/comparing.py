"""From the options of a comparison to its results, for every command that compares."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splitband.cli import devices, naming, records, setups, showing, timing
from splitband.cli.options.models import AUTO, ModelOptions
from splitband.cli.options.records import FurtherRecords, RecordOptions, TestRecords
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.simulators import each_with_simulator, tests_with_simulator, with_simulator
from splitband.cli.usage import usage
from splitband.cli.worker_pool import WorkerPool
from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.comparison import compare as compare_forecasters
from splitband.evaluation.protocols import check
from splitband.evaluation.selection import check_trial
from splitband.evaluation.setup import Setup, default_names, trying_bases, usual_names
from splitband.forecasters.names import BASES, NAMES, TRAINED, with_base, with_variants
from splitband.report import results
from splitband.report.page.usage import Usage
from splitband.runtime.files import CHECKPOINTS, output_folder


@dataclass(frozen=True)
class Request:
    """The options of `splitband compare`, but for where its results go."""

    record: str
    reading: RecordOptions = field(default_factory=RecordOptions)
    simulator: SimulatorOptions = field(default_factory=SimulatorOptions)
    further: FurtherRecords = field(default_factory=FurtherRecords)
    testing: TestRecords = field(default_factory=TestRecords)
    model: ModelOptions = field(default_factory=ModelOptions)
    train: int | None = None
    horizon: int | None = None
    methods: str | None = None
    seeds: int | None = None
    calibrate: bool = False
    conditioned: bool = False
    settings: Path | None = None


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be compared on what.

    Attributes
    ----------
    record, setup : See `evaluation.comparison.compare`.
    names : Of the methods.
    others : Further records to train on.
    tests : Records to test on.
    device : Of the networks.
    """

    record: Record
    names: list[str]
    setup: Setup
    others: list[Record]
    tests: list[Record]
    device: str


def prepared(request: Request, cores: int, ahead: int | None = None) -> Task:
    """The records and simulators that the options name, and the settings they come to.

    `cores` are what a budget is spent on; `ahead` samples at least must follow the training part,
    by default one, unless there are tests.
    """
    reading, simulator = request.reading, request.simulator
    saved = setups.load_settings(request.settings, request.model)
    trajectory = records.load_record(request.record, reading, saved)
    hybrid = simulator.simulator is not None or trajectory.y_sim is not None
    by_default = default_names(hybrid, trajectory.nu > 0)
    if saved is not None:
        by_default = [saved.method, *(name for name in by_default if name not in TRAINED)]
    asked = by_default if request.methods is None else naming.method_names(request.methods)
    chosen = with_variants(asked, request.calibrate, request.conditioned)
    based = simulator.simulator in BASES
    if simulator.simulator in BASES:
        chosen = with_base(chosen, simulator.simulator)
    beyond = any(NAMES[method].calibrates for method in chosen)
    trajectory = with_simulator(trajectory, simulator, reading, beyond=beyond)
    tested = bool(request.testing.test)
    ahead = 1 - tested if ahead is None else ahead
    setup = setups.setup(
        request.record, trajectory, request.train, request.model, chosen, ahead, tested,
        cores, saved,
    )  # fmt: skip
    if request.methods is None and saved is None and not based:
        usual = usual_names(trajectory, setup)
        chosen = with_variants(usual, request.calibrate, request.conditioned)
        setup = trying_bases(setup)
    if request.horizon is not None:
        if setup.train + request.horizon > len(trajectory):
            raise ValueError(
                f"--horizon must end within the record: at most {len(trajectory) - setup.train} "
                f"samples after the {setup.train} of --train, got {request.horizon}"
            )
        trajectory = trajectory[: setup.train + request.horizon]
    others = records.load_further(request.further.more, "--more", trajectory, reading)
    others = each_with_simulator(others, chosen, request.further, simulator, reading)
    tests = records.load_further(request.testing.test, "--test", trajectory, reading)
    tests = tests_with_simulator(tests, request.testing, simulator, reading)
    return Task(trajectory, chosen, setup, others, tests, request.model.device)


def carried_out(
    task: Task,
    seeds: int | None,
    workers: WorkerPool,
    out: Path,
    label: str = "comparing",
    began: float | None = None,
) -> Comparison:
    """The comparison; what is cut off goes on from checkpoints in the folder `out`.

    `label` stands beside the progress bar. A budget of time counts from when it `began`, by default
    from when the command did.
    """
    record, setup, others, tests = task.record, task.setup, task.others, task.tests
    methods = [devices.on_device(setup.forecaster(name), task.device) for name in task.names]
    naming.check_needs(methods, record)
    check(record, methods, setup, others, tests)
    check_trial(record, methods, setup, others)
    output_folder(out, "--out")
    numbers = (len(record) + sum(map(len, tests))) * record.ny * 2 * len(methods)
    plan = timing.planned(setup, workers.cores, numbers, began)
    with showing.progress(label, plan, showing.kept(out / CHECKPOINTS)) as progress:
        return compare_forecasters(
            record,
            methods=methods,
            others=others,
            tests=tests,
            seeds=seeds,
            setup=setup,
            work=workers.work(progress, out, plan),
        )


def save(comparison: Comparison, out: Path, facts: Mapping[str, Any]) -> Usage:
    """Write the results, `facts` first, in place of the checkpoints; return what the page shows.

    That is the commands that use the recommended method, from the options among the facts
    (`arguments`).
    """
    record = comparison.record
    method, driven = comparison.recommended, record.nu > 0
    found = results.found_in(comparison.forecaster(), out)
    used = usage(facts["command"], facts["arguments"], method, driven, record.name, found)
    results.save(comparison, out, dict(facts), used)
    shutil.rmtree(out / CHECKPOINTS)
    return used


def arguments(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of options as JSON can hold them."""
    return {
        name: str(value) if isinstance(value, Path) else "auto" if value == AUTO else value
        for name, value in values.items()
    }
