"""Read the constructor arguments of an object from its attributes of the same names.

If such an attribute is a property with a derived value, such as a full `name`, the argument is
kept in an attribute with a leading underscore.
"""

from __future__ import annotations

import inspect
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import PurePath
from types import FunctionType
from typing import Any

import numpy as np

import splitband

UNKNOWN = "..."
"""Stands for a value without a short expression, such as an array."""


class WithRepr:
    """Define a `repr` that is Python code to create the object, with `sb` for the package."""

    def __repr__(self) -> str:
        return expression(self)


def options(value: object) -> dict[str, Any]:
    """Return the constructor arguments of `value`, by name."""
    kind: Any = type(value)
    found = {}
    for parameter in _parameters(kind):
        name = parameter.name
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            raise TypeError(
                f"the constructor of {kind.__name__} must name its arguments, got *{name}"
            )
        attribute = _attribute(kind, name)
        try:
            found[name] = getattr(value, attribute)
        except AttributeError:
            rule = f"keep its constructor's argument {name} in the attribute {attribute}"
            raise TypeError(f"{kind.__name__} must {rule}, it has none") from None
    return found


def _attribute(kind: type, argument: str) -> str:
    """Return the name of the attribute that keeps a constructor's argument."""
    return f"_{argument}" if isinstance(getattr(kind, argument, None), property) else argument


def option_attributes(value: object) -> set[str]:
    """Return the names of the attributes that keep the constructor arguments of `value`."""
    kind: Any = type(value)
    return {_attribute(kind, parameter.name) for parameter in _parameters(kind)}


@cache  # a table of methods asks hundreds of times for the same few
def _parameters(kind: Any) -> tuple[inspect.Parameter, ...]:
    """Return the constructor's parameters, without fields that a dataclass's `repr` leaves out."""
    if kind.__init__ is object.__init__:
        return ()
    left = {f.name for f in fields(kind) if not f.repr} if is_dataclass(kind) else set()
    found = inspect.signature(kind).parameters.values()
    return tuple(each for each in found if each.name not in left)


def expression(value: object) -> str:  # noqa: PLR0911  a line for each kind
    """Return Python code that creates `value`; "..." for what has no short expression."""
    own_cell = callable(getattr(value, "sized", None)) and not isinstance(value, type)
    if isinstance(value, WithRepr) or own_cell:
        return _call(value)
    if isinstance(value, FunctionType) and value.__name__.isidentifier():
        return value.__name__
    if isinstance(value, tuple | list):
        inner = ", ".join(expression(part) for part in value)
        comma = "," if len(value) == 1 else ""
        return f"[{inner}]" if isinstance(value, list) else f"({inner}{comma})"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{expression(k)}: {expression(v)}' for k, v in value.items())}}}"
    if isinstance(value, PurePath):
        return repr(str(value))
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value.item() if isinstance(value, np.generic) else value)
    return UNKNOWN


def _call(value: object) -> str:
    kind: Any = type(value)
    public = {"sb.": splitband, "sb.networks.": splitband.networks}
    places = (at for at, holder in public.items() if getattr(holder, kind.__name__, None) is kind)
    package = next(places, "")
    try:
        given = options(value)
    except TypeError:
        return f"{package}{kind.__name__}({UNKNOWN})"
    shown = []
    for i, parameter in enumerate(_parameters(kind)):
        option, required = given[parameter.name], parameter.default is parameter.empty
        if not required and _same(option, parameter.default):
            continue
        leading = required or (i == 0 and not is_dataclass(value))
        shown.append(f"{'' if leading else f'{parameter.name}='}{expression(option)}")
    return f"{package}{kind.__name__}({', '.join(shown)})"


def _same(value: Any, other: Any) -> bool:
    """Return whether two options are equal; False if they cannot be compared, such as arrays."""
    try:
        return value is other or (type(value) is type(other) and bool(value == other))
    except (TypeError, ValueError):
        return False
