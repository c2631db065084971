"""Inspect a user's Python code: the files it imports, its dependencies, the place of an error."""

from __future__ import annotations

import ast
import hashlib
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from importlib.machinery import PathFinder
from importlib.util import resolve_name
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb

_INSTALLED = ("site-packages", "dist-packages")


def source_files(file: str | Path) -> list[Path]:
    """Return a Python file and the files of all modules that it imports, directly or not.

    Modules are searched in the file's folder and in the folders of PYTHONPATH; installed packages
    and the standard library are left out. Nothing is run, so imports by a computed name, or from a
    folder that the file adds to `sys.path`, are not found.
    """
    first = Path(file).resolve()
    listed = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    own = [each for each in listed if each and not set(_INSTALLED) & set(Path(each).parts)]
    search = [str(first.parent), *own]
    packages, waiting = {first: ""}, [first]
    while waiting:
        path = waiting.pop()
        for name in _imported(path, packages[path]):
            for module, package in _located(name, search):
                if module not in packages:
                    packages[module] = package
                    waiting.append(module)
    return [first, *sorted(packages.keys() - {first})]


def digest(files: Iterable[str | Path]) -> str:
    """Return the SHA-256 of the contents of files, in their order."""
    each = (hashlib.sha256(Path(file).read_bytes()).digest() for file in files)
    return hashlib.sha256(b"".join(each)).hexdigest()


def failure(error: BaseException) -> str:
    """Return the message of an error in user code, on one line, and the place of the error."""
    where = place(error)
    said = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return f"{said} ({where})" if where else said


def place(error: BaseException) -> str:
    """Return the file and line of user code that raised an error; empty if there is none."""
    known = _known()
    for frame in reversed(extract_tb(error.__traceback__)):
        path = Path(frame.filename).resolve()
        installed = set(known) & set(path.parents) or set(_INSTALLED) & set(path.parts)
        if path.is_file() and not installed:
            return f"{path.name}, line {frame.lineno}"
    return ""


def arguments_of(file: str | Path, name: str) -> int | None:
    """Return how many arguments a `def name` at module level is to be given; nothing is run.

    None without such a function. See `count_arguments`.
    """
    given = _signature_in(file, name)
    if given is None:
        return None
    names = [arg.arg for arg in (*given.posonlyargs, *given.args)]
    return wanted_arguments(names, len(names) - len(given.defaults))


def open_arguments_in(file: str | Path, name: str, inputs: Sequence[str]) -> list[str]:
    """Return the arguments of a `def name` at module level that may be a record's inputs.

    See `check_open`; nothing is run.
    """
    given = _signature_in(file, name)
    if given is None:
        return []
    placed = [*given.posonlyargs, *given.args][-len(given.defaults) :] if given.defaults else []
    pairs = [*zip(placed, given.defaults, strict=True),
             *zip(given.kwonlyargs, given.kw_defaults, strict=True)]  # fmt: skip
    found = [f"{arg.arg}={ast.unparse(default)}" for arg, default in pairs if default is not None
             and (ast.unparse(default) == "None" or arg.arg in inputs)]  # fmt: skip
    found += [f"*{given.vararg.arg}"] if given.vararg else []
    return found + ([f"**{given.kwarg.arg}"] if given.kwarg else [])


def check_open(arguments: Sequence[str], what: str) -> None:
    """Raise ValueError if the user's code has arguments that may be a record's inputs.

    These are `arguments` with the default None, with the name of an input, or any number of
    them, of code that is not driven.
    """
    if arguments:
        raise ValueError(
            f"simulator {what} must say whether its argument {arguments[0]} is the record's "
            "inputs, which it would not get: call it u, without a * before it, or else remove it "
            "or its default"
        )


def _signature_in(file: str | Path, name: str) -> ast.arguments | None:
    """Return the arguments of a `def name` at module level; nothing is run."""
    try:
        tree = ast.parse(Path(file).read_bytes())
    except (OSError, SyntaxError, ValueError):
        return None
    found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name]
    return found[-1].args if found else None


def wanted_arguments(names: Sequence[str], required: int) -> int:
    """Return how many positional arguments a function of these names is to be given.

    Those are the required ones, and those with a default that are called `u`, or `p` after it.
    """
    named = ("u", "p") if "u" in names else ()
    wanted = [i < required or name in named for i, name in enumerate(names)]
    return max((i + 1 for i, each in enumerate(wanted) if each), default=0)


def _imported(path: Path, package: str) -> Iterator[str]:
    """Yield the names that a module imports, of modules or of attributes of modules."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):  # a compiled module, or one that fails when it is run
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            relative = "." * node.level + (node.module or "")
            try:
                base = resolve_name(relative, package)
            except ImportError:  # beyond the package
                continue
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _located(name: str, search: Sequence[str]) -> Iterator[tuple[Path, str]]:
    """Yield the files of a module and of its parent packages, each with its package."""
    where: Sequence[str] | None = search
    parts = name.split(".")
    for i in range(len(parts)):
        full = ".".join(parts[: i + 1])
        spec = None if where is None else PathFinder.find_spec(full, where)
        if spec is None:
            return
        where = spec.submodule_search_locations
        if spec.has_location and spec.origin is not None:
            yield Path(spec.origin).resolve(), full if where else ".".join(parts[:i])


def is_users(module: str) -> bool:
    """Return whether a loaded module, by its name, is the user's own: not installed, not ours."""
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None:
        return module == "__main__"
    path = Path(file).resolve()
    return not (set(_known()) & set(path.parents) or set(_INSTALLED) & set(path.parts))


def _known() -> tuple[Path, Path]:
    """Return the folders of this package and of the standard library."""
    return Path(__file__).resolve().parents[1], Path(get_path("stdlib")).resolve()
