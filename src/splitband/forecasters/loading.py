"""Load what was saved, with the simulator that it was fitted with.

Loading runs no code from a file, and none that a file names. The names of classes are looked up
among those of the package and in the modules that are loaded: nothing is imported. The class has to
be that of a forecaster, a cell (a module with a method `sized`), settings, bands, recorded output
or the description of a simulator. Its constructor gets values of JSON and arrays, and so does
`from_state`.
"""

from __future__ import annotations

import hashlib
import re
import sys
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import safetensors.numpy

import splitband
from splitband import networks
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.saving import (
    DIGITS,
    FILE,
    FORMAT,
    WEIGHTS,
    of_package,
    read_description,
    restored,
)
from splitband.forecasters.simulation import description_of, simulations
from splitband.networks.cell import Template
from splitband.records import Record
from splitband.records.alignment import log
from splitband.records.preparation import check_level
from splitband.runtime.errors import InputError
from splitband.runtime.outputs import MODEL_FOLDER
from splitband.runtime.states import Arrays, array_of
from splitband.simulators import Simulator, Unknown, base
from splitband.simulators.base import Absent, KnownSimulator, Recorded, as_known, matched
from splitband.simulators.open_simulator import check_runs_as_it_is, open_simulator
from splitband.training import TrainingSettings

OPTIONS = Forecaster, Template, TrainingSettings, Bands, Recorded, Absent, Unknown
"""What options may be, beside values of JSON, dates and arrays."""
LARGEST_NUMBER = 1_000_000
"""Largest whole number that a cell's constructor gets: a larger one in a file is a forgery."""
_UNFIT = (
    *(RuntimeError, TypeError, LookupError, ValueError, AttributeError, ArithmeticError),
    *(MemoryError, AssertionError, safetensors.SafetensorError),
)
"""Errors that a forged or damaged description may raise."""
_AGAIN = "train it again, with `splitband fit` or fit(record), and save it"


def load(folder: str | Path, simulator: Simulator | None = None) -> Forecaster:
    """Read what `Forecaster.save` wrote.

    Parameters
    ----------
    folder : The folder of a forecaster, or of the result of a comparison or a forecast.
    simulator : The forecaster's simulator, such as `sb.Fmu("rig.fmu")`, or a replacement. A
        forecaster that needs a simulator loads without it, but cannot predict.

    Raises
    ------
    FileNotFoundError
        When a file is missing.
    ValueError
        When a file is damaged, of another format, or needs a class of your own whose module has
        not been imported; for a folder that holds two forecasters; for a simulator that the
        forecaster does not need, or whose `start` or `hold` is not that of the saved one.

    Warns
    -----
    UserWarning
        When the simulator differs from the one that the forecaster was saved with.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> model = sb.Periodic().fit(record)
    >>> model.save("model")
    >>> bool(np.allclose(sb.load("model").predict(20).y, model.predict(20).y))
    True
    """
    loaded = _read(_of_result(Path(folder)))
    if simulator is not None:
        _give(loaded, as_known(simulator))
    return loaded


def give_simulator(
    forecaster: Forecaster, name: str, past: Record, steps: int = 0, **how: Any
) -> None:
    """Open the simulator that a text stands for, and set it as that of a loaded forecaster.

    `how` holds arguments of `open_simulator`; what is not given of them is as it was saved. Output
    that was exported without time stamps begins with `past`, after which `steps` are predicted.
    """
    used, runs = forecaster.parameters.get("used"), ".py:" in name or name[-4:].lower() == ".fmu"
    for saved in filter(None, map(description_of, simulations(forecaster)) if runs else ()):
        own: dict[str, Any] = {"hold": saved.hold, "start": saved.start or None, "step": saved.step}
        own["unknown"] = saved.unknown or None
        how |= {option: value for option, value in own.items() if how.get(option) is None}
    if used is not None:
        if not runs:
            raise InputError(
                f"simulator must be the FILE.py:FUNCTION or .fmu that {forecaster.name} was fitted "
                f"with, got {name}"
            )
        how["parameters"] = how.get("parameters") or used
    found = open_simulator(name, past, **how)
    if used is None:
        check_runs_as_it_is("simulator", name, found)
        found = matched(found, past.columns, past.inputs)
    if isinstance(found, Recorded):
        found = replace(found, start=past.start) if found.start is None else found
        if note := found.note(past.grid.after(steps)):
            log.info("%s: %s", name, note)
    _give(forecaster, found)


def _of_result(folder: Path) -> Path:
    """Return the folder of the forecaster that a folder holds, itself or as the result of a run."""
    inner = folder / MODEL_FOLDER
    if not (inner / FILE).is_file():
        return folder
    if (folder / FILE).is_file():
        raise InputError(
            f"folder must hold one model, got two: {folder / FILE}, of `fit`, and {inner / FILE}, "
            f"of `compare` or `forecast`; name {inner}, or remove it to have the other one"
        )
    return inner


