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
    "metrics",
    "runtime",
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
    "rich": {"cli", "report"},
    "fmpy": {"simulators", "export"},
    "onnx": {"export"},
    "pooch": {"data"},
    "distributed": {"cli"},
}


def module_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def hands_over(node: ast.AST) -> bool:
    """Whether it is a method that calls a function which it imports there, and does no more."""
    if (
        not isinstance(node, ast.FunctionDef)
        or not node.args.args
        or ast.get_docstring(node) is None
    ):
        return False
    method = node.args.args[0].arg == "self"
    return method and len(node.body) == 3 and isinstance(node.body[1], ast.ImportFrom)


@cache
def imports(path: Path, handing_over: bool = True) -> set[str]:
    """What a file imports, at once or in a function, but not what is for type checkers alone."""
    found: set[str] = set()
    left_out = {
        inner
        for node in ast.walk(tree(path))
        if (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
        or (not handing_over and hands_over(node))
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree(path)):
        if node in left_out:
            continue
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
    return found


def inner_imports(path: Path, handing_over: bool = True) -> set[str]:
    """Packages of splitband that a file imports from."""
    found = imports(path, handing_over)
    parts = {name.split(".")[1] for name in found if name.startswith("splitband.")}
    return parts & {module_of(p) for p in SOURCE.rglob("*.py")}


FILES = sorted(p for p in SOURCE.rglob("*.py") if p.parent != SOURCE or p.name != "__init__.py")


def test_every_module_has_a_layer() -> None:
    assert {module_of(p) for p in FILES} == set(LAYERS)


def test_everything_but_the_entry_and_the_metrics_is_in_a_package() -> None:
    assert {p.name for p in SOURCE.iterdir() if p.is_file()} == {
        "__init__.py",
        "__init__.pyi",
        "__main__.py",
        "metrics.py",
        "py.typed",
    }


def test_imports_point_downwards() -> None:
    """But for methods that only hand over, such as `Forecaster.export`."""
    upward = [
        f"{path.relative_to(SOURCE)} imports {name}"
        for path in FILES
        for name in inner_imports(path, handing_over=False)
        if LAYERS.index(name) < LAYERS.index(module_of(path))
    ]
    assert not upward


def test_no_module_names_one_that_stands_above_it() -> None:
    """By a string that is imported later, for instance; the front of the package may."""
    upward = [
        f"{path.relative_to(SOURCE)} names {node.value}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and (named := re.match(r"splitband\.(\w+)[\w.:]*$", node.value))
        and named[1] in LAYERS
        and LAYERS.index(named[1]) < LAYERS.index(module_of(path))
    ]
    assert not upward


def test_forecasters_and_evaluation_have_no_circles() -> None:
    """What is imported inside of functions counts, too, but for methods that only hand over."""
    for package in ("forecasters", "evaluation"):
        left = {
            f"splitband.{package}.{path.stem}": {
                name
                for name in imports(path, handing_over=False)
                if name.startswith(f"splitband.{package}.")
            }
            for path in FILES
            if module_of(path) == package and path.name != "__init__.py"
        }
        while free := [name for name, needed in left.items() if not needed & left.keys()]:
            for name in free:
                del left[name]
        assert not left


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
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    ]
    assert not printing


def test_errors_about_input_have_a_class_of_their_own() -> None:
    """The command line tells bad input from a defect by it."""
    others = [
        f"{path.relative_to(SOURCE)}:{node.lineno}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Raise) and ast.unparse(node).startswith("raise ValueError")
    ]
    assert not others


MOST_PARAMETERS, MOST_FIELDS = 6, 8
LARGER = {
    "Blocks": "the parameters of a linear system, and which of them are free",
    "LinearModel": "a state-space model: its matrices, its filter, its states in training",
    "Record": "the one data container: a field for each signal, and what it is called",
    "Prediction": "a field for each array that a frame and a picture show",
    "Fit": "what one training says under each of three protocols, and how it went",
    "Plan": "all decisions of a comparison, each by its name",
    "Settings": "the paper's hyperparameters of a training and ours, named in every run file",
    "Section": "a part of the page: a field for each thing that its template may show",
    "Ode": "the options of a user: the equation, what is measured of it, and its solver",
    "Isolated": "a task of another process, as the options of a command say it",
}
LONGER = {
    "blocks_of": "the matrices of a system, and which of its poles are given",
    "plan": "all that a user may say of a comparison, each by its name",
    "compare": "what to compare, and where and how its trainings run",
    "forecast": "the same, and how far to forecast",
    "fit": "where and how a training runs, and who watches it",
    "read": "all that a file may leave open of a record",
    "choose_with_simulator": "two signals, and all that a cut-off is chosen by",
    "perfect": "the filters of the paper's Eq. 6, joint recurrence; a user may give each number",
    "__init__": "the options of a model, each by its name",
    "run": "all that a trajectory of a simulator depends on, and where it is kept",
}


def test_no_function_takes_more_parameters_than_one_can_keep_in_mind() -> None:
    """Commands have as many as they have options."""
    long = {
        node.name: f"{path.relative_to(SOURCE)}: {node.name} has {count}"
        for path in FILES
        if module_of(path) not in ("cli", "kernels")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.FunctionDef)
        and (
            count := sum(
                a.arg not in ("self", "cls")
                for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
            )
        )
        > MOST_PARAMETERS
    }
    assert not [said for name, said in long.items() if name not in LONGER]
    assert not LONGER.keys() - long.keys()


def test_no_dataclass_has_more_fields_than_one_can_keep_in_mind() -> None:
    large = {
        node.name: f"{path.relative_to(SOURCE)}: {node.name} has {count}"
        for path in FILES
        if module_of(path) != "cli"
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ClassDef)
        and any("dataclass" in ast.dump(decorator) for decorator in node.decorator_list)
        and (count := sum(isinstance(line, ast.AnnAssign) for line in node.body)) > MOST_FIELDS
    }
    assert not [said for name, said in large.items() if name not in LARGER]
    assert not LARGER.keys() - large.keys()


LOOKED_AT = {
    "Symbol": "a traced number stands beside plain ones, in code that is written for both",
    "Recorded": "a simulator is any object of the user's; what is recorded is aligned, not run",
    "Absent": "it stands where a simulator has to be given again",
    "Record": "one record or several",
    "Settings": "of the settings all are given, or some of them by name",
    "WithRepr": "a value is written as Python by itself, or as Python's own types are",
}
"""Classes of the package that an object is tested for, and why no method of it serves."""


def test_objects_are_asked_and_not_looked_at() -> None:
    """Abstract classes and errors say what an object can do or what went wrong."""
    concrete = {
        node.name
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ClassDef)
        and not any(
            ast.unparse(base).split("[")[0].endswith(("ABC", "Protocol", "Error", "Exception"))
            for base in node.bases
        )
        and "abstractmethod" not in ast.unparse(node)
    }
    tested = {
        name.id: f"{path.relative_to(SOURCE)} tests for {name.id}"
        for path in FILES
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "isinstance"
        for name in ast.walk(node.args[1])
        if isinstance(name, ast.Name) and name.id in concrete
    }
    assert not [said for name, said in tested.items() if name not in LOOKED_AT]
    assert not LOOKED_AT.keys() - tested.keys()
