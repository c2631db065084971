"""Describe values as JSON and arrays, and restore them from the description.

A description contains the name of the class. Only classes that exist in the running process are
restored: nothing is imported, and no function that a file names is called. These classes are the
package's that are marked as `saved`, restored from their fields; subclasses of the bases given to
`Classes`, restored by `from_dict` from the result of `to_dict`; and cells, which are modules with a
method `sized`, restored from the arguments of their constructor.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband import networks
from splitband.runtime.arguments import whole
from splitband.runtime.options import SAVED, options

Tensors = dict[str, npt.NDArray[Any]]
"""The arrays and the weights of a forecaster, by their place in it."""

_PACKAGE = __name__.partition(".")[0]
_LARGEST = 1_000_000
"""Largest whole number that a cell's constructor gets: a larger one in a file is a forgery.
By eye."""


def described(value: Any, tensors: Tensors, place: str = "") -> Any:  # noqa: PLR0911  a line a kind
    """Return a value as JSON, and put its arrays into `tensors`, by their place in the value.

    Raises
    ------
    ValueError
        For a value that cannot be described.
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, np.generic):
        return described(value.item(), tensors, place)
    if isinstance(value, float):
        return value if math.isfinite(value) else {"number": str(value)}
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "biufc":
            raise ValueError(f"an array of {value.dtype} cannot be saved")
        tensors[place] = np.array(value, order="C")
        return {"array": place}
    if isinstance(value, pd.Timestamp):
        return {"date": value.isoformat()}
    if callable(getattr(value, "to_dict", None)):
        return _named("made", type(value), value.to_dict(), tensors, place)
    if type(value) in SAVED.values():
        parts = {name: getattr(value, name) for name in _fields(type(value))}
        return _named("class", type(value), parts, tensors, place)
    if isinstance(value, Mapping):
        return {"mapping": _parts(value, tensors, place)}
    if isinstance(value, list | tuple | frozenset):
        ordered = sorted(value) if isinstance(value, frozenset) else value
        inner = [described(v, tensors, f"{place}.{i}") for i, v in enumerate(ordered)]
        return {type(value).__name__: inner}
    if "torch" in sys.modules:  # otherwise it can be nothing of torch's
        return _of_torch(value, tensors, place)
    raise ValueError(f"{type(value).__name__} cannot be saved with a forecaster")


def _of_torch(value: Any, tensors: Tensors, place: str) -> Any:
    """Return the description of a tensor, a device or a cell."""
    import torch  # noqa: PLC0415  see `described`

    if isinstance(value, torch.Tensor):
        try:
            array = value.detach().cpu().numpy()
        except TypeError:
            raise ValueError(f"a tensor of {value.dtype} cannot be saved") from None
        return described(array, tensors, place)
    if isinstance(value, torch.device):
        return {"device": str(value)}
    if isinstance(value, torch.nn.Module):
        try:
            parts = options(value)
        except TypeError as error:
            raise ValueError(f"{type(value).__name__} cannot be saved: {error}") from None
        return _named("cell", type(value), parts, tensors, place)
    raise ValueError(f"{type(value).__name__} cannot be saved with a forecaster")


class Classes:
    """Restore described values, of classes that exist in the running process.

    Parameters
    ----------
    bases : Classes whose subclasses have `to_dict` and `from_dict`.
    tensors : The arrays.
    """

    def __init__(self, bases: tuple[type, ...], tensors: Tensors) -> None:
        self.bases, self.tensors = bases, tensors

    def made(self, value: Any) -> Any:  # noqa: PLR0911  a line a kind
        """Return the object that `value` describes.

        Raises
        ------
        ValueError
            For an unknown class, or a value that is not a description; a damaged description may
            raise other errors, too.
        """
        if not isinstance(value, dict):
            return value
        for of_parts in (list, tuple, frozenset):
            if of_parts.__name__ in value:
                return of_parts(self.made(part) for part in value[of_parts.__name__])
        if "array" in value:
            return np.array(self.tensors[value["array"]])
        if "number" in value:
            return float(value["number"])
        if "date" in value:
            return pd.Timestamp(value["date"])
        if "device" in value:
            return "cpu"  # the device of the training may not exist here
        if "mapping" in value:
            return self._all(value["mapping"])
        if "made" in value:
            known = [each for base in self.bases for each in _below(base)]
            again: Any = _found(value, "made", known)
            return again.from_dict(self._all(value["fields"]))
        if "class" in value:
            name = value["class"]
            if name not in SAVED:
                raise ValueError(f"the class {str(name)[:60]} is not known")
            parts = self._all(value["fields"])
            _check_numbers(SAVED[name], parts)
            return SAVED[name](**parts)
        return _cell(value, self._all(value["fields"]))

    def _all(self, parts: Any) -> dict[str, Any]:
        return {name: self.made(part) for name, part in parts.items()}


