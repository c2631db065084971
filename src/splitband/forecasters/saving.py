"""Save forecasters to folders, whole or not at all, and read them.

A folder holds forecaster.json, which describes the forecaster and its parts, and one safetensors
file with all weights and arrays. The latter is named after its content, so that an interrupted
`save` leaves the previous pair intact. Of a simulator that is not recorded output only a
description is saved (`simulators.base.Absent`); `loading.load` takes the simulator itself.

Loading runs no code from a file, and none that a file names. The description of an object contains
the name of its class, which is looked up in the modules that are loaded: nothing is imported. The
class has to be that of a forecaster, restored by `from_dict` from the result of `to_dict`; one of
the package that is marked as `saved`, restored from its fields; or that of a cell, which is a
module with a method `sized`, restored from the arguments of its constructor.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, cast, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
import pandas as pd
import safetensors
import safetensors.numpy

from splitband import networks
from splitband.networks.cell import Template
from splitband.runtime import outputs
from splitband.runtime.arguments import whole
from splitband.runtime.errors import InputError
from splitband.runtime.files import replacing, to_json, write_text
from splitband.runtime.options import is_saved, options

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster

FORMAT = 8
"""Version of the description, which changes with attributes of what is saved, and their meaning."""
FILE, WEIGHTS = outputs.DESCRIPTION, outputs.WEIGHTS
LARGEST_DESCRIPTION = 2**28
"""Largest size of a description in bytes: bounds the memory."""
LARGEST_NUMBER = 1_000_000
"""Largest whole number that a cell's constructor gets: a larger one in a file is a forgery."""
_DIGITS = 16
"""Digits of the weights' SHA-256 in the name of their file: enough to be unique."""
_UNFIT = (
    *(RuntimeError, TypeError, LookupError, ValueError, AttributeError, ArithmeticError),
    *(MemoryError, AssertionError, safetensors.SafetensorError),
)
"""Errors that a forged or damaged description may raise."""
_AGAIN = "train it again, with `splitband fit` or fit(record), and save it"
_SEVERAL = list, tuple, frozenset
"""Kinds of collections that are saved."""
_PACKAGE = __name__.partition(".")[0]

Tensors = dict[str, npt.NDArray[Any]]
"""The arrays and the weights of a forecaster, by their place in it."""


class Saved:
    """Define what is saved of an object, and how it is restored from that: of every forecaster."""

    def to_dict(self) -> dict[str, Any]:
        """Return what is saved."""
        return {**vars(self)}

    @classmethod
    def from_dict(cls, found: dict[str, Any]) -> Self:
        """Return the object that `to_dict` described; its constructor is not called."""
        new = object.__new__(cls)
        vars(new).update(found)
        return new


def save(
    forecaster: Forecaster, folder: str | Path, facts: Mapping[str, Any] | None = None
) -> None:
    """Write a fitted forecaster to a folder, whole or not at all.

    Parameters
    ----------
    forecaster : Fitted. One of your own must consist of numbers, texts, arrays, dates, lists and
        dicts of these, and objects of the package.
    folder : Created if it does not exist.
    facts : Further entries of the JSON file.

    Raises
    ------
    ValueError
        For a forecaster that has not been fitted, or holds a value that cannot be saved.
    """
    forecaster.require_fitted()
    folder, tensors = Path(folder), dict[str, Any]()
    description = described(forecaster, tensors)
    content = safetensors.numpy.save(tensors)
    digest = hashlib.sha256(content).hexdigest()
    text = to_json(
        {**(facts or {}), "format": FORMAT, "weights_sha256": digest, "forecaster": description}
    )
    folder.mkdir(parents=True, exist_ok=True)
    weights = folder / WEIGHTS.format(digest[:_DIGITS])
    if not weights.is_file() or weights.read_bytes() != content:
        with replacing(weights) as new:
            new.write_bytes(content)
    try:
        write_text(folder / FILE, text)
    finally:
        _remove_outdated(folder)


def files(folder: Path) -> list[Path]:
    """Return the files of the forecaster that a folder holds, and those of interrupted saves."""
    pattern = re.compile(WEIGHTS.format(f"[0-9a-f]{{{_DIGITS}}}").replace(".", r"\."))
    found = [path for path in folder.glob(WEIGHTS.format("*")) if pattern.fullmatch(path.name)]
    return [folder / FILE, *found] if (folder / FILE).is_file() else found


def _remove_outdated(folder: Path) -> None:
    """Remove weight files that do not belong to the current description."""
    try:
        digest = str(_read_description(folder)["weights_sha256"])
    except (OSError, *_UNFIT):
        digest = ""
    for path in files(folder):
        if path.name not in (FILE, WEIGHTS.format(digest[:_DIGITS])):
            path.unlink(missing_ok=True)


