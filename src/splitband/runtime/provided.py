"""Let lower layers call functions of higher ones without importing them: tables, pages, exports.

A result or a forecaster shows, saves and exports itself, by code that needs to know it. It asks for
that code by what it does. Where the code is, the front of the package says (`splitband.__init__`),
so that no module names one that stands above it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

_PLACES: dict[str, str] = {}


def provide(places: Mapping[str, str]) -> None:
    """Say where things are done: by what is done, "module:function", imported when used."""
    _PLACES.update(places)


def provided(what: str) -> Callable[..., Any]:
    """Return the function that does it; raises KeyError for what nobody has provided."""
    module, name = _PLACES[what].split(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found
