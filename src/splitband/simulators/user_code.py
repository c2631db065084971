"""Inspect a user's code: arguments of functions, and the place of an error."""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from typing import Any

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
    required = [name for name, each in taken.items() if each.default is each.empty]
    wanted = [i + 1 for i, name in enumerate(taken) if name in (*required, *named)]
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


# ---------------------------------------------------------------- errors


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


def _of_the_user(path: Path) -> bool:
    return not (_OURS & set(path.parents) or _INSTALLED & set(path.parts))
