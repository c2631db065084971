"""Imports point downwards only, as the layout says."""

import ast
from pathlib import Path

import splitband

SOURCE = Path(splitband.__file__).parent

# From the top down; each may import what stands below it.
LAYERS = (
    "__main__",
    "cli",
    "paper",
    "plots",
    "reporting",
    "trial",
    "comparison",
    "processes",
    "defaults",
    "methods",
    "remembering",
    "saving",
    "training",
    "checkpoints",
    "windows",
    "models",
    "rollouts",
    "cells",
    "systems",
    "isolation",
    "simulators",
    "data",
    "calibration",
    "cutoff",
    "intervals",
    "periodic",
    "harmonic",
    "modes",
    "seasonal",
    "trend",
    "linear",
    "naive",
    "spectrum",
    "resampling",
    "filters",
    "metrics",
    "files",
    "threads",
    "kernels",
)
# These import nothing from the package but compiled code.
LEAVES = (
    "filters",
    "resampling",
    "metrics",
    "naive",
    "intervals",
    "files",
    "threads",
    "kernels",
)
ONLY_IN = {
    "matplotlib": {"plots"},
    "numba": {"kernels"},
    "typer": {"cli"},
    "rich": {"cli"},
    "fmpy": {"simulators"},
    "pooch": {"data"},
}


def module_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
    return found


def inner_imports(path: Path) -> set[str]:
    """Modules of the package, a name imported from the package itself being one if it is one."""
    parts = {name.split(".")[1] for name in imports(path) if name.startswith("splitband.")}
    return parts & {module_of(p) for p in SOURCE.rglob("*.py")}


FILES = sorted(p for p in SOURCE.rglob("*.py") if p.parent != SOURCE or p.name != "__init__.py")


def test_every_module_has_a_layer() -> None:
    assert {module_of(p) for p in FILES} == set(LAYERS)


def test_imports_point_downwards() -> None:
    upward = [
        f"{path.relative_to(SOURCE)} imports {name}"
        for path in FILES
        for name in inner_imports(path)
        if LAYERS.index(name) < LAYERS.index(module_of(path))
    ]
    assert not upward


def test_leaves_import_nothing_else_from_the_package() -> None:
    grown = {
        module_of(path): inner_imports(path) - {module_of(path), "kernels"}
        for path in FILES
        if module_of(path) in LEAVES
    }
    assert not any(grown.values()), grown


def test_heavy_libraries_are_imported_in_one_place() -> None:
    strayed = [
        f"{path.relative_to(SOURCE)} imports {library}"
        for path in FILES
        for library, allowed in ONLY_IN.items()
        if module_of(path) not in allowed
        and any(name.split(".")[0] == library for name in imports(path))
    ]
    assert not strayed


def test_only_the_command_line_prints() -> None:
    printing = [
        str(path.relative_to(SOURCE))
        for path in FILES
        if module_of(path) not in ("cli", "__main__")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert not printing
