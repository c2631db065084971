"""Take frozen dataclasses apart into arrays by name, and build them again from these.

A field holds what its annotation says: an array, a number or a text; several of these or of
dataclasses in a tuple; a mapping from texts to numbers or several; or another dataclass. Names of
parts are joined by dots. Texts are arrays, too. None and an empty mapping have no array, nor has a
field that `repr` leaves out. The classes are those of annotations, never those of a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.runtime.errors import InputError

Arrays = dict[str, npt.NDArray[Any]]
"""Arrays by the name of what they are part of; a single one by the name ""."""
_SINGLE = bool | int | float | str | np.generic
_NUMBERS: dict[Any, Any] = {float: int | float, bool: bool, int: int, str: str}


def array_of(value: Any) -> npt.NDArray[Any]:
    """Return an array, a number or a text as an array; raises ValueError for others."""
    if type(value) is not np.ndarray and not isinstance(value, _SINGLE):
        raise InputError(f"{type(value).__name__} cannot be saved")
    array = np.asarray(value)
    if array.dtype.kind != "U" and not (array.dtype.kind in "biuf" and array.dtype.itemsize <= 8):
        raise InputError(f"an array of {array.dtype} cannot be saved")
    return array


def taken_apart(value: Any) -> Arrays:
    """Return the arrays of a value, see the module; raises ValueError for what has none."""
    if value is None:
        return {}
    if is_dataclass(value):
        return named({name: taken_apart(getattr(value, name)) for name in _kept(type(value))})
    if isinstance(value, Mapping):
        return named({name: taken_apart(part) for name, part in value.items()})
    if isinstance(value, tuple | list):
        if all(isinstance(each, _SINGLE) for each in value):
            return {"": array_of(np.array(value))}
        return named({str(i): taken_apart(each) for i, each in enumerate(value)})
    return {"": array_of(value.isoformat() if isinstance(value, pd.Timestamp) else value)}


def named(parts: Mapping[str, Arrays]) -> Arrays:
    """Return the arrays of several parts by their full names."""
    return {
        f"{part}.{name}" if name else part: array
        for part, arrays in parts.items()
        for name, array in arrays.items()
    }


def by_part(arrays: Arrays) -> dict[str, Arrays]:
    """Return the arrays of each part; the inverse of `named`."""
    found: dict[str, Arrays] = {}
    for full, array in arrays.items():
        part, _, name = full.partition(".")
        found.setdefault(part, {})[name] = array
    return found


def rebuilt(hint: Any, arrays: Arrays, name: str) -> Any:
    """Return the value of an annotation from its arrays; the inverse of `taken_apart`."""
    hints = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    kind, inner = get_origin(hints[0]), get_args(hints[0])
    if not arrays and (hint is Any or NoneType in hints):
        return None
    if is_dataclass(hints[0]):
        return _object(hints[0], arrays, name)
    if kind in (dict, Mapping):
        return {key: rebuilt(inner[1], {"": array}, name) for key, array in arrays.items()}
    if kind in (tuple, Sequence):
        by_index, single = by_part(arrays), arrays.keys() == {""}
        parts = (
            [{"": each} for each in np.atleast_1d(arrays[""])]
            if single
            else [by_index[str(i)] for i in range(len(by_index))]
        )
        alike = inner[1:] in ((), (...,))
        of = inner[:1] * len(parts) if alike else inner
        return tuple(rebuilt(h, part, name) for h, part in zip(of, parts, strict=True))
    if arrays.keys() != {""}:
        raise InputError(f"{name} is {'damaged' if arrays else 'missing'}")
    if np.ndarray not in (kind, hints[0]):
        return _single(hints, arrays[""], name)
    wanted = np.dtype(get_args(inner[1])[0]) if inner else arrays[""].dtype
    if arrays[""].dtype.kind != wanted.kind:
        raise InputError(f"{name} must be an array of {wanted}, got {arrays[''].dtype}")
    return arrays[""]


def _kept(kind: Any) -> list[str]:
    """Return the fields of a dataclass that are kept."""
    return [each.name for each in fields(kind) if each.init and each.repr]


def _object(kind: Any, arrays: Arrays, name: str) -> Any:
    """Return the object of a dataclass; raises ValueError for parts that it has not."""
    parts, hints, kept = by_part(arrays), get_type_hints(kind), _kept(kind)
    if unknown := parts.keys() - {*kept}:
        raise InputError(f"{name} is damaged: it has {min(unknown)[:60]!r}")
    return kind(**{part: rebuilt(hints[part], parts.get(part, {}), part) for part in kept})


def _single(hints: Sequence[Any], array: Any, name: str) -> Any:
    """Return a number, a text or a date, if it is of one of these types."""
    value = array.item() if array.ndim == 0 else array.tolist()
    for hint in hints:
        if hint is pd.Timestamp and isinstance(value, str):
            return pd.Timestamp(value)
        if hint is int and isinstance(value, float) and value.is_integer():
            return int(value)  # beside others in one array, which are none
        fits = isinstance(value, _NUMBERS.get(hint, ()))
        if (fits and isinstance(value, bool) == (hint is bool)) or value in get_args(hint):
            return value
    raise InputError(f"{name} must not be {str(value)[:60]!r}")
