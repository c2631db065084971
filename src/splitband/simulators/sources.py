"""Inspect a user's Python code: the files it imports, its dependencies, the place of an error."""

from __future__ import annotations

import ast
import hashlib
import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.machinery import PathFinder
from importlib.util import resolve_name
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

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
    known = Path(__file__).resolve().parents[1], Path(get_path("stdlib")).resolve()
    for frame in reversed(extract_tb(error.__traceback__)):
        path = Path(frame.filename).resolve()
        installed = set(known) & set(path.parents) or set(_INSTALLED) & set(path.parts)
        if path.is_file() and not installed:
            return f"{path.name}, line {frame.lineno}"
    return ""


def defines_function(file: str | Path, name: str) -> bool:
    """Return whether a Python file has `def name` at module level; nothing is run."""
    try:
        tree = ast.parse(Path(file).read_bytes())
    except (OSError, SyntaxError, ValueError):
        return False
    return any(isinstance(node, ast.FunctionDef) and node.name == name for node in tree.body)


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


def code_digest(*functions: Callable[..., Any]) -> str:
    """Return a digest of functions: their code, and the values and functions that it refers to.

    Objects of other types enter only with their type.
    """
    said = hashlib.sha256()
    waiting: list[Any] = [*functions]
    seen: set[int] = set()
    while waiting:
        value = waiting.pop()
        function = getattr(value, "py_func", value)  # the source of a Numba function
        if isinstance(function, FunctionType):
            if id(function) in seen:
                continue
            seen.add(id(function))
            waiting += [function.__code__, *(function.__defaults__ or ())]
            waiting += [cell.cell_contents for cell in function.__closure__ or ()]
            used = inspect.getclosurevars(function).globals
            waiting += [used[name] for name in sorted(used)]
        elif isinstance(value, CodeType):
            said.update(value.co_code)
            waiting += value.co_consts
        elif isinstance(value, np.ndarray):
            said.update(value.tobytes())
        elif isinstance(value, ModuleType):
            said.update(value.__name__.encode())
        elif isinstance(value, tuple | list):
            waiting += value
        elif isinstance(value, dict):
            waiting += [part for pair in value.items() for part in pair]
        elif value is None or isinstance(value, str | int | float):
            said.update(repr(value).encode())
        else:
            said.update(type(value).__qualname__.encode())
    return said.hexdigest()


def count_arguments(function: Callable[..., Any]) -> int:
    """Return the number of required positional arguments of a function; 0 if it is unknown."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    try:
        given = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 0
    return sum(p.kind in kinds and p.default is p.empty for p in given)