def _give(forecaster: Forecaster, simulator: KnownSimulator) -> None:
    """Set the simulator of a forecaster, with a warning if it differs from the saved one."""
    given = [*simulations(forecaster)]
    if not given:
        raise InputError(f"simulator must be left out for {forecaster.name}, which asks for none")
    differences = []
    for each in given:
        other = simulator
        if each.simulator is None and each.fitted is not None:  # it was run beside the record
            record = each.fitted.record
            check_level(record, each.name)
            other = matched(simulator, record.columns, record.inputs)
        if (saved := description_of(each)) is not None:
            differences.append(saved.difference(other))
    for said in filter(None, dict.fromkeys(differences)):
        warnings.warn(said, stacklevel=3)
    for each in given:
        each.simulator = simulator
        if each.fitted is not None:
            each.complete()


def _read(folder: Path) -> Forecaster:
    """Return the forecaster of a folder, without its simulator."""
    if not (folder / FILE).is_file():
        old = f"; its model.json is of version 0.1 or 0.2: {_AGAIN}"
        said = old if (folder / "model.json").is_file() else ""
        raise FileNotFoundError(f"no model in {folder}: {FILE} is missing{said}")
    try:
        facts = read_description(folder)
    except _UNFIT as error:
        raise InputError(f"{folder / FILE} is damaged: {error!r}") from None
    if facts.get("format") != FORMAT:
        raise InputError(
            f"{folder / FILE} has format {facts.get('format')!r}, this version reads {FORMAT}; "
            + _AGAIN
        )
    arrays = _arrays(folder, facts)
    try:
        said = facts["forecaster"]
        options = {name: _option(value, arrays) for name, value in said["options"].items()}
        for name, fact in said["facts"].items():
            arrays[name] = array_of(np.array(fact, str if isinstance(fact, list) else None))
        return restored(_kind(said, (Forecaster,)), options, arrays)
    except KeyError as error:
        raise InputError(f"{folder / FILE} holds no forecaster: {error} is missing") from None
    except _UNFIT as error:
        raise InputError(f"{folder / FILE} holds no forecaster that can be read: {error}") from None


def _arrays(folder: Path, facts: Mapping[str, Any]) -> Arrays:
    """Return the arrays that belong to a description."""
    digest = facts.get("weights_sha256")
    if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
        raise InputError(f"{folder / FILE} is damaged: weights_sha256 must be a SHA-256")
    path = folder / WEIGHTS.format(digest[:DIGITS])
    if not path.is_file():
        raise FileNotFoundError(f"no model in {folder}: {path.name} is missing")
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise InputError(f"{path} is damaged: its checksum is not that of the model")
    try:
        return {name: np.array(x) for name, x in safetensors.numpy.load(content).items()}
    except _UNFIT as error:
        raise InputError(f"{path} is damaged: {error}") from None


def _option(value: Any, arrays: Arrays) -> Any:  # noqa: PLR0911  a line a kind
    """Return the option that JSON describes."""
    if isinstance(value, list):
        return [_option(part, arrays) for part in value]
    if not isinstance(value, dict):
        return value
    if "kind" in value:
        kind = _kind(value, OPTIONS)
        given = {name: _option(part, arrays) for name, part in value["options"].items()}
        return _cell(kind, given) if issubclass(kind, Template) else kind(**given)
    ((word, inner),) = value.items()
    match word:
        case "number":
            return float(inner)
        case "date":
            return pd.Timestamp(inner)
        case "array":
            return arrays.pop(inner)
        case "tuple":
            return tuple(_option(part, arrays) for part in inner)
        case "dict":
            return {name: _option(part, arrays) for name, part in inner.items()}
    raise InputError(f"options hold {word[:60]}, which is not known")


def _kind(said: Mapping[str, Any], kinds: tuple[Any, ...]) -> Any:
    """Return the class that is named, if it is one of these kinds.

    It is the one of that name in its module, or the only one of that name elsewhere: what was saved
    in a script may be loaded by one that imports it. Of the user's modules none is imported.
    """
    name, module = said["kind"], said.get("module")

    def inside(holder: Any) -> type | None:
        for part in name.split("."):
            own = getattr(holder, "__dict__", {}).get(part)
            holder = getattr(holder, part, None) if module is None else own
        fits = isinstance(holder, type) and issubclass(holder, kinds)
        return holder if fits and of_package(holder) == (module is None) else None

    places: list[list[Any]] = [[sys.modules.get(module or "")], [*sys.modules.values()]]
    for holders in [[splitband, networks, base]] if module is None else places:
        found = {*map(inside, holders)} - {None}
        if len(found) == 1:
            return found.pop()
    where = f" here: import {str(module)[:60]} first, which defined it where the model was saved"
    raise InputError(f"the class {str(name)[:60]} is not known{where if module else ''}")


def _cell(kind: Any, given: Mapping[str, Any]) -> Any:
    """Return a template of a cell: on the meta device, where weights take no memory."""
    from splitband.networks.layers import torch  # noqa: PLC0415  just what has networks needs it

    for name, part in given.items():
        if isinstance(part, int) and abs(part) > LARGEST_NUMBER:
            raise InputError(f"{name} must be a whole number up to {LARGEST_NUMBER}, got {part}")
    try:
        with torch.device("meta"):
            return kind(**given)
    except RuntimeError:  # a user's cell may need values, which the meta device does not have
        return kind(**given)
