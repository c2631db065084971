"""The package's docstrings as numpydoc wants them.

In the package a parameter's line goes on with what it is about, and its type stands in the
signature alone. numpydoc expects the type on that line. Here one is put in the place of the other.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx

PARAMETER = re.compile(r"(\w+(?:, \w+)*) : (\S.*)")
SECTIONS = ("Parameters", "Attributes")


def _types(described: Any) -> Mapping[str, str]:
    """Annotations of what a docstring describes, by parameter and attribute."""
    found: dict[str, Any] = {}
    if inspect.isclass(described):
        for of_class in described.__mro__[::-1]:
            found |= vars(of_class).get("__annotations__", {})
    called = vars(described).get("__init__") if inspect.isclass(described) else described
    if callable(called):
        parameters = inspect.signature(called).parameters
        found |= {name: parameter.annotation for name, parameter in parameters.items()}
    return {name: text for name, text in found.items() if isinstance(text, str)}


def with_types(lines: list[str], types: Mapping[str, str]) -> list[str]:
    """The lines of a docstring with types where numpydoc expects them."""
    changed: list[str] = []
    section = ""
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        if following and set(following) == {"-"}:
            section = line.strip()
        found = PARAMETER.fullmatch(line) if section in SECTIONS else None
        if found is None:
            changed.append(line)
            continue
        names, text = found.groups()
        of_names = {types.get(name, "") for name in names.split(", ")}
        said = of_names.pop() if len(of_names) == 1 else ""
        changed += [f"{names} : {said}" if said else names, f"    {text}"]
    return changed


def _process(_: Sphinx, __: str, ___: str, described: Any, ____: Any, lines: list[str]) -> None:
    lines[:] = with_types(lines, _types(described))


def _as_code(_: Sphinx, __: Any, node: pending_xref, shown: nodes.Node) -> nodes.Node | None:
    """What stands in backticks in a docstring and has no page of its own is code."""
    return shown if node.get("reftype") == "obj" else None


def setup(app: Sphinx) -> dict[str, bool]:
    """Look at docstrings before numpydoc does."""
    app.connect("autodoc-process-docstring", _process, priority=100)
    app.connect("missing-reference", _as_code)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
