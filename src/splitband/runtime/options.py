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
from typing import Any, TypeVar

UNKNOWN = "..."
"""Stands for a value without a short expression, such as an array."""


Kind = TypeVar("Kind", bound=type)

SAVED: dict[str, type] = {}
"""Classes that are saved with a forecaster, by name."""


def saved(kind: Kind) -> Kind:
    """Mark a dataclass or a named tuple as saved with a forecaster, and restored, by its fields."""
    assert kind.__name__ not in SAVED, kind
    SAVED[kind.__name__] = kind
    return kind


class WithRepr:
    """Define a `repr` that is Python code to create the object, with `sb` for the package."""

    def __repr__(self) -> str:
        return expression(self)


def options(value: object) -> dict[str, Any]:
    """Return the constructor arguments of `value`, by name.

    Raises TypeError if an argument is not kept as an attribute, or has no name (*args, **kwargs).
    """
    return {name: getattr(value, attribute) for name, attribute in attributes(value).items()}


def attributes(value: object) -> dict[str, str]:
    """Return the attribute that holds each option of `value`; raises TypeError as `options`."""
    kind, found = type(value), {}
    for parameter in _parameters(value):
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            raise TypeError(
                f"the constructor of {kind.__name__} must name its arguments, got *{parameter.name}"
            )
        derived = isinstance(getattr(kind, parameter.name, None), property)
        found[parameter.name] = attribute = f"{'_' * derived}{parameter.name}"
        if not hasattr(value, attribute):
            raise TypeError(
                f"{kind.__name__} must keep its constructor's argument {parameter.name} in the "
                f"attribute {attribute}, it has none"
            )
    return found


def expression(value: object) -> str:  # noqa: PLR0911  a line for each kind
    """Return Python code that creates `value`, with the options that differ from their defaults.

    An ellipsis stands for a value without a short expression; a function is given by its name.
    """
    if isinstance(value, WithRepr) or _is_own(value):
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
        return repr(getattr(value, "item", lambda: value)())
    return UNKNOWN


def _call(value: object) -> str:
    kind = type(value)
    package = "sb." if kind.__module__.startswith("splitband.") else ""
    try:
        given = options(value)
    except TypeError:
        return f"{package}{kind.__name__}({UNKNOWN})"
    shown = []
    for i, parameter in enumerate(_parameters(value)):
        option, required = given[parameter.name], parameter.default is parameter.empty
        if not required and _same(option, parameter.default):
            continue
        leading = required or (i == 0 and not is_dataclass(value))
        shown.append(f"{'' if leading else f'{parameter.name}='}{expression(option)}")
    return f"{package}{kind.__name__}({', '.join(shown)})"


def _parameters(value: object) -> list[inspect.Parameter]:
    """Return the constructor's parameters, without fields that a dataclass's `repr` leaves out."""
    left = {f.name for f in fields(value) if not f.repr} if is_dataclass(value) else set()
    if type(value).__init__ is object.__init__:
        return []
    kind: Any = type(value)
    return [p for p in _constructor(kind) if p.name not in left]


@cache  # a table of methods asks hundreds of times for the same few
def _constructor(kind: type) -> tuple[inspect.Parameter, ...]:
    return tuple(inspect.signature(kind).parameters.values())


def _is_own(value: object) -> bool:
    """Return whether `value` is a cell, such as a user's own."""
    return callable(getattr(value, "sized", None)) and not isinstance(value, type)


def _same(value: Any, other: Any) -> bool:
    """Return whether two options are equal; False if they cannot be compared, such as arrays."""
    try:
        return value is other or (type(value) is type(other) and bool(value == other))
    except (TypeError, ValueError):
        return False
