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

from splitband.records.signals import bare_name
from splitband.runtime.errors import InputError

_INSTALLED = {"site-packages", "dist-packages"}
# On Windows, Python's own compiled modules lie in a folder beside its library.
_OWN = Path(__file__).parents[1], Path(get_path("stdlib")), Path(sys.base_prefix, "DLLs")
_OURS = {folder.resolve() for folder in _OWN}
"""Folders of this package and of Python."""


# ---------------------------------------------------------------- arguments


def arguments(function: Any) -> Mapping[str, inspect.Parameter]:
    """Return the arguments of a function by name; none for an unknown signature."""
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}


def count_arguments(function: Any) -> int:
    """Return the number of arguments to pass to a function; 0 for an unknown signature.

    All required arguments count, and with a default only `u`, and `p` after it.
    """
    try:
        return _counted(function)
    except TypeError:  # an object without a hash
        return _counted.__wrapped__(function)


@lru_cache(maxsize=256)
def _counted(function: Any) -> int:
    taken = _positions(function)
    named = ("u", "p") if "u" in taken else ()
    required = [name for name, parameter in taken.items() if parameter.default is parameter.empty]
    counts = [i + 1 for i, name in enumerate(taken) if name in (*required, *named)]
    return max(counts, default=0)


def check_arguments(function: Any, *expected: str) -> None:
    """Raise ValueError for misplaced arguments of the user's function."""
    actual = {name: i for i, name in enumerate(_positions(function))}
    named = {"u", "p", "w"} & {*expected}
    if any(actual.get(name, expected.index(name)) != expected.index(name) for name in named):
        raise InputError(
            f"a simulator's function must have the arguments ({', '.join(expected)}), in this "
            f"order and without gaps: got ({', '.join(actual)})"
        )


def check_open(function: Any, what: str, inputs: Sequence[str] = ()) -> None:
    """Raise ValueError if a function without inputs may be meant to take the inputs.

    Such a function has any number of arguments, or an argument with the default None or the name of
    an input.
    """
    named = {bare_name(name) for name in inputs}
    for parameter in arguments(function).values():
        gathers = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        if gathers or parameter.default is None or parameter.name in named:
            bare = parameter.replace(annotation=parameter.empty)
            raise InputError(
                f"simulator {what} must say whether its argument {bare} is the record's inputs, "
                "which it would not get: call it u, without a * before it, or else remove it or "
                "its default"
            )


def _positions(function: Any) -> dict[str, inspect.Parameter]:
    """Return the positional arguments of a function; none for an unknown signature."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    return {name: p for name, p in arguments(function).items() if p.kind in kinds}


def outline(file: str | Path, name: str) -> Callable[..., Any] | None:
    """Return an empty function with the arguments of a `def name` at module level, or None.

    The file is not run: a default other than a constant becomes `...`.
    """
    try:
        tree = ast.parse(Path(file).read_bytes())
    except (OSError, SyntaxError, ValueError):
        return None
    nodes = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name]
    if not nodes:
        return None
    a = nodes[-1].args
    for argument in (*a.posonlyargs, *a.args, a.vararg, *a.kwonlyargs, a.kwarg):
        if argument is not None:
            argument.annotation = None
    a.defaults = [_plain(default) for default in a.defaults]
    a.kw_defaults = [default and _plain(default) for default in a.kw_defaults]
    empty = ast.Expression(ast.Lambda(a, ast.Constant(None)))
    function: Callable[..., Any] = eval(compile(ast.fix_missing_locations(empty), "", "eval"), {})
    return function


def _plain(value: ast.expr) -> ast.expr:
    return value if isinstance(value, ast.Constant) else ast.Constant(...)


# ---------------------------------------------------------------- errors


def failure(error: BaseException) -> str:
    """Return the message of an error in user code, on one line, and the place of the error."""
    where = place(error)
    message = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"{message} ({where})" if where else message


def is_ours(error: Exception) -> bool:
    """Return whether an error is none of a user's code: a deadline, or a defect of this package."""
    paths = (Path(frame.filename).resolve() for frame in extract_tb(error.__traceback__))
    own = all(_OWN[0].resolve() in path.parents for path in paths)
    return own and not isinstance(error, InputError)


def place(error: BaseException) -> str:
    """Return the file and line of an error in user code; empty for other code."""
    for frame in reversed(extract_tb(error.__traceback__)):
        path = Path(frame.filename).resolve()
        if path.is_file() and _of_the_user(path):
            return f"{path.name}, line {frame.lineno}"
    return ""


def _of_the_user(path: Path) -> bool:
    return not (_OURS & set(path.parents) or _INSTALLED & set(path.parts))
