"""Imports point downwards only, as the layout says."""

import ast
import re
from functools import cache
from pathlib import Path

import splitband

SOURCE = Path(splitband.__file__).parent

# From the top down; each may import what stands below it.
LAYERS = (
    "__main__",
    "cli",
    "report",
    "evaluation",
    "export",
    "forecasters",
    "training",
    "models",
    "networks",
    "simulators",
    "data",
    "baselines",
    "filters",
    "kernels",
    "runtime",
    "metrics",
)
# These import nothing from the package but compiled code, measures of error and deadlines.
LEAVES = ("filters", "baselines", "runtime", "metrics", "kernels")
BELOW_LEAVES = {"kernels", "metrics", "runtime"}
ONLY_IN = {
    "matplotlib": {"report"},
    "bokeh": {"report"},
    "jinja2": {"report"},
    "numba": {"kernels"},
    "typer": {"cli"},
    "rich": {"cli"},
    "fmpy": {"simulators", "export"},
    "onnx": {"export"},
    "pooch": {"data"},
    "distributed": {"runtime"},
}


def module_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


@cache
def imports(path: Path) -> set[str]:
    """What a file imports when it runs, which what is for type checkers alone does not."""
    found: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing_only = [
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    ]
    for node in ast.walk(tree):
        if node in typing_only:
            continue
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
    return found


def inner_imports(path: Path) -> set[str]:
    """Packages of splitband that a file imports from."""
    parts = {name.split(".")[1] for name in imports(path) if name.startswith("splitband.")}
    return parts & {module_of(p) for p in SOURCE.rglob("*.py")}


FILES = sorted(p for p in SOURCE.rglob("*.py") if p.parent != SOURCE or p.name != "__init__.py")


def test_every_module_has_a_layer() -> None:
    assert {module_of(p) for p in FILES} == set(LAYERS)


def test_everything_but_the_entry_and_the_metrics_is_in_a_package() -> None:
    assert {p.name for p in SOURCE.iterdir() if p.is_file()} == {
        "__init__.py",
        "__main__.py",
        "metrics.py",
        "py.typed",
    }


def test_imports_point_downwards() -> None:
    upward = [
        f"{path.relative_to(SOURCE)} imports {name}"
        for path in FILES
        for name in inner_imports(path)
        if LAYERS.index(name) < LAYERS.index(module_of(path))
    ]
    assert not upward


def test_only_results_reach_up_to_be_shown() -> None:
    """By their methods `plot`, `save`, `report` and `export`, when these are called."""
    upward = {
        (str(path.relative_to(SOURCE)), called.split(".")[1])
        for path in FILES
        for called in re.findall(
            r'import_module\("(splitband\.\w+)', path.read_text(encoding="utf-8")
        )
        if LAYERS.index(called.split(".")[1]) < LAYERS.index(module_of(path))
    }
    assert upward == {
        ("evaluation/comparison.py", "report"),
        ("evaluation/forecast.py", "report"),
        ("forecasters/base.py", "export"),
        ("forecasters/prediction.py", "report"),
    }


def test_leaves_import_nothing_else_from_the_package() -> None:
    grown = {
        str(path.relative_to(SOURCE)): found
        for path in FILES
        if module_of(path) in LEAVES
        and (found := inner_imports(path) - {module_of(path)} - BELOW_LEAVES)
    }
    assert not grown


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


MOST_PARAMETERS, MOST_FIELDS = 8, 9
LARGER = {
    "Record",  # the one data container: a field for each signal, and what it is called
    "Trial",  # what becomes of every method on held-out samples
    "Settings",  # the paper's hyperparameters of a training and ours, named in every run file
}  # fmt: skip
LONGER = {
    "plan",  # all that a user may say of a comparison, each by its name
}


def test_no_function_takes_more_parameters_than_one_can_keep_in_mind() -> None:
    """Commands have as many as they have options."""
    long = [
        f"{path.relative_to(SOURCE)}: {node.name} has {count}"
        for path in FILES
        if module_of(path) not in ("cli", "kernels")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        and node.name not in LONGER
        and (count := len([a for a in (*node.args.args, *node.args.kwonlyargs)
                           if a.arg not in ("self", "cls")])) > MOST_PARAMETERS
    ]  # fmt: skip
    assert not long


def test_no_dataclass_has_more_fields_than_one_can_keep_in_mind() -> None:
    large = [
        f"{path.relative_to(SOURCE)}: {node.name} has {count}"
        for path in FILES
        if module_of(path) != "cli"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
        and any("dataclass" in ast.dump(decorator) for decorator in node.decorator_list)
        and (count := sum(isinstance(line, ast.AnnAssign) for line in node.body)) > MOST_FIELDS
        and node.name not in LARGER
    ]
    assert not large
