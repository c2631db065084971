"""Save forecasters to folders, whole or not at all; `loading` reads them.

A folder holds forecaster.json and one safetensors file. The former has for a forecaster its `kind`
(the class; of one of the user's also the `module`), the `options` of its constructor, the `facts`
of its fit (texts and single numbers), and the fitted forecasters that it consists of (`parts`). The
latter has the arrays of the fit (`Forecaster.state`), of parts under their place. It is named after
its content, so that an interrupted `save` leaves the previous pair intact. Of a simulator that is
not recorded output only a description is saved (`simulators.base.Absent`).
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import safetensors.numpy

from splitband.forecasters.fitted import Fitted
from splitband.forecasters.intervals import HeldOut
from splitband.networks.cell import Template
from splitband.runtime import outputs
from splitband.runtime.errors import InputError
from splitband.runtime.files import replacing, to_json, write_text
from splitband.runtime.options import WithRepr, option_attributes, options
from splitband.runtime.states import Arrays, array_of, by_part, named, rebuilt, taken_apart
from splitband.simulators.base import Absent, KnownSimulator, Recorded

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster

COMMON: dict[str, Any] = {"fitted": Fitted, "delays": tuple[int, ...], "held_out": HeldOut | None}
"""What is saved of every forecaster beside its `state`, and of which type it is."""
FORMAT = 9
"""Version of the description, which changes with attributes of what is saved, and their meaning."""
FILE, WEIGHTS = outputs.DESCRIPTION, outputs.WEIGHTS
LARGEST_DESCRIPTION = 2**28
"""Largest size of a description in bytes: bounds the memory."""
DIGITS = 16
"""Digits of the weights' SHA-256 in the name of their file: enough to be unique."""


def save(
    forecaster: Forecaster, folder: str | Path, facts: Mapping[str, Any] | None = None
) -> None:
    """Write a fitted forecaster to a folder, whole or not at all.

    Parameters
    ----------
    forecaster : Fitted. The options of one of your own must be numbers, texts, dates, arrays,
        lists, tuples and dicts of these, and objects of the package; for its fit see
        `Forecaster.state`.
    folder : Created if it does not exist.
    facts : Further entries of the JSON file.

    Raises
    ------
    ValueError
        For a forecaster that has not been fitted, or holds a value that cannot be saved.
    """
    folder, arrays = Path(folder), Arrays()
    description = _described(forecaster, arrays, "")
    content = safetensors.numpy.save(arrays)
    digest = hashlib.sha256(content).hexdigest()
    text = to_json(
        {**(facts or {}), "format": FORMAT, "weights_sha256": digest, "forecaster": description}
    )
    folder.mkdir(parents=True, exist_ok=True)
    weights = folder / WEIGHTS.format(digest[:DIGITS])
    if not weights.is_file() or weights.read_bytes() != content:
        with replacing(weights) as new:
            new.write_bytes(content)
    try:
        write_text(folder / FILE, text)
    finally:
        _remove_outdated(folder)


def files(folder: Path) -> list[Path]:
    """Return the files of the forecaster that a folder holds, and those of interrupted saves."""
    pattern = re.compile(WEIGHTS.format(f"[0-9a-f]{{{DIGITS}}}").replace(".", r"\."))
    found = [path for path in folder.glob(WEIGHTS.format("*")) if pattern.fullmatch(path.name)]
    return [folder / FILE, *found] if (folder / FILE).is_file() else found


def read_description(folder: Path) -> dict[str, Any]:
    """Return the content of the JSON file; raises various errors for a damaged one."""
    size = (folder / FILE).stat().st_size
    if size > LARGEST_DESCRIPTION:
        raise InputError(f"it is larger than {LARGEST_DESCRIPTION} bytes")
    return dict(json.loads((folder / FILE).read_text(encoding="utf-8")).items())


def _remove_outdated(folder: Path) -> None:
    """Remove weight files that do not belong to the current description."""
    try:
        digest = str(read_description(folder)["weights_sha256"])
    except (OSError, ValueError, LookupError, AttributeError, TypeError, RecursionError):
        digest = ""
    for path in files(folder):
        if path.name not in (FILE, WEIGHTS.format(digest[:DIGITS])):
            path.unlink(missing_ok=True)