def read(folder: Path) -> Forecaster:
    """Return the forecaster of a folder, without its simulator; see `loading.load`."""
    if not (folder / FILE).is_file():
        old = f"; its model.json is of version 0.1 or 0.2: {_AGAIN}"
        said = old if (folder / "model.json").is_file() else ""
        raise FileNotFoundError(f"no model in {folder}: {FILE} is missing{said}")
    try:
        facts = _read_description(folder)
    except _UNFIT as error:
        raise InputError(f"{folder / FILE} is damaged: {error!r}") from None
    if facts.get("format") != FORMAT:
        raise InputError(
            f"{folder / FILE} has format {facts.get('format')!r}, this version reads {FORMAT}; "
            + _AGAIN
        )
    tensors = _tensors(folder, facts)
    try:
        found = restored(facts["forecaster"], tensors)
        if not isinstance(found, Saved):
            raise InputError(f"it is {type(found).__name__}")
        loaded = cast("Forecaster", found)
        loaded.require_fitted()
    except KeyError as error:
        raise InputError(f"{folder / FILE} holds no forecaster: {error} is missing") from None
    except _UNFIT as error:
        raise InputError(f"{folder / FILE} holds no forecaster that can be read: {error}") from None
    return loaded


def _read_description(folder: Path) -> dict[str, Any]:
    size = (folder / FILE).stat().st_size
    if size > LARGEST_DESCRIPTION:
        raise InputError(f"it is larger than {LARGEST_DESCRIPTION} bytes")
    return dict(json.loads((folder / FILE).read_text(encoding="utf-8")).items())


def _tensors(folder: Path, facts: Mapping[str, Any]) -> Tensors:
    """Return the weights and arrays that belong to a description."""
    digest = facts.get("weights_sha256")
    if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
        raise InputError(f"{folder / FILE} is damaged: weights_sha256 must be a SHA-256")
    path = folder / WEIGHTS.format(digest[:_DIGITS])
    if not path.is_file():
        raise FileNotFoundError(f"no model in {folder}: {path.name} is missing")
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() != digest:
        raise InputError(f"{path} is damaged: its checksum is not that of the model")
    try:
        return dict(safetensors.numpy.load(content))
    except _UNFIT as error:
        raise InputError(f"{path} is damaged: {error}") from None


def described(value: Any, tensors: Tensors, place: str = "") -> Any:  # noqa: PLR0911  a line a kind
    """Return a value as JSON, and put its arrays into `tensors`, by their place in the value.

    Raises ValueError for a value that cannot be described.
    """
    if isinstance(value, np.generic):  # of nanoseconds, `item` is a number
        value = pd.Timestamp(value) if isinstance(value, np.datetime64) else value.item()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"number": str(value)}
    if isinstance(value, pd.Timestamp):
        return {"date": value.isoformat()}
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biufc" or value.dtype.itemsize > 8:
            raise InputError(f"an array of {value.dtype} cannot be saved")
        while place in tensors:  # names may hold dots
            place += "."
        tensors[place] = np.array(value, order="C")
        return {"array": place}
    if isinstance(value, Saved):
        return _named("class", value, value.to_dict(), tensors, place)
    if is_saved(type(value)):
        parts = {each.name: vars(value)[each.name] for each in fields(value) if each.init}
        return _named("class", value, parts, tensors, place)
    if isinstance(value, Mapping):
        return {"mapping": _parts(value, tensors, place)}
    if type(value) in _SEVERAL:
        ordered = sorted(value) if isinstance(value, frozenset) else value
        inner = [described(v, tensors, f"{place}.{i}") for i, v in enumerate(ordered)]
        return {type(value).__name__: inner}
    try:
        return _of_torch(value, tensors, place)
    except TypeError as error:  # of `options`, or a number format that NumPy does not have
        raise InputError(f"{type(value).__name__} cannot be saved: {error}") from None


def _of_torch(value: Any, tensors: Tensors, place: str) -> Any:
    """Return the description of a tensor, its size, a device or a cell; raises TypeError else."""
    torch: Any = sys.modules.get("torch")  # without it, the value is nothing of torch's
    if torch is not None and isinstance(value, torch.Size):
        return described(tuple(value), tensors, place)
    if torch is None or not isinstance(value, torch.Tensor | torch.device | torch.nn.Module):
        raise TypeError("it is no number, text, array, date, list or dict")
    if isinstance(value, torch.Tensor):
        return described(value.detach().cpu().numpy(), tensors, place)
    if isinstance(value, torch.device):
        return {"device": str(value)}
    return _named("cell", value, options(value), tensors, place)


