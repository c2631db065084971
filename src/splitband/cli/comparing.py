"""Plan what the options of a command ask for, and carry it out, for all commands that fit."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from splitband.cli import clock, records, setups, showing
from splitband.cli.options.groups import panel
from splitband.cli.options.models import (
    AUTO,
    Conditioned,
    Methods,
    ModelOptions,
    Seeds,
    SettingsFile,
)
from splitband.cli.options.records import (
    FurtherRecords,
    RecordArgument,
    RecordOptions,
    TestRecords,
)
from splitband.cli.options.simulators import Calibrate, SimulatorOptions, SimulatorOrBaseOptions
from splitband.cli.simulators import adjustable, load_further, with_own_parameters, with_simulator
from splitband.cli.usage import usage
from splitband.data import Record
from splitband.data.named import RECORDS
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.run import run
from splitband.evaluation.saved_settings import SavedSettings
from splitband.evaluation.setup import default_names
from splitband.evaluation.work import Work
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASES, GREY_BOX, TRAINED, named, with_base, with_variants
from splitband.report import results
from splitband.report.page.parts import Usage
from splitband.runtime.cluster import Cluster, silence
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.threads import available_cores

WRITING, AS_STARTING = 2.0, 1.5
"""Estimated time to write pictures and page: seconds, plus a multiple of the command's start-up
time, which measures how fast and how busy the machine is. By eye, checked against `python -m
benchmarks.budget`."""
NUMBER, USUAL_START = 3e-6, 3.0
"""Seconds to write a number of a table if a command starts within `USUAL_START` s. By eye."""
MOST = 0.4
"""Largest share of a budget that is reserved for writing results. By eye."""


@dataclass(frozen=True)
class Request:
    """Hold the options of `compare`, except those for its results, cores and cluster."""

    record: RecordArgument
    reading: RecordOptions = field(default_factory=RecordOptions)
    simulator: SimulatorOrBaseOptions = field(default_factory=SimulatorOrBaseOptions)
    further: FurtherRecords = field(default_factory=FurtherRecords)
    testing: TestRecords = field(default_factory=TestRecords)
    model: ModelOptions = field(default_factory=ModelOptions)
    train: Annotated[
        int | None, panel("Record")("Train on the first N samples.", "N", "three quarters")
    ] = None
    horizon: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Samples to predict after the training part.",
            show_default="all",
        ),
    ] = None
    methods: Methods = None
    seeds: Seeds = None
    calibrate: Calibrate = False
    conditioned: Conditioned = False
    refit: Annotated[
        bool,
        typer.Option(
            "--refit", help="Fit the recommended method to the whole record for OUT/model."
        ),
    ] = False
    settings: SettingsFile = None


def planned(
    asked: Request,
    cores: int,
    steps: int = 0,
    future_inputs: Path | None = None,
    fitting: bool = False,
) -> Plan:
    """Read the records and simulators that the options name, and return the plan for them.

    Parameters
    ----------
    asked : The options.
    cores : Cores on which a budget is spent.
    steps, future_inputs : Samples to forecast beyond the record, all of which is training data, and
        the file of the inputs there.
    fitting : Fit a single method, by default to the whole record, and forecast nothing.
    """
    reading, simulator = asked.reading, with_own_parameters(asked.simulator)
    saved = setups.load_settings(asked.settings, asked.model)
    options = setups.options_of(asked.model, cores, saved)
    record = records.load_record(asked.record, reading, saved)
    hybrid = simulator.parameters is None and (
        simulator.simulator is not None or record.y_sim is not None
    )
    names = _names(replace(asked, simulator=simulator), record, saved, fitting)
    expected = [named(name) for name in names or default_names(hybrid, record.nu > 0)]
    calibrates = any(method.calibrates for method in expected)
    fitted = adjustable(simulator)
    past = steps if hybrid and simulator.simulator not in BASES else 0
    if steps:
        u = records.inputs_ahead(future_inputs, record, steps, reading)
        record = replace(record, u_beyond=u)
    record = with_simulator(record, simulator, reading, past, calibrates)
    _check_needs(expected, record)
    others, tests = _further(asked, simulator, record, expected)
    train = len(record) if steps or (fitting and asked.train is None) else asked.train
    if train is None and not tests and asked.record in RECORDS:
        train = RECORDS[asked.record].train
    found = plan(
        record,
        train,
        names,
        horizon=0 if fitting else steps or asked.horizon,
        others=others,
        tests=tests,
        seeds=asked.seeds,
        setup=replace(options, simulator=fitted, initial=asked.testing.initial),
        refit=asked.refit,
    )
    for method in found.methods:
        method.to(asked.model.device)
    return found


def _names(
    asked: Request, record: Record, saved: SavedSettings | None, fitting: bool
) -> list[str] | None:
    """Return the names of the methods that the options select; None if they select none."""
    base = asked.simulator.simulator
    if asked.methods is not None:
        names = setups.names(asked.methods)
    elif fitting:
        names = ["split-gru" if saved is None else saved.method]
    elif saved is None and not (asked.calibrate or asked.conditioned or base in BASES):
        return None
    else:
        names = default_names(base is not None or record.y_sim is not None, record.nu > 0)
        if saved is not None:
            names = [saved.method, *(name for name in names if name not in TRAINED)]
    single = fitting and len(names) == 1
    names = with_variants(names, asked.calibrate, asked.conditioned)
    names = names[-1:] if single else names
    if asked.simulator.parameters is not None:
        return with_base(names, GREY_BOX)
    return with_base(names, base) if base in BASES else names


def _further(
    asked: Request, simulator: SimulatorOptions, record: Record, methods: Sequence[Forecaster]
) -> tuple[list[Record], list[Record]]:
    """Return the records of --more and of --test, with their simulators."""
    needed = any(method.random and "simulator" in method.needs for method in methods)
    beyond = not needed or any(method.calibrates for method in methods)
    more, testing, beside = asked.further, asked.testing, (record, asked.reading, simulator)
    others = load_further("--more", more.more, more.more_simulator, *beside, needed, beyond)
    tests = load_further("--test", testing.test, testing.test_simulator, *beside)
    if testing.initial is not None and not tests:
        raise ValueError(f"--initial must be used with --test, got {testing.initial}")
    return others, tests


def _check_needs(methods: Sequence[Forecaster], record: Record) -> None:
    """Raise ValueError, naming the option, if the record lacks a signal that a method needs."""
    for need, given in (("simulator", record.y_sim), ("inputs", record.u)):
        lacking = next((m for m in methods if need in m.needs and given is None), None)
        if lacking is not None:
            raise ValueError(f"--{need} must be given for {lacking.name}, {record.name} has none")


@contextmanager
def workers(jobs: int | None, cluster: str | None = None) -> Iterator[Work]:
    """Yield how trainings are carried out, as --jobs and --cluster say."""
    if cluster is None:
        yield Work(jobs or available_cores())
        return
    if jobs is not None:
        raise ValueError(
            f"--jobs must be left out with --cluster, where each thread has one, got {jobs}"
        )
    silence()
    try:
        executor = Cluster(cluster)
    except ConnectionError:
        raise ValueError(
            "--cluster must be the address of a Dask scheduler that answers, such as "
            f"tcp://10.0.0.5:8786, got {cluster}"
        ) from None
    with executor:
        cores = executor.cores
        if cores == 0:
            showing.console.print(f"{cluster} has no worker yet: waiting for the first one")
        yield Work(max(cores, 1), executor=executor)


@contextmanager
def watched(
    plan: Plan,
    work: Work,
    out: Path,
    label: str,
    samples: int = 0,
    began: float | None = None,
) -> Iterator[Work]:
    """Yield `work` with a progress bar, the time budget and checkpoints in the folder `out`.

    Parameters
    ----------
    plan, work : The plan, and how its trainings are carried out.
    out : Folder of the results; an interrupted command resumes from its checkpoints.
    label : Text before the progress bar.
    samples : Predicted samples of each method that will be written.
    began : Start of the time that a budget limits; by default the start of the command.
    """
    began, seconds, after = clock.began() if began is None else began, None, 0.0
    if plan.setup.search is not None and plan.setup.search.seconds is not None:
        starting, seconds = clock.starting(), plan.setup.search.seconds
        numbers = 2 * samples * plan.record.ny * len(plan.methods)
        slow = max(starting / USUAL_START, 1.0)
        after = AS_STARTING * starting + slow * (WRITING + NUMBER * numbers)
        after = min(after, MOST * seconds)
    time = TimeBudget.of(seconds, work.cores, began, after)
    with showing.progress(label, time, out / CHECKPOINTS) as bar:
        yield replace(work, progress=bar, checkpoints=out / CHECKPOINTS, time=time)


def compared(
    plan: Plan, work: Work, out: Path, label: str = "comparing", began: float | None = None
) -> Comparison:
    """Run a planned comparison; the other parameters are those of `watched`."""
    samples = len(plan.record) + sum(map(len, plan.tests))
    with watched(plan, work, out, label, samples, began) as busy:
        return run(plan, busy)


def save(comparison: Comparison, out: Path, facts: Mapping[str, Any]) -> Usage:
    """Write the results, `facts` first, and remove the checkpoints; return the usage.

    The usage is the commands that use the recommended method, built from the options in `facts`.
    """
    used = usage(facts["command"], facts["arguments"], out, comparison.plan, comparison.model)
    results.save(comparison, out, dict(facts), used)
    shutil.rmtree(out / CHECKPOINTS)
    return used


def command_of(context: typer.Context) -> dict[str, Any]:
    """Return the name of the command and its options, as results.json stores them."""
    return {"command": context.info_name, "arguments": arguments(context.params)}


def arguments(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of options as JSON can hold them."""
    return {
        name: str(value) if isinstance(value, Path) else "auto" if value == AUTO else value
        for name, value in values.items()
    }
