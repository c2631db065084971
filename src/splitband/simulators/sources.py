"""Find the files that a user's Python file runs: itself and the modules that it imports."""

from __future__ import annotations

import ast
import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from importlib.machinery import PathFinder
from importlib.util import resolve_name
from pathlib import Path

_INSTALLED = ("site-packages", "dist-packages")


def source_files(file: str | Path) -> list[Path]:
    """Return a Python file and the files of all modules that it imports, directly or not.

    Modules are looked for in the file's folder and in the folders of PYTHONPATH; installed packages
    and Python's own modules are left out. Nothing is run: what is imported by a computed name, or
    from a folder that the file adds to `sys.path`, is not found.
    """
    first = Path(file).resolve()
    listed = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    search = [str(first.parent), *(each for each in listed if each and not _installed(each))]
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


def _installed(folder: str) -> bool:
    return any(part in _INSTALLED for part in Path(folder).parts)


def _imported(path: Path, package: str) -> Iterator[str]:
    """Yield the names of what a module imports, which may be attributes of modules, too."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):  # compiled, or fails when it is run
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
    """Yield the files of a module and of the packages around it, and the package each is in."""
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
