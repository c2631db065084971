"""Rules that no linter holds."""

import ast
from pathlib import Path

import splitband

SOURCE = Path(splitband.__file__).parent


def test_errors_about_input_have_a_class_of_their_own() -> None:
    """The command line tells bad input from a defect by it."""
    others = [
        f"{path.relative_to(SOURCE)}:{node.lineno}"
        for path in SOURCE.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Raise) and ast.unparse(node).startswith("raise ValueError")
    ]
    assert not others
