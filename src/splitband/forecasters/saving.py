"""Save forecasters to folders, whole or not at all; `loading` reads them.

A folder holds forecaster.json and one safetensors file. The former has the `kind` of the forecaster
(its class; of one of the user's also the `module`), the `options` of its constructor, and the
`facts` of its fit: texts and single numbers. The latter has the arrays of the fit, and those among
options. It is named after its content, so that an interrupted `save` leaves the previous pair
intact. Of a simulator that is not recorded output only a description is saved (`Absent`).
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
    description = _encoded(forecaster, arrays, "options/") | {"facts": {}}
    for name, value in arrays_of(forecaster).items():
        array = array_of(value)
        if array.dtype.kind == "U" or _is_number(array):
            description["facts"][name] = array.tolist()
        else:
            arrays[name] = np.array(array, order="C")
    content = safetensors.numpy.save(arrays)
    digest = hashlib.sha256(content).hexdigest()
    said = {"format": FORMAT, "weights_sha256": digest, "forecaster": description}
    text = to_json({**(facts or {}), **said})
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


def arrays_of(forecaster: Forecaster) -> Arrays:
    """Return all that is saved of a fit: arrays by name, texts and single numbers among them."""
    fitted = forecaster.require_fitted().end(forecaster.first_needed())
    common = {name: getattr(forecaster, name) for name in COMMON} | {"fitted": fitted}
    return named({name: taken_apart(value) for name, value in common.items()}) | forecaster.state()


def restored(kind: type[Forecaster], options: Mapping[str, Any], arrays: Arrays) -> Forecaster:
    """Return the forecaster with these options and the fit of `arrays_of`."""
    parts = by_part(arrays)
    common = {name: rebuilt(of, parts.pop(name, {}), name) for name, of in COMMON.items()}
    new = kind.from_state(options, named(parts))
    vars(new).update(common)
    new.complete()
    return new


def state_of(forecaster: Forecaster, *others: str) -> Arrays:
    """Return the arrays of the attributes of a fit but `others`, see `Forecaster.state`."""
    parts, kind = dict[str, Arrays](), type(forecaster)
    for name in sorted(
        vars(forecaster).keys() - {*option_attributes(forecaster), *COMMON, *others}
    ):
        value, of = vars(forecaster)[name], kind.state_types.get(name)
        if isinstance(of, str):
            parts[name] = named({str(i): arrays_of(x) for i, x in enumerate(listed(value))})
        elif of is not None:
            parts[name] = taken_apart(value)
        elif value is not None or getattr(kind, name, ...) is not None:
            try:
                parts[name] = {"": array_of(value)}
            except ValueError as error:
                raise InputError(
                    f"{kind.__name__} cannot be saved with its attribute {name} ({error}): set "
                    "arrays, numbers and texts alone, or define state() and from_state()"
                ) from None
    return named(parts)


def attributes_of(new: Forecaster, arrays: Arrays) -> dict[str, Any]:
    """Return the attributes of a fit; raises ValueError for missing ones, and names of methods."""
    parts, types, found = by_part(arrays), type(new).state_types, dict[str, Any]()
    for name in sorted({*parts, *types}):
        own, of, part = getattr(type(new), name, ...), types.get(name), parts.get(name, {})
        if callable(own) or isinstance(own, property):
            raise InputError(f"{name[:60]} must not be replaced in a {type(new).__name__}")
        if isinstance(of, str) and part:
            templates, by_index = listed(getattr(new.clone(), of)), by_part(part)
            fits = [
                restored(type(each), each.get_params(), by_index.pop(str(i)))
                for i, each in enumerate(templates)
            ]
            found[name] = fits if isinstance(getattr(new, of), list) else fits[0]
        elif of is None:
            (array,) = part.values()
            found[name] = array.item() if array.ndim == 0 else array
        elif part or own is ...:
            found[name] = rebuilt(of, part, name)
    return found


def listed(value: Any) -> list[Any]:
    """Return one or several forecasters, or none, as a list."""
    return value if isinstance(value, list) else [] if value is None else [value]


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
        given = getattr(value, "saved_options", lambda: options(value))
        try:
            return _kind(value) | {"options": _encoded_parts(given(), arrays, f"{place}.")}
        except TypeError as error:  # of `options`
            raise InputError(f"{type(value).__name__} cannot be saved: {error}") from None
    raise InputError(
        f"{type(value).__name__} cannot be saved as the option {place.partition('.')[2]}: it is no "
        "number, text, date, array, list, tuple or dict"
    )
