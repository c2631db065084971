"""Write the commands and the code that use a result, for its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import typer

from splitband.cli.options import (
    FileOptions,
    FurtherRecords,
    ModelOptions,
    RecordOptions,
    SimulatorOptions,
)
from splitband.comparison.methods import NAMES, TRAINED
from splitband.comparison.plan import Plan
from splitband.forecasters.base import Forecaster
from splitband.records.named import RECORDS
from splitband.report.page.parts import Usage
from splitband.runtime.outputs import MODEL_FOLDER
from splitband.runtime.system import over_lines, quoted

_OF_FIT = "parameters", "unknown", "unknown_odd"
_SIMULATOR = [name for name in SimulatorOptions.__annotations__ if name not in _OF_FIT]
_FILES = [name for name in FileOptions.__annotations__ if name != "gaps"]
REPLACED_BY_LIKE = [name for name in ModelOptions.__annotations__ if name not in ("seed", "device")]
"""Options that --like replaces."""
_RECORDS = [*RecordOptions.__annotations__, "gaps", *_FILES, *FurtherRecords.__annotations__]
_FIT = [*_RECORDS, *_SIMULATOR, *_OF_FIT, "ahead", *REPLACED_BY_LIKE, "like", "seed", "device"]
_BLANK = "simulator_inputs", "time_column"
"""Options of which an empty text says something: none of them."""
_DEFAULTS = vars(FileOptions()) | vars(SimulatorOptions()) | vars(ModelOptions())
WIDTH = 80
"""Characters in a line of a command."""
STEPS = 100
"""Samples ahead in the examples."""


def command_of(context: typer.Context) -> dict[str, Any]:
    """Return the name of the command and its options, as results.json stores them."""
    return {"command": context.info_name, "arguments": arguments(context.params)}


def arguments(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of options as JSON can hold them."""
    return {
        name: str(v)
        if isinstance(v, Path)
        else [*map(str, v)]
        if isinstance(v, list | tuple)
        else v
        for name, v in values.items()
    }


def usage(
    command: str,
    given: Mapping[str, Any],
    out: Path = Path(),
    plan: Plan | None = None,
    model: Forecaster | None = None,
) -> Usage:
    """Return how to use the `model` of a run, as the page shows it, and the command that made it.

    `given` holds the options of the command, as in results.json; `out` is the folder of its
    results.
    """
    record = str(given.get("record", ""))
    asked = _line(f"splitband {command}", given, [*given])
    files = [record, *(given.get("more") or ()), *(given.get("test") or ())]
    used = Usage((), asked, [*filter(None, map(str, files))])
    if plan is None or model is None:
        return used
    record = record or (plan.record.name if plan.record.name in RECORDS else "")
    if not record:
        return used
    given = {**given, "record": record}
    commands = [("Simulate it beyond the training record", _simulate(given, out, plan, model))]
    if model.random:
        given = {k: v for k, v in given.items() if k not in REPLACED_BY_LIKE} | {"like": str(out)}
    else:
        given |= {"rounds": None}  # there is nothing to search
    if model.name in NAMES:
        if not plan.refit and plan.train < len(plan.record):
            end = [f"--method {model.name}", f"--out {quoted(str(out / 'model-of-all'))}"]
            fit = _line("splitband fit", given, ["record", *_FIT], end[model.random :])
            commands.append(("Fit it to the whole record", fit))
        # A simulator cannot be exported, nor an equation that jumps or is stiff.
        if model.name in TRAINED or not ("simulator" in model.needs or model.parameters):
            export = f"splitband export {quoted(str(out / MODEL_FOLDER))} model.fmu"
            commands.append(("Export it: .fmu for Simulink, .c for a controller, .onnx", export))
    if given.get("test"):
        runs = "simulator" in model.needs
        beside = _SIMULATOR if runs or model.parameters else []
        reading = {name: given.get(name) for name in ("gaps", *_FILES, *beside)}
        if runs and (own := given.get("test_simulator")):
            reading["simulator"] = own[0]
        elif runs and plan.tests[0].y_sim is None:  # a file with its output is of one record
            reading["simulator"] = "FILE"
        asked_of = {"model_dirs": [out / MODEL_FOLDER], "record": given["test"][0]}
        checked = checking(reading | asked_of)
        commands.append(("Check it on the test record", checked))
    commands.sort(key=lambda each: "FILE" in each[1])  # those with a placeholder come last
    if "simulator" not in model.needs and not model.parameters:
        commands.append(("Use it in Python", _python(out, plan)))
    return replace(used, commands=commands)


def comparing(record: str, given: Mapping[str, Any]) -> str:
    """Return the command `splitband compare` of a record with these options."""
    return _line("splitband compare", {"record": record, **given}, ["record", *given])


def checking(given: Mapping[str, Any]) -> str:
    """Return the command `splitband check` with these options."""
    models = " ".join(quoted(str(name)) for name in given["model_dirs"])
    names = [name for name in given if name not in ("model_dirs", "record")]
    record = quoted(str(given["record"]))
    return _line(f"splitband check {models}", given, names, [f"--record {record}"])


def _python(out: Path, plan: Plan) -> str:
    """Return the lines that predict with the trained model."""
    known, steps = ", u=u" if plan.record.nu else "", plan.ahead or STEPS
    _, inputs = plan.record.labels
    said = ", ".join(inputs) if plan.record.reading.levels else "the inputs"
    why = f"  # u: the {steps} samples of {said} to come" if known else ""
    return (
        f"import splitband as sb\n\nmodel = sb.load({str(out / MODEL_FOLDER)!r})\n"
        f"model.predict({steps}{known}).to_frame(){why}"
    )


def _simulate(given: Mapping[str, Any], out: Path, plan: Plan, model: Forecaster) -> str:
    """Return the command that simulates the model beyond its training samples."""
    ahead = 0 if plan.refit else len(plan.record) - plan.train
    steps = plan.ahead or min(plan.horizon or STEPS, STEPS)
    options: dict[str, Any] = {name: given.get(name) for name in _FILES}
    if "simulator" in model.needs or model.parameters:
        options |= {name: given.get(name) for name in _SIMULATOR}
        options["simulator"] = given.get("simulator") or given["record"]
    if plan.record.nu:
        # With time stamps the inputs to come are read from the record; else the user names a file.
        stamped = plan.record.start is not None or given["record"] in RECORDS
        known = ahead and stamped
        options["future_inputs"] = given.get("future_inputs") or (
            given["record"] if known else "FILE"
        )
    begin, end = f"splitband simulate {quoted(str(out / MODEL_FOLDER))}", [f"--steps {steps}"]
    return _line(begin, options, [*options], [*end, "--out ahead.csv"])


def _line(begin: str, given: Mapping[str, Any], names: Any, end: Sequence[str] = ()) -> str:
    """Return a command with the options that were given, in lines that end with a backslash."""
    words = [begin]
    for name in sorted(names, key=lambda name: name != "record"):
        value = given.get(name)
        none = value is False or value in (None, [], ()) or (value == "" and name not in _BLANK)
        if none or _DEFAULTS.get(name) == value:
            continue
        if name == "record":
            words.append(quoted(str(value)))
            continue
        option = f"--{name.replace('_', '-')}"
        for each in value if isinstance(value, list | tuple) else [value]:
            words.append(option if each is True else f"{option} {quoted(str(each))}")
    lines = [""]
    for word in [*words, *end]:
        if lines[-1] and len(lines[-1]) + len(word) > WIDTH:
            lines.append("   ")
        lines[-1] += f" {word}" if lines[-1] else word
    return over_lines(lines)
