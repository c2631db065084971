"""Keep the results of slow functions, by a hash of all that they depend on."""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import wraps
from typing import Any, NamedTuple, ParamSpec, TypeVar

import numpy as np

from splitband.runtime.deadlines import current
from splitband.runtime.threads import one_thread

P = ParamSpec("P")
R = TypeVar("R")


class Kept(NamedTuple):
    """Hold a result, and whether a deadline had passed when it was there."""

    result: Any
    late: bool


KEPT: dict[str, Kept] = {}
"""Results by the hash of function and arguments; the latest come last."""
MOST = 100
"""Largest number of results that are kept. Bounds the memory."""


def cached(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that computes each result once; arguments are compared by content.

    The results must depend on the arguments only: arrays and numbers, or lists of them. What a
    deadline may have cut short counts under a deadline alone. The function runs on one thread, so
    that its result is equal to the bit in every process.
    """

    @wraps(function)
    def found(*arguments: P.args, **named: P.kwargs) -> R:
        key = key_of(function.__module__, function.__qualname__, arguments, named)
        if key not in KEPT or (KEPT[key].late and current().at == math.inf):
            with one_thread():
                result = function(*arguments, **named)
            keep({key: Kept(result, current().over)})
        kept: R = KEPT[key].result
        return kept

    return found


def keep(results: Mapping[str, Kept]) -> None:
    """Add results, such as those of another process; the oldest are dropped."""
    KEPT.update(results)
    for key in [*KEPT][:-MOST]:
        del KEPT[key]


def key_of(*parts: Any) -> str:
    """Return a hash of the parts: of arrays and tensors by content, of the others by `repr`.

    Lists and dicts are taken apart. What else holds arrays shows all their numbers in its `repr`.
    """
    digest = hashlib.sha256()
    for part in (inner for each in parts for inner in _parts(each)):
        is_tensor = hasattr(part, "detach")
        values = part.detach().cpu().contiguous().numpy() if is_tensor else part
        if isinstance(values, np.ndarray) and not values.dtype.hasobject:
            digest.update(str((part.dtype, tuple(part.shape))).encode())
            digest.update(values.tobytes())
        else:
            with np.printoptions(threshold=sys.maxsize, floatmode="unique"):
                digest.update(repr(part).encode())
        digest.update(b"\0")
    return digest.hexdigest()


def _parts(value: Any) -> Iterator[Any]:
    """Yield the lengths and elements of nested lists and dicts."""
    if isinstance(value, dict):
        value = [*value.items()]
    if isinstance(value, list | tuple):
        yield len(value)
        for part in value:
            yield from _parts(part)
    else:
        yield value
