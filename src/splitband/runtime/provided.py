"""Let lower layers call functions of higher ones without importing them: tables, pages, exports.

A result or a forecaster shows, saves and exports itself by functions of higher layers, which
import its class. It looks them up by task. `splitband.__init__` registers the function of each
task, so that no module names one of a higher layer.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

_PLACES: dict[str, str] = {}


def provide(places: Mapping[str, str]) -> None:
    """Register the function of each task as "module:function", which is imported when used."""
    _PLACES.update(places)


def provided(what: str) -> Callable[..., Any]:
    """Return the function registered for a task; raises KeyError if there is none."""
    module, name = _PLACES[what].split(":")
    found: Callable[..., Any] = getattr(import_module(module), name)
    return found