def _named(
    word: str, value: Any, parts: Mapping[str, Any], tensors: Tensors, place: str
) -> dict[str, Any]:
    """Return the description of an object by its class and parts."""
    kind = type(value)
    own = {} if _of_package(kind) else {"module": kind.__module__}
    if own and "<locals>" in kind.__qualname__:
        raise InputError(
            f"{kind.__name__} cannot be saved: its class is defined inside of a function, where "
            "loading cannot find it; define it in a module"
        )
    return {word: kind.__qualname__, **own, "fields": _parts(parts, tensors, place)}


def _parts(parts: Mapping[str, Any], tensors: Tensors, place: str) -> dict[str, Any]:
    if not all(isinstance(name, str) for name in parts):
        raise InputError("a mapping that is saved with a forecaster must have texts as keys")
    dot = "." if place else ""
    return {name: described(v, tensors, f"{place}{dot}{name}") for name, v in parts.items()}


def restored(value: Any, tensors: Tensors) -> Any:  # noqa: PLR0911  a line a kind
    """Return the object that `value` describes.

    Raises ValueError for an unknown class, or a value that is not a description; a damaged
    description may raise other errors, too.
    """
    if not isinstance(value, dict):
        return value
    for several in _SEVERAL:
        if several.__name__ in value:
            return several(restored(part, tensors) for part in value[several.__name__])
    if "array" in value:
        return np.array(tensors[value["array"]])
    if "number" in value:
        return float(value["number"])
    if "date" in value:
        return pd.Timestamp(value["date"])
    if "device" in value:
        return "cpu"  # the device of the training may not exist here
    named = "mapping" not in value
    parts = value["fields" if named else "mapping"].items()
    found = {name: restored(part, tensors) for name, part in parts}
    if not named:
        return found
    if "cell" in value:
        for name in dir(networks):  # it may be one of them, which are loaded on their first use
            getattr(networks, name)
        return _cell(_loaded(value["cell"], value.get("module")), found)
    kind = _loaded(value["class"], value.get("module"))
    if issubclass(kind, Saved):
        return kind.from_dict(found)
    _check_numbers(kind, found)
    return kind(**found)


def _loaded(name: str, module: str | None) -> Any:
    """Return the class of that name and module, or the only one of that name elsewhere.

    It is looked up in the modules that are loaded; without a module it is one of the package.
    """
    own = _inside(sys.modules.get(module or ""), name, module)
    loaded = [*sys.modules.items()] if own is None else []
    places = [each for at, each in loaded if module or at.startswith(_PACKAGE)]
    found = [*{own, *(_inside(each, name, module) for each in places)} - {None}]
    if len(found) == 1:
        return found[0]
    said, where = str(name)[:60], str(module)[:60]
    if module is None:
        raise InputError(f"the class {said} is not known")
    raise InputError(
        f"the class {said} is not known here: import {where} first, which defined it where the "
        "model was saved"
    )


def _inside(place: Any, name: str, module: str | None) -> type | None:
    """Return the class of that name in a module, if it may be restored; imports nothing."""
    for part in name.split("."):
        place = getattr(place, "__dict__", {}).get(part)
    if not isinstance(place, type) or _of_package(place) != (module is None):
        return None
    torch = sys.modules.get("torch")
    cell = torch is not None and issubclass(place, torch.nn.Module) and issubclass(place, Template)
    return place if cell or issubclass(place, Saved) or is_saved(place) else None


def _of_package(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == _PACKAGE


def _cell(kind: Any, parts: dict[str, Any]) -> Any:
    """Return a template of a cell: on the meta device, where weights take no memory."""
    import torch  # noqa: PLC0415  just what has networks needs it

    for name, part in parts.items():
        if isinstance(part, int) and abs(part) > LARGEST_NUMBER:
            raise InputError(f"{name} must be a whole number up to {LARGEST_NUMBER}, got {part}")
    try:
        with torch.device("meta"):
            return kind(**parts)
    except RuntimeError:  # a user's cell may need values, which the meta device does not have
        return kind(**parts)


def _check_numbers(kind: type, parts: Mapping[str, Any]) -> None:
    """Raise ValueError for a field that must be a number or an array and is neither."""
    for name, wanted in get_type_hints(kind).items():
        part = parts.get(name, 0)
        if wanted is int:
            whole(name, part, None)
        elif wanted is float and (isinstance(part, bool) or not isinstance(part, int | float)):
            raise InputError(f"{name} must be a number, got {str(part)[:60]!r}")
        elif get_origin(wanted) is np.ndarray and not isinstance(parts.get(name), np.ndarray):
            raise InputError(f"{name} must be an array, got {str(parts.get(name))[:60]!r}")
