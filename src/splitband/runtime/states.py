"""Take frozen dataclasses apart into arrays by name, and build them again from these.

A field holds what its annotation says: an array, a number or a text; several of these, or of
dataclasses, in a tuple; a mapping from texts to one of these; or another dataclass. Names of parts
are joined by dots. Texts are arrays, too. What is None or empty has no array, and neither has a
field that `repr` leaves out. The classes are those of annotations, never those of a file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.runtime.errors import InputError

Arrays = dict[str, npt.NDArray[Any]]
"""Arrays by the name of what they are part of; a single one by the name ""."""


def array_of(value: Any) -> npt.NDArray[Any]:
    """Return an array, a number, a text or a date as an array; raises ValueError for others."""
    array = np.asarray(value.isoformat() if isinstance(value, pd.Timestamp) else value)
    if array.dtype.kind not in "biufU" or (array.dtype.kind != "U" and array.dtype.itemsize > 8):
        said = (
            f"an array of {array.dtype}" if isinstance(value, np.ndarray) else type(value).__name__
        )
        raise InputError(f"{said} cannot be saved")
    return array


def taken_apart(value: Any) -> Arrays:
    """Return the arrays of a value, see the module; raises ValueError for what has none."""
    if value is None:
        return {}
    if is_dataclass(value):
        return named({name: taken_apart(getattr(value, name)) for name in _kept(type(value))})
    if isinstance(value, Mapping):
        pairs = {"names": tuple(value), "values": tuple(value.values())}
        return named({name: taken_apart(part) for name, part in pairs.items()})
    if isinstance(value, tuple | list):
        if not all(isinstance(each, bool | int | float | str | np.generic) for each in value):
            return named({str(i): taken_apart(each) for i, each in enumerate(value)})
        if not value:
            return {}
    return {"": array_of(value)}


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


def rebuilt(hint: Any, arrays: Arrays, name: str) -> Any:  # noqa: PLR0911  a line a kind
    """Return the value of an annotation from its arrays; the inverse of `taken_apart`.

    Raises ValueError for arrays of another kind, and the errors of constructors.
    """
    union = get_origin(hint) in (Union, UnionType)
    hints = get_args(hint) if union else (hint,)
    if not arrays and (hint is Any or NoneType in hints):
        return None
    of_dataclass = [each for each in hints if is_dataclass(each)]
    if of_dataclass:
        return _object(of_dataclass, arrays, name)
    kind = get_origin(hints[0])
    if kind is not None and kind is not Literal and issubclass(kind, Mapping):
        names = rebuilt(tuple[str, ...], by_part(arrays).get("names", {}), name)
        values = tuple[get_args(hints[0])[1], ...]  # type: ignore[misc]
        return dict(
            zip(names, rebuilt(values, by_part(arrays).get("values", {}), name), strict=True)
        )
    if kind in (tuple, Sequence):
        return _several(get_args(hints[0]), arrays, name)
    if arrays.keys() != {""}:
        raise InputError(f"{name} is {'damaged' if arrays else 'missing'}")
    (array,) = arrays.values()
    if kind is np.ndarray:
        wanted = np.dtype(get_args(get_args(hints[0])[1])[0])
        if array.dtype.kind != wanted.kind:
            raise InputError(f"{name} must be an array of {wanted}, got {array.dtype}")
        return array
    if array.ndim:
        raise InputError(f"{name} must be one value, got the shape {array.shape}")
    return _single(hints, array.item(), name)


def _kept(kind: type) -> list[str]:
    """Return the fields of a dataclass that are kept."""
    return [each.name for each in fields(kind) if each.init and each.repr]


def _object(kinds: Sequence[type], arrays: Arrays, name: str) -> Any:
    """Return the object of the first of these classes that has such parts."""
    parts = by_part(arrays)
    fitting = (kind for kind in kinds if parts.keys() <= {*_kept(kind)})
    if (kind := next(fitting, None)) is None:
        raise InputError(f"{name} is damaged: it has {', '.join(map(str, parts))}"[:200])
    hints = get_type_hints(kind)
    found = {part: rebuilt(hints[part], parts.get(part, {}), part) for part in _kept(kind)}
    return kind(**found)


def _several(hints: Sequence[Any], arrays: Arrays, name: str) -> tuple[Any, ...]:
    """Return a tuple from one array, or from the arrays of each element."""
    if arrays.keys() == {""}:
        parts = [{"": np.asarray(each)} for each in np.atleast_1d(arrays[""])]
    else:
        by_index = by_part(arrays)
        parts = [by_index[str(i)] for i in range(len(by_index))]
    each_hint = hints if len(hints) > 1 and hints[1] is not Ellipsis else [hints[0]] * len(parts)
    return tuple(rebuilt(of, part, name) for of, part in zip(each_hint, parts, strict=True))


def _single(hints: Sequence[Any], value: Any, name: str) -> Any:
    """Return a number or text, if it is of one of these kinds."""
    for hint in hints:
        if hint is pd.Timestamp and isinstance(value, str):
            return pd.Timestamp(value)
        if hint is int and isinstance(value, float) and value.is_integer():
            return int(value)  # in one array with others that are none
        allowed = {float: int | float, bool: bool, int: int, str: str}.get(hint)
        fits = allowed is not None and isinstance(value, allowed)
        if (fits and isinstance(value, bool) == (hint is bool)) or value in get_args(hint):
            return value
    raise InputError(f"{name} must not be {str(value)[:60]!r}")
