"""From the options of a comparison to its results, for every command that compares."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from splitband.cli import devices, naming, records, setups, showing, timing
from splitband.cli.options.models import AUTO, ModelOptions
from splitband.cli.options.records import FurtherRecords, RecordOptions, TestRecords
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.simulators import (
    adjustable,
    each_with_simulator,
    tests_with_simulator,
    with_own_parameters,
    with_simulator,
)
from splitband.cli.usage import usage
from splitband.cli.worker_pool import WorkerPool
from splitband.data import Record
from splitband.data.named import RECORDS
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.plan import Plan, check_train, plan
from splitband.evaluation.run import run
from splitband.evaluation.saved_settings import SavedSettings
from splitband.evaluation.setup import default_names
from splitband.forecasters.names import (
    BASES,
    GREY_BOX,
    NAMES,
    TRAINED,
    named,
    with_base,
    with_variants,
)
from splitband.report import results
from splitband.report.page.usage import Usage
from splitband.runtime.files import CHECKPOINTS, output_folder


@dataclass(frozen=True)
class Request:
    """The options of a command that fits methods to a record, but for where its results go."""

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
    future_inputs: Path | None = None
    refit: bool = False


def planned(request: Request, cores: int, steps: int = 0, fitting: bool = False) -> Plan:
    """Read the records and simulators that the options name, and plan what is to be done with them.

    Parameters
    ----------
    request : The options.
    cores : What a budget is spent on.
    steps : Samples to forecast beyond the end of the record, all of which is trained on.
    fitting : Nothing is forecast; by default, all of the record is trained on.
    """
    request = replace(request, simulator=with_own_parameters(request.simulator))
    reading, simulator = request.reading, request.simulator
    saved = setups.load_settings(request.settings, request.model)
    record = records.load_record(request.record, reading, saved)
    names = _names(request, record, saved)
    hybrid = _beside_simulator(request, record)
    expected = names or default_names(hybrid, record.nu > 0)
    beyond = any(NAMES[method].calibrates for method in expected)
    past = steps if hybrid and simulator.simulator not in BASES else 0
    fitted = adjustable(simulator)
    record = with_simulator(record, simulator, reading, past, beyond)
    if steps:
        u = records.inputs_ahead(request.future_inputs, record, steps, reading.time_column)
        record = replace(record, u_beyond=u)
    naming.check_needs([named(name) for name in expected], record)
    others = records.load_further(request.further.more, "--more", record, reading)
    others = each_with_simulator(others, expected, request.further, simulator, reading)
    tests = records.load_further(request.testing.test, "--test", record, reading)
    tests = tests_with_simulator(tests, request.testing, simulator, reading)
    initial = request.testing.initial
    if initial is not None and not tests:
        raise ValueError(f"--initial must be used with --test, got {initial}")
    train = len(record) if steps else request.train
    if fitting:
        train = len(record) if train is None else train
        check_train(record, train, 0)
        record = record[:train]
    if train is None and not tests and request.record in RECORDS:
        train = RECORDS[request.record].train
    found = plan(
        record,
        train,
        names,
        horizon=0 if fitting else steps or request.horizon,
        others=others,
        tests=tests,
        seeds=request.seeds,
        setup=replace(
            setups.options_of(request.model, cores, saved), simulator=fitted, initial=initial
        ),
        refit=request.refit,
    )
    device = request.model.device
    return replace(found, methods=tuple(devices.on_device(m, device) for m in found.methods))


def _beside_simulator(request: Request, record: Record) -> bool:
    """Whether methods read a simulator's output beside the record."""
    if request.simulator.parameters is not None:
        return False
    return request.simulator.simulator is not None or record.y_sim is not None


def _names(request: Request, record: Record, saved: SavedSettings | None) -> list[str] | None:
    """The methods that the options ask for; None where they do not."""
    base = request.simulator.simulator
    if request.methods is not None:
        names = naming.method_names(request.methods)
    elif saved is None and not (request.calibrate or request.conditioned or base in BASES):
        return None
    else:
        names = default_names(base is not None or record.y_sim is not None, record.nu > 0)
        if saved is not None:
            names = [saved.method, *(name for name in names if name not in TRAINED)]
    names = with_variants(names, request.calibrate, request.conditioned)
    if request.simulator.parameters is not None:
        return with_base(names, GREY_BOX)
    return with_base(names, base) if base in BASES else names


def carried_out(
    planned: Plan,
    workers: WorkerPool,
    out: Path,
    label: str = "comparing",
    began: float | None = None,
) -> Comparison:
    """The comparison; what is cut off goes on from checkpoints in the folder `out`.

    `label` stands beside the progress bar. A budget of time counts from when it `began`, by default
    from when the command did.
    """
    output_folder(out, "--out")
    record, tests = planned.record, planned.tests
    numbers = (len(record) + sum(map(len, tests))) * record.ny * 2 * len(planned.methods)
    time = timing.planned(planned.setup, workers.cores, numbers, began)
    with showing.progress(label, time, showing.kept(out / CHECKPOINTS)) as progress:
        return run(planned, workers.work(progress, out, time))


def save(comparison: Comparison, out: Path, facts: Mapping[str, Any]) -> Usage:
    """Write the results, `facts` first, in place of the checkpoints; return what the page shows.

    That is the commands that use the recommended method, from the options among the facts
    (`arguments`).
    """
    used = usage(facts["command"], facts["arguments"], out, comparison.plan, comparison.model)
    results.save(comparison, out, dict(facts), used)
    shutil.rmtree(out / CHECKPOINTS)
    return used


def arguments(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of options as JSON can hold them."""
    return {
        name: str(value) if isinstance(value, Path) else "auto" if value == AUTO else value
        for name, value in values.items()
    }
