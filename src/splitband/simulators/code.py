"""Inspect a user's code: arguments of functions, what they refer to, the place of an error."""

from __future__ import annotations

import ast
import builtins
import hashlib
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copyreg import dispatch_table
from functools import cached_property, lru_cache
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from splitband.data.signals import bare_name
from splitband.runtime.errors import InputError

_INSTALLED = {"site-packages", "dist-packages"}
# On Windows, Python's own compiled modules lie in a folder beside its library.
_OWN = Path(__file__).parents[1], Path(get_path("stdlib")), Path(sys.base_prefix, "DLLs")
_OURS = {each.resolve() for each in _OWN}
"""Folders of this package and of Python."""


# ---------------------------------------------------------------- arguments


def arguments(function: Any) -> Mapping[str, inspect.Parameter]:
    """Return the arguments of a function by name; none if they are unknown."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}


def count_arguments(function: Any) -> int:
    """Return the number of arguments that a function is to be given; 0 if it is unknown.

    Those are the required ones, and those with a default that are called `u`, or `p` after it.
    """
    try:
        return _counted(function)
    except TypeError:  # it has no hash
        return _counted.__wrapped__(function)


@lru_cache(maxsize=256)
def _counted(function: Any) -> int:
    taken = _positions(function)
    named = ("u", "p") if "u" in taken else ()
    wanted = [i + 1 for i, (name, each) in enumerate(taken.items())
              if each.default is each.empty or name in named]  # fmt: skip
    return max(wanted, default=0)


def check_arguments(function: Any, *expected: str) -> None:
    """Raise ValueError if arguments of the user's function stand where others belong."""
    given = {name: i for i, name in enumerate(_positions(function))}
    if any(given.get(name, expected.index(name)) != expected.index(name) for name in ("u", "p")):
        raise InputError(
            f"a simulator's function must have the arguments ({', '.join(expected)}), in this "
            f"order and without gaps: got ({', '.join(given)})"
        )


def check_open(function: Any, what: str, inputs: Sequence[str] = ()) -> None:
    """Raise ValueError if a function, of code that is not driven, may be meant to take the inputs.

    That is one of any number of arguments, or whose argument can be left out and has the default
    None, or the name of an input.
    """
    named = {bare_name(each) for each in inputs}
    for each in arguments(function).values():
        gathers = each.kind in (each.VAR_POSITIONAL, each.VAR_KEYWORD)
        if gathers or each.default is None or each.name in named:
            raise InputError(
                f"simulator {what} must say whether its argument "
                f"{each.replace(annotation=each.empty)} is the record's inputs, which it would not "
                "get: call it u, without a * before it, or else remove it or its default"
            )


def _positions(function: Any) -> dict[str, inspect.Parameter]:
    """Return the positional arguments of a function; none if they are unknown."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    return {name: each for name, each in arguments(function).items() if each.kind in kinds}


def outline(file: str | Path, name: str) -> Callable[..., Any] | None:
    """Return an empty function with the arguments of a `def name` at module level, or None.

    Nothing of the file is run: a default that is no plain value becomes `...`.
    """
    try:
        tree = ast.parse(Path(file).read_bytes())
    except (OSError, SyntaxError, ValueError):
        return None
    found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name]
    if not found:
        return None
    given = found[-1].args
    for each in (*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg):
        if each is not None:
            each.annotation = None
    given.defaults = [_plain(each) for each in given.defaults]
    given.kw_defaults = [each and _plain(each) for each in given.kw_defaults]
    empty = ast.Expression(ast.Lambda(given, ast.Constant(None)))
    function: Callable[..., Any] = eval(compile(ast.fix_missing_locations(empty), "", "eval"), {})
    return function


def _plain(value: ast.expr) -> ast.expr:
    return value if isinstance(value, ast.Constant) else ast.Constant(...)


# ---------------------------------------------------------------- references and files


def failure(error: BaseException) -> str:
    """Return the message of an error in user code, on one line, and the place of the error."""
    where = place(error)
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"{said} ({where})" if where else said


def place(error: BaseException) -> str:
    """Return the file and line of user code that raised an error; empty if there is none."""
    for frame in reversed(extract_tb(error.__traceback__)):
        path = Path(frame.filename).resolve()
        if path.is_file() and _of_the_user(path):
            return f"{path.name}, line {frame.lineno}"
    return ""


def is_users(module: str) -> bool:
    """Return whether a loaded module, by its name, is the user's own: not installed, not ours."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return module == "__main__" if file is None else _of_the_user(Path(file).resolve())


