"""Imports point downwards, those inside of functions too; those for type checkers are free."""

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import splitband

SOURCE = Path(splitband.__file__).parent
ROOMS = [
    "runtime",
    "metrics",
    "kernels",
    "filters",
    "records",
    "networks",
    "models",
    "training",
    "simulators",
    "linear",
    "baselines",
    "forecasters",
    "checks",
    "export",
    "comparison",
    "report",
    "cli",
]
"""From below."""
DELEGATES = {
    "forecasters.base": {"export"},
    "forecasters.prediction": {"plot"},
    "comparison.result": {"plot", "report", "save", "_as_table"},
}
"""Methods that users look for there: one line, which hands over to a function of a higher room."""
FILES = {
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__"): path
    for path in [*SOURCE.glob("*/**/*.py"), SOURCE / "metrics.py"]
}


def imported(name: str, tree: ast.AST) -> set[str]:
    """The files of the package that a part of a file imports."""
    found = set[str]()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef) and node.name in DELEGATES.get(name, ()):
            said, handed_over = node.body[1:]
            assert isinstance(said, ast.ImportFrom)
            assert isinstance(handed_over, ast.Return | ast.Expr)
        elif isinstance(node, ast.ImportFrom):
            place = f"splitband.{name}.{node.module}" if node.level else str(node.module)
            names = [f"{place}.{each.name}" for each in node.names]
            own = [each.partition(".")[2] for each in names if each.startswith("splitband.")]
            found |= {each if each in FILES else each.rpartition(".")[0] for each in own}
        elif not (isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"):
            found |= imported(name, node)
    return found - {name, ""}


def texts(node: ast.AST) -> Iterator[str]:
    """The texts of a program that are no docstrings, with X for what is put into them."""
    if isinstance(node, ast.JoinedStr):
        yield "".join(str(getattr(part, "value", "X")) for part in node.values)
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value
    elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
        for part in ast.iter_child_nodes(node):
            yield from texts(part)


def test_messages_name_an_argument_and_its_option_in_brackets() -> None:
    """Such as "budget (--budget)": users of Python and of the command read the same."""
    files = {n: p for n, p in FILES.items() if not n.startswith(("cli", "report.environment"))}
    bare = [
        (name, text)
        for name, path in files.items()
        for text in texts(ast.parse(path.read_text(encoding="utf-8")))
        if re.search(r"(?<!\w)--[a-z]", re.sub(r"\([^()]*\)", "", text))
    ]
    assert bare == []


def test_no_file_needs_a_higher_room_and_no_files_need_each_other() -> None:
    needs = {}
    for name, path in FILES.items():
        stub = path.with_suffix(".pyi")  # of a package that loads what it hands out when it is used
        text = (stub if stub.exists() else path).read_text(encoding="utf-8")
        needs[name] = imported(name, ast.parse(text))
        room = ROOMS.index(name.partition(".")[0])
        higher = {each for each in needs[name] if ROOMS.index(each.partition(".")[0]) > room}
        assert not higher, f"{name} needs {higher}"
    TopologicalSorter(needs).prepare()  # its error names the files of a circle
