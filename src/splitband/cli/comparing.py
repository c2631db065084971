"""Plan what the options of a command ask for, for all commands that fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from splitband.cli import records, showing
from splitband.cli.options.groups import panel
from splitband.cli.options.models import AUTO, Conditioned, Like, Methods, ModelOptions, Seeds
from splitband.cli.options.records import (
    FurtherRecords,
    RecordArgument,
    RecordOptions,
    TestRecords,
)
from splitband.cli.options.simulators import Calibrate, SimulatorOptions, SimulatorOrBaseOptions
from splitband.cli.options.values import hidden, milestones, names, seconds
from splitband.cli.simulators import adjustable, load_further, with_own_parameters, with_simulator
from splitband.data import Record
from splitband.data.named import RECORDS
from splitband.evaluation.plan import Plan, default_names, plan
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import (
    BASES,
    GREY_BOX,
    TRAINED,
    Sizes,
    known,
    with_base,
    with_variants,
)
from splitband.runtime.errors import InputError
from splitband.runtime.threads import available_cores
from splitband.training import Settings


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
    like: Like = None


def planned(
    asked: Request, steps: int = 0, future_inputs: Path | None = None, fitting: bool = False
) -> Plan:
    """Read the records and simulators that the options name, and return the plan for them.

    Parameters
    ----------
    asked : The options.
    steps, future_inputs : Samples to forecast beyond the record, all of which is training data, and
        the file of the inputs there.
    fitting : Fit a single method, by default to the whole record, and forecast nothing.
    """
    reading, simulator = asked.reading, with_own_parameters(asked.simulator)
    options = plan_options(asked.model)
    model = None if asked.like is None else _like(asked)
    record = records.load_record(asked.record, reading, model)
    hybrid = simulator.parameters is None and (
        simulator.simulator is not None or record.y_sim is not None
    )
    found = _names(replace(asked, simulator=simulator), record, model, fitting)
    usual = default_names(hybrid, record.nu > 0) if found is None else found
    expected = [known(each) if isinstance(each, str) else each for each in usual]
    calibrates = any(method._calibrates for method in expected)
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
    done = plan(
        record,
        train,
        found,
        horizon=0 if fitting else steps or asked.horizon,
        others=others,
        tests=tests,
        initial=asked.testing.initial,
        simulator=adjustable(simulator),
        seeds=asked.seeds,
        refit=asked.refit,
        **options,
    )
    for method in done.methods if asked.model.device != "cpu" else ():
        method.to(asked.model.device)
    return done


def plan_options(given: ModelOptions) -> dict[str, Any]:
    """Return the arguments of `plan` for the options of filters, networks, training and time."""
    check_device(given.device)
    changes = {
        each.name: getattr(given, each.name)
        for each in fields(Settings)
        if getattr(given, each.name, None) is not None
    }
    if given.lr_milestones is not None:
        changes["milestones"] = milestones(given.lr_milestones)
    sizes = None
    if given.hidden is not None:
        high, low = hidden(given.hidden)
        sizes = Sizes(hidden_high=high, hidden_low=low)
    cutoff = None if given.cutoff == AUTO else given.cutoff
    return {
        "settings": changes,
        "recipe": given.recipe,
        "bands": Bands(cutoff, given.order, given.downsampling),
        "sizes": sizes,
        "budget": None if given.budget is None else seconds(given.budget),
        "rounds": given.rounds,
        "seed": given.seed,
    }


def check_device(name: str) -> None:
    """Raise ValueError, naming the option, for a device that is not available."""
    if name == "cpu":
        return
    import torch  # noqa: PLC0415  only where another device is asked for

    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0]
        raise InputError(f"--device must be one that is there, got {name}: {reason}") from None


def _like(asked: Request) -> Forecaster:
    """Return the saved model of --like, whose settings a new training takes."""
    from splitband.forecasters.saving import load  # noqa: PLC0415  only where a model is loaded
    from splitband.report.results import MODEL_FOLDER  # noqa: PLC0415

    folder = asked.like
    assert folder is not None
    decided = [o for o in ("window", "epochs", "hidden", "budget", "rounds", "lr_milestones")
               if getattr(asked.model, o) is not None]  # fmt: skip
    if decided:
        option = decided[0].replace("_", "-")
        raise InputError(
            f"--{option} must be left out with --like, whose model decides it, got "
            f"{getattr(asked.model, decided[0])}"
        )
    return load(folder / MODEL_FOLDER if (folder / MODEL_FOLDER).is_dir() else folder)


def _names(
    asked: Request, record: Record, model: Forecaster | None, fitting: bool
) -> list[str | Forecaster] | None:
    """Return the methods that the options select; None if they select none."""
    base = asked.simulator.simulator
    if model is not None:
        usual = default_names(record.y_sim is not None, record.nu > 0)
        others = [] if fitting else [name for name in usual if name not in TRAINED]
        return [model.untrained(), *others]
    if asked.methods is not None:
        found = names(asked.methods)
    elif fitting:
        found = ["split-gru"]
    elif not (asked.calibrate or asked.conditioned or base in BASES):
        return None
    else:
        found = default_names(base is not None or record.y_sim is not None, record.nu > 0)
    single = fitting and len(found) == 1
    found = with_variants(found, asked.calibrate, asked.conditioned)
    found = found[-1:] if single else found
    if asked.simulator.parameters is not None:
        return [*with_base(found, GREY_BOX)]
    return [*(with_base(found, base) if base is not None and base in BASES else found)]


def _further(
    asked: Request, simulator: SimulatorOptions, record: Record, methods: Sequence[Forecaster]
) -> tuple[list[Record], list[Record]]:
    """Return the records of --more and of --test, with their simulators."""
    needed = any(method.random and "simulator" in method.needs for method in methods)
    beyond = not needed or any(method._calibrates for method in methods)
    more, testing, beside = asked.further, asked.testing, (record, asked.reading, simulator)
    others = load_further("--more", more.more, more.more_simulator, *beside, needed, beyond)
    tests = load_further("--test", testing.test, testing.test_simulator, *beside)
    if testing.initial is not None and not tests:
        raise InputError(f"--initial must be used with --test, got {testing.initial}")
    return others, tests


def _check_needs(methods: Sequence[Forecaster], record: Record) -> None:
    """Raise ValueError, naming the option, if the record lacks a signal that a method needs."""
    for need, given in (("simulator", record.y_sim), ("inputs", record.u)):
        lacking = next((m for m in methods if need in m.needs and given is None), None)
        if lacking is not None:
            raise InputError(f"--{need} must be given for {lacking.name}, {record.name} has none")


@contextmanager
def workers(jobs: int | None, cluster: str | None = None) -> Iterator[dict[str, Any]]:
    """Yield the arguments of `run` that say where trainings run, as --jobs and --cluster ask."""
    if cluster is None:
        yield {"cores": jobs or available_cores()}
        return
    if jobs is not None:
        raise InputError(
            f"--jobs must be left out with --cluster, where each thread has one, got {jobs}"
        )
    try:
        from distributed import Client, KilledWorker  # noqa: PLC0415  an extra
        from distributed.client import ClosedClientError  # noqa: PLC0415
    except ImportError:
        raise InputError("--cluster needs Dask: pip install 'splitband[cluster]'") from None
    try:
        client = Client(cluster, timeout=5, set_as_default=False)
    except (OSError, TimeoutError, ValueError):
        raise InputError(
            "--cluster must be the address of a Dask scheduler that answers, such as "
            f"tcp://10.0.0.5:8786, got {cluster}"
        ) from None
    with client:
        if not client.nthreads():
            showing.console.print(f"waiting for a worker of {cluster}; Ctrl-C stops")
        client.wait_for_workers(1)
        try:
            client.get_versions(check=True)
        except ValueError as error:
            raise InputError(f"--cluster must run the versions that are here: {error}") from None
        cores = sum(client.nthreads().values())
        try:
            yield {"cores": max(cores, 1), "executor": client.get_executor(pure=False)}
        except (KilledWorker, ClosedClientError, CancelledError):
            raise InputError(
                "--cluster must be there until the end (the same command goes on from what is "
                f"finished), the scheduler or the workers are gone, got {cluster}"
            ) from None


def command_of(context: typer.Context) -> dict[str, Any]:
    """Return the name of the command and its options, as results.json stores them."""
    return {"command": context.info_name, "arguments": arguments(context.params)}


def arguments(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of options as JSON can hold them."""
    return {
        name: str(value) if isinstance(value, Path) else "auto" if value == AUTO else value
        for name, value in values.items()
    }
