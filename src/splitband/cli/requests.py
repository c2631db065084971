"""Plan what the options of a command ask for, for all commands that fit."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any

import typer

from splitband.checks.inspection import unnamed_inputs
from splitband.cli import options, printing, records
from splitband.cli.usage import REPLACED_BY_LIKE, command_of, usage
from splitband.comparison.defaults import default_names
from splitband.comparison.methods import TRAINED, Sizes, forecasters
from splitband.comparison.plan import Plan, plan
from splitband.comparison.request import PlanRequest
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.records import Record
from splitband.records.named import RECORDS
from splitband.records.signals import listed
from splitband.runtime.errors import InputError
from splitband.simulators.open_simulator import is_fitted
from splitband.training import TrainingSettings


@dataclass(frozen=True)
class Request:
    """The options of `compare`, except those for its results, cores and cluster."""

    record: options.RecordArgument
    reading: options.RecordOptions = field(default_factory=options.RecordOptions)
    simulator: options.SimulatorOrBaseOptions = field(
        default_factory=options.SimulatorOrBaseOptions
    )
    further: options.FurtherRecords = field(default_factory=options.FurtherRecords)
    testing: options.TestRecords = field(default_factory=options.TestRecords)
    model: options.ModelOptions = field(default_factory=options.ModelOptions)
    train: options.Train = None
    horizon: Annotated[
        int | None,
        options.plain("Predict only N samples after the training samples.", "N", "all", min=1),
    ] = None
    ahead: options.Ahead = None
    methods: options.Methods = None
    seeds: options.Seeds = None
    refit: Annotated[
        bool,
        options.plain("Train the recommended method again, on the whole record, for OUT/model."),
    ] = False
    like: options.Like = None
    also: Annotated[
        list[str] | None,
        options.plain(
            "Add a simulation made elsewhere to the table and the page: a file with the columns of "
            "the record, and one more for each --test, to be scored there, too. It is never "
            "recommended. May be repeated.",
            "FILE,FILE",
        ),
    ] = None


def planned(asked: Request, context: typer.Context | None = None, fitting: bool = False) -> Plan:
    """Read the records and simulators that the options name, and return the plan for them.

    Where likely inputs are not named, the command of the context is printed with them.

    `fitting` is for a single method, which must be named, by default fitted to the whole record.
    """
    reading, simulated = asked.reading, asked.simulator
    model = None if asked.like is None else _like(asked)
    record, *runs = records.load_records(asked.record, reading, model)
    simulator = records.simulator_of(simulated, record, reading.time_column)
    if simulator is not None and not isinstance(simulator, str) and not is_fitted(simulator):
        record = replace(record, y_sim=None)  # the named one counts
    more, test = asked.further, asked.testing
    if is_fitted(simulator):
        given = {"--more-simulator": more.more_simulator, "--test-simulator": test.test_simulator}
        if option := next((option for option in given if given[option]), None):
            raise InputError(
                f"{option} must be left out where --simulator has parameters to fit: with those, "
                f"it runs for every record, got {', '.join(given[option] or ())}"
            )
    chosen: list[str | Forecaster] | None = None
    if model is not None:
        usual = default_names(record.y_sim is not None, record.nu > 0)
        beside = {*usual} - {*TRAINED, model.name}
        chosen = [model.untrained(), *(n for n in usual if not fitting and n in beside)]
    elif asked.methods is not None:
        chosen = [*options.names(asked.methods)]
        if not chosen:
            raise InputError(f"methods must be one or several names, got {asked.methods!r}")
    if simulator is None and record.y_sim is not None:
        # A named record's own simulator can run for longer.
        calibrates = any(method.calibrates for method in forecasters(chosen or ()))
        simulator = asked.record if chosen is None or calibrates else None
    others, tests = (
        records.load_further(option, files, beside, record, reading, simulated)
        for option, files, beside in (
            ("--more", more.more, more.more_simulator),
            ("--test", test.test, test.test_simulator),
        )
    )
    train = asked.train
    if train == "all" or (fitting and train is None):
        train = len(record)
    elif train is None and not tests and asked.record in RECORDS:
        train = RECORDS[asked.record].train
    found = plan(
        PlanRequest(
            record,
            train,
            chosen,
            horizon=0 if fitting else asked.horizon,
            ahead=asked.ahead,
            others=[*runs, *others],
            tests=tests,
            initial=test.initial,
            simulator=simulator,
            seeds=asked.seeds,
            refit=asked.refit,
            also=records.elsewhere(asked.also or (), record, reading),
            **_of_model(asked.model),
        )
    )
    found = _with_windows(found, asked.model.own_warmup)
    for said in found.warnings:
        printing.warn(said)
    if context is not None and model is None and asked.reading.inputs is None:
        _show_with_inputs(context, record, [c.name for c in unnamed_inputs(record) if c.clear])
    return found


def _show_with_inputs(context: typer.Context, record: Record, inputs: list[str]) -> None:
    """Print the command that is running with these columns as inputs, if there are any."""
    facts = command_of(context)
    given = facts["arguments"] | {"inputs": listed(inputs)}
    if given["columns"] is not None:
        given["columns"] = listed([name for name in record.columns if name not in inputs])
    if inputs:
        command = usage(facts["command"], given).asked
        printing.console.print(f"to use them as inputs:\n    {command}", soft_wrap=True)


def _with_windows(found: Plan, own_warmup: str) -> Plan:
    """Return a plan whose split models are trained on windows as --own-warmup says."""
    if own_warmup == "yes":
        return found
    able = [method.name for method in found.methods if "own_warmup" in method.get_params()]
    if not able:
        raise InputError(
            "own_warmup must be left out where no method splits the record, as split-gru does, "
            f"got {', '.join(method.name for method in found.methods)}"
        )
    cut = {name: {"own_warmup": False} for name in able}
    methods = (each.clone().set_params(**cut.get(each.name, {})) for each in found.methods)
    return replace(found, methods=tuple(methods))


def _of_model(asked: options.ModelOptions) -> dict[str, Any]:
    """Return the arguments of `plan` for these options: in settings and bands, or as they are."""
    given = {name: value for name, value in vars(asked).items() if value is not None}
    del given["own_warmup"]
    if (sizes := given.pop("hidden", None)) is not None:
        low, high = options.hidden(sizes)
        given["sizes"] = Sizes(hidden_low=low, hidden_high=high)
    if "budget" in given:
        given["budget"] = options.seconds(given["budget"])
    settings, bands = (
        {each.name: given.pop(each.name) for each in fields(kind) if each.name in given}
        for kind in (TrainingSettings, Bands)
    )
    return given | {"settings": settings, "bands": Bands(**bands)}


def _like(asked: Request) -> Forecaster:
    """Return the saved model of --like, whose settings a new training takes."""
    from splitband.forecasters.loading import load  # noqa: PLC0415  only where a model is loaded

    folder, usual = asked.like, options.ModelOptions()
    assert folder is not None
    for name in REPLACED_BY_LIKE:
        if (value := getattr(asked.model, name)) != getattr(usual, name):
            raise InputError(
                f"--{name.replace('_', '-')} must be left out with --like, whose model decides it, "
                f"got {value}"
            )
    return load(folder)