def loaded_files() -> list[str]:
    """Return the files of the user's modules that have been imported in this process."""
    names = {*sys.modules} - {"__main__", "__mp_main__"}
    files = {str(getattr(sys.modules[name], "__file__", None)) for name in names if is_users(name)}
    return sorted(file for file in files if Path(file).is_file())


def content_digest(files: Iterable[str | Path]) -> str:
    """Return the SHA-256 of the contents of files, in their order; of a missing one it is empty."""
    contents = (Path(file).read_bytes() if Path(file).is_file() else b"" for file in files)
    each = (hashlib.sha256(content).digest() for content in contents)
    return hashlib.sha256(b"".join(each)).hexdigest()


def _of_the_user(path: Path) -> bool:
    return not (_OURS & set(path.parents) or _INSTALLED & set(path.parts))


# ---------------------------------------------------------------- identity


def code_digest(*functions: Callable[..., Any] | None) -> str | None:
    """Return a digest of functions: their code, and the values and functions that it refers to.

    Names count, of globals and of attributes, so do constants, defaults, closures and functions in
    functions; of other objects what pickling would store. It is equal in every process, and None
    where something cannot be pickled.
    """
    try:
        return _digest(functions, (), {})
    except Exception:  # of any class: each pickles in its own way
        return None


def _digest(value: Any, within: tuple[int, ...], seen_before: dict[int, int]) -> str:
    """Return a digest of a value, which is part of those `within`.

    `seen_before`: the functions and classes so far, with their numbers.
    """
    value = getattr(value, "py_func", value)  # the source of a Numba function
    parts = [type(value).__qualname__]
    if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.generic):
        parts.append(repr(value))
    elif id(value) in seen_before:
        parts.append(f"again {seen_before[id(value)]}")
    elif id(value) not in within:
        if isinstance(value, FunctionType | type):
            seen_before[id(value)] = len(seen_before)
        inner = (*within, id(value))
        if isinstance(value, set | frozenset):
            parts += sorted(_digest(each, inner, dict(seen_before)) for each in value)
        else:
            parts += [_digest(each, inner, seen_before) for each in _contents(value)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _contents(value: Any) -> list[Any]:  # noqa: PLR0911  one kind after the other
    """Return the values that a value consists of; raises TypeError for one that is not known."""
    if isinstance(value, tuple | list):
        return [*value]
    if isinstance(value, dict):
        return [part for pair in value.items() for part in pair]
    if isinstance(value, ModuleType):
        own = [value.__file__ or ""] if is_users(value.__name__) else []
        return [value.__name__, content_digest(own)]
    if isinstance(value, CodeType):
        shape = value.co_argcount, value.co_kwonlyargcount, value.co_flags
        return [value.co_code, value.co_names, value.co_consts, value.co_exceptiontable, shape]
    if isinstance(value, FunctionType):
        file = Path(value.__code__.co_filename).resolve()
        installed = file.is_file() and not _of_the_user(file)
        refers = (value.__module__, value.__qualname__) if installed else _globals(value)
        code = [value.__code__, refers]
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return [code, cells, value.__defaults__, value.__kwdefaults__, vars(value)]
    if isinstance(value, type):
        parts = dict(vars(value)) if is_users(value.__module__) else {}
        parts.pop("_abc_impl", None)  # what an abstract class has counted so far
        used = [n for n in sorted(parts) if not n.startswith("__") or callable(parts[n])]
        return [value.__qualname__, *value.__bases__, [(name, parts[name]) for name in used]]
    if isinstance(value, property | cached_property | classmethod | staticmethod):
        return [getattr(value, name, None) for name in ("fget", "fset", "func", "__func__")]
    reduce = dispatch_table.get(type(value))
    stored: Any = value.__reduce_ex__(4) if reduce is None else reduce(value)
    if isinstance(stored, str):  # by its name
        return [getattr(value, "__module__", ""), stored, getattr(value, "__dict__", {})]
    return [[*part] if isinstance(part, Iterator) else part for part in stored]


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