def _named(
    word: str, kind: type, parts: Mapping[str, Any], tensors: Tensors, place: str
) -> dict[str, Any]:
    """Return the description of an object by its class and parts."""
    own = not _of_package(kind)
    said = {word: kind.__qualname__} | ({"module": kind.__module__} if own else {})
    return said | {"fields": _parts(parts, tensors, place)}


def _parts(parts: Mapping[str, Any], tensors: Tensors, place: str) -> dict[str, Any]:
    if not all(isinstance(name, str) for name in parts):
        raise ValueError("a mapping that is saved with a forecaster must have texts as keys")
    dot = "." if place else ""
    return {name: described(v, tensors, f"{place}{dot}{name}") for name, v in parts.items()}


def _found(value: Mapping[str, Any], word: str, kinds: list[type]) -> type:
    """Return the class of that name and module, or the only one of that name elsewhere."""
    name, module = value[word], value.get("module")
    known = [k for k in kinds if k.__qualname__ == name and _of_package(k) == (module is None)]
    there = [kind for kind in known if module in (None, kind.__module__)] or known
    if len({kind.__module__ for kind in there}) == 1:
        return there[-1]  # the latest definition, where a notebook defines a class repeatedly
    said, where = str(name)[:60], str(module)[:60]
    if module is None:
        raise ValueError(f"the class {said} is not known")
    raise ValueError(
        f"the class {said} is not known here: import {where} first, which defined it where the "
        "model was saved"
    )


def _below(kind: type) -> Iterator[type]:
    """Yield all subclasses; where classes are defined again, the later ones come later."""
    seen: dict[type, None] = {kind: None}
    todo = deque([kind])
    while todo:
        each: type
        for each in type.__subclasses__(todo.popleft()):
            if each not in seen:
                seen[each] = None
                todo.append(each)
                yield each


def _of_package(kind: type) -> bool:
    return kind.__module__.partition(".")[0] == _PACKAGE


def _cell(value: Mapping[str, Any], parts: dict[str, Any]) -> Any:
    """Return a template of a cell: on the meta device, where weights take no memory."""
    import torch  # noqa: PLC0415  just what has networks needs it

    _ = networks.GRU, networks.EulerMLP, networks.StateSpace  # load them, as they may be meant
    cells = [each for each in _below(torch.nn.Module) if hasattr(each, "sized")]
    kind = _found(value, "cell", cells)
    for name, part in parts.items():
        if isinstance(part, int) and abs(part) > _LARGEST:
            raise ValueError(f"{name} must be a whole number up to {_LARGEST}, got {part}")
    try:
        with torch.device("meta"):
            return kind(**parts)
    except RuntimeError:  # a user's cell may need values, which the meta device does not have
        return kind(**parts)


def _fields(kind: Any) -> list[str]:
    """Return the names of the fields that a class is restored from."""
    named: tuple[str, ...] | None = getattr(kind, "_fields", None)
    return [*named] if named else [field.name for field in fields(kind) if field.init]


def _check_numbers(kind: type, parts: Mapping[str, Any]) -> None:
    """Raise ValueError for a field that must be a number or an array and is neither."""
    for name, wanted in get_type_hints(kind).items():
        part = parts.get(name, 0)
        if wanted is int:
            whole(name, part, None)
        elif wanted is float and (isinstance(part, bool) or not isinstance(part, int | float)):
            raise ValueError(f"{name} must be a number, got {str(part)[:60]!r}")
        elif get_origin(wanted) is np.ndarray and not isinstance(parts.get(name), np.ndarray):
            raise ValueError(f"{name} must be an array, got {str(parts.get(name))[:60]!r}")
