"""Identify functions by their code and by all that it refers to."""

from __future__ import annotations

import builtins
import hashlib
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

from splitband.simulators.sources import is_users

MOST_DEPTH = 40
"""Depth of objects in objects from which on only their types count. By eye."""


def code_digest(*functions: Callable[..., Any] | None) -> str:
    """Return a digest of functions: their code, and the values and functions that it refers to.

    Names count, of globals and of attributes, so do constants, defaults, closures, functions in
    functions, arguments of a partial, and attributes of objects. It is equal in every process.
    """
    said = hashlib.sha256()
    for part in _parts(functions, set(), {}, 0):
        said.update(len(part).to_bytes(8, "little") + part)
    return said.hexdigest()


def _parts(value: Any, seen: set[int], told: dict[int, int], depth: int) -> Iterator[bytes]:
    """Yield what identifies a value.

    `seen`: values that it is part of; `told`: functions and classes, which are told once.
    """
    value = getattr(value, "py_func", value)  # the source of a Numba function
    yield type(value).__qualname__.encode()
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        yield repr(value).encode()
        return
    if depth > MOST_DEPTH or id(value) in seen:
        return
    if isinstance(value, FunctionType | type):
        if id(value) in told:
            yield b"again %d" % told[id(value)]
            return
        told[id(value)] = len(told)
    seen = seen | {id(value)}
    if isinstance(value, set | frozenset):
        each = (b"".join(_parts(one, seen, dict(told), depth + 1)) for one in value)
        yield from sorted(each)
        return
    if isinstance(value, ModuleType):
        yield from _of_module(value)
        return
    for part in _contents(value):
        yield from _parts(part, seen, told, depth + 1)
    yield b"end"


def _contents(value: Any) -> list[Any]:  # noqa: PLR0911  one kind after the other
    """Return the values that a value consists of."""
    if isinstance(value, CodeType):
        table = getattr(value, "co_exceptiontable", b"")
        shape = value.co_argcount, value.co_kwonlyargcount, value.co_flags
        return [value.co_code, value.co_names, value.co_consts, table, shape]
    if isinstance(value, FunctionType):
        return [value.__code__, value.__defaults__, value.__kwdefaults__, _closure(value),
                _globals(value), vars(value)]  # fmt: skip
    if isinstance(value, MethodType):
        return [value.__func__, value.__self__]
    if isinstance(value, partial):
        return [value.func, value.args, value.keywords]
    if isinstance(value, dict):
        return [part for pair in value.items() for part in pair]
    if isinstance(value, tuple | list):
        return [*value]
    if isinstance(value, np.ndarray) and value.dtype != object:
        return [str(value.dtype), value.shape, value.tobytes()]
    if isinstance(value, type):
        own = is_users(getattr(value, "__module__", ""))
        parts = dict(vars(value)) if own else {}
        used = [n for n in sorted(parts) if not n.startswith("__") or callable(parts[n])]
        return [value.__qualname__, *value.__bases__, {name: parts[name] for name in used}]
    if hasattr(value, "__array__"):
        labels = [np.asarray(axis).tolist() for axis in getattr(value, "axes", ())]
        return [np.asarray(value).tolist(), labels]
    kind = type(value)
    slots = [name for each in kind.__mro__ for name in _slots(each) if hasattr(value, name)]
    held = {name: getattr(value, name) for name in slots} | getattr(value, "__dict__", {})
    return [held, kind] if is_users(kind.__module__) else [held]


def _slots(kind: type) -> tuple[str, ...]:
    slots = vars(kind).get("__slots__", ())
    named = (slots,) if isinstance(slots, str) else tuple(slots)
    return tuple(name for name in named if name not in ("__dict__", "__weakref__"))


def _closure(function: FunctionType) -> list[Any]:
    found = []
    for cell in function.__closure__ or ():
        try:
            found.append(cell.cell_contents)
        except ValueError:  # not yet filled
            found.append("empty")
    return found


def _globals(function: FunctionType) -> dict[str, Any]:
    """Return the globals that a function and the functions in it refer to."""
    names, waiting = set[str](), [function.__code__]
    while waiting:
        code = waiting.pop()
        names |= {*code.co_names}
        waiting += [const for const in code.co_consts if isinstance(const, CodeType)]
    known = function.__globals__
    found = {name: known[name] for name in sorted(names)
             if name in known and known[name] is not getattr(builtins, name, known)}  # fmt: skip
    own = [each for each in found.values()
           if isinstance(each, ModuleType) and is_users(each.__name__)]  # fmt: skip
    used = [{name: vars(each)[name] for name in sorted(names) if name in vars(each)}
            for each in own]  # fmt: skip
    return found | {"": used} if used else found


def _of_module(module: ModuleType) -> Iterator[bytes]:
    """Yield the name of a module, and the content of a file of the user's."""
    yield module.__name__.encode()
    file = getattr(module, "__file__", None)
    if file is not None and is_users(module.__name__) and Path(file).is_file():
        yield Path(file).read_bytes()