def _described(forecaster: Forecaster, arrays: Arrays, place: str) -> dict[str, Any]:
    """Return a fitted forecaster as JSON, and put its arrays into `arrays`, under its place."""
    fitted = forecaster.require_fitted().end(forecaster.first_needed())
    common = {**{name: getattr(forecaster, name) for name in COMMON}, "fitted": fitted}
    found = named({name: taken_apart(value) for name, value in common.items()})
    facts = {}
    for name, value in {**found, **forecaster.state()}.items():
        array = array_of(value)
        if array.dtype.kind == "U" or _is_number(array):
            facts[name] = array.tolist()
        else:
            arrays[place + name] = np.array(array, order="C")
    parts: dict[str, Any] = {}
    for name, part in forecaster.fitted_parts().items():
        at = f"{place}{name}/"
        if isinstance(part, list):
            parts[name] = [_described(each, arrays, f"{at}{i}/") for i, each in enumerate(part)]
        else:
            parts[name] = _described(part, arrays, at)
    try:
        given = _encoded_parts(forecaster.saved_options(), arrays, f"{place}options/")
    except TypeError as error:  # of `options`
        raise InputError(f"{type(forecaster).__name__} cannot be saved: {error}") from None
    return _kind(forecaster) | {"options": given, "facts": facts, "parts": parts}


def state_of(forecaster: Forecaster, *others: str) -> Arrays:
    """Return the arrays of the attributes of a fit but `others`, see `Forecaster.state`."""
    parts, kind = dict[str, Arrays](), type(forecaster)
    left = {*option_attributes(forecaster), *forecaster.fitted_parts(), *COMMON, *others}
    for name in vars(forecaster).keys() - left:
        value, known = vars(forecaster)[name], name in forecaster.state_types
        if value is None and getattr(kind, name, ...) is None:
            continue
        try:
            parts[name] = taken_apart(value) if known else {"": array_of(value)}
        except ValueError as error:
            raise InputError(
                f"{kind.__name__} cannot be saved with its attribute {name}, which is no array, "
                f"number or text ({error}): define state() and from_state()"
            ) from None
    return named({name: parts[name] for name in sorted(parts)})


def attributes_of(kind: type[Forecaster], arrays: Arrays) -> dict[str, Any]:
    """Return the attributes of a fit from their arrays; raises ValueError for missing ones."""
    parts, types = by_part(arrays), kind.state_types
    for name in parts:
        check_attribute(kind, name)
    found = {name: array.item() if array.ndim == 0 else array for name, array in arrays.items()}
    wanted = {name for name in types if name in parts or not hasattr(kind, name)}
    return found | {name: rebuilt(types[name], parts.get(name, {}), name) for name in wanted}


def check_attribute(kind: type, name: str) -> None:
    """Raise ValueError for the name of a method or a property: nothing in a file replaces one."""
    own = getattr(kind, name, None)
    if callable(own) or isinstance(own, property):
        raise InputError(f"{name[:60]} is no attribute of {kind.__name__} that `fit` sets")


def _is_number(array: Any) -> bool:
    """Return whether JSON can hold an array as a number, without a change of its type."""
    plain = array.dtype in (np.bool_, np.int64, np.float64)
    return plain and array.ndim == 0 and bool(np.isfinite(array))


def _kind(value: Any) -> dict[str, str]:
    """Return the class of an object, and its module unless it is the package's."""
    kind = type(value)
    if "<locals>" in kind.__qualname__:
        raise InputError(
            f"{kind.__name__} cannot be saved: its class is defined inside of a function, where "
            "loading cannot find it; define it in a module"
        )
    own = {} if of_package(kind) else {"module": kind.__module__}
    return {"kind": kind.__qualname__, **own}


def of_package(kind: type) -> bool:
    """Return whether a class is defined in this package."""
    return kind.__module__.partition(".")[0] == __name__.partition(".")[0]


def _encoded_parts(given: Mapping[str, Any], arrays: Arrays, place: str) -> dict[str, Any]:
    if not all(isinstance(name, str) for name in given):
        raise InputError("a dict among options must have texts as keys to be saved")
    return {name: _encoded(value, arrays, f"{place}{name}") for name, value in given.items()}


def _encoded(value: Any, arrays: Arrays, place: str) -> Any:  # noqa: PLR0911  a line a kind
    """Return an option as JSON, and put arrays of it into `arrays`, under its place."""
    if isinstance(value, np.generic):
        value = pd.Timestamp(value) if isinstance(value, np.datetime64) else value.item()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else {"number": str(value)}
    if isinstance(value, pd.Timestamp):
        return {"date": value.isoformat()}
    if isinstance(value, np.ndarray):
        arrays[place] = np.array(array_of(value), order="C")
        return {"array": place}
    if isinstance(value, Mapping):
        return {"dict": _encoded_parts(value, arrays, f"{place}.")}
    if type(value) in (list, tuple):
        inner = [_encoded(part, arrays, f"{place}.{i}") for i, part in enumerate(value)]
        return inner if isinstance(value, list) else {"tuple": inner}
    if isinstance(value, KnownSimulator) and not isinstance(value, Recorded):
        value = value.description()
    if isinstance(value, WithRepr | Absent | Template):
        saved = getattr(value, "saved_options", lambda: options(value))
        return _kind(value) | {"options": _encoded_parts(saved(), arrays, f"{place}.")}
    raise TypeError(
        f"the option {place.rpartition('/')[2]} is {type(value).__name__}, no number, "
        "text, date, array, list, tuple or dict"
    )
