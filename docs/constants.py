"""List the numeric constants of the package with their evidence: `python -m docs.constants`.

A constant is a name in capitals at module level whose value holds numbers and no text. The last
sentence of its docstring says what it is where it is no result of a measurement: a limit that
"bounds the time" or "bounds the memory", "rounding", "layout" of a picture or table, a "convention"
of the field, or chosen "by eye". Those by eye are a debt.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src/splitband"
KINDS = {
    "by eye": r"\bby eye\b",
    "limit": r"\bbounds the (time|memory)\b|\bforg(ed|ery)\b",
    "rounding": r"\brounding\b",
    "layout": r"\blayout\b",
    "convention": r"\bconvention\b",
}
EVIDENCE = "evidence"


@dataclass(frozen=True)
class Constant:
    """Hold the names that one line defines, their value and docstring, and the kind."""

    path: Path
    line: int
    names: tuple[str, ...]
    value: str
    said: str

    @property
    def kind(self) -> str:
        """Return the kind that the docstring states, or `EVIDENCE`."""
        stated = (kind for kind, words in KINDS.items() if re.search(words, self.said, re.I))
        return next(stated, EVIDENCE if self.said else "unexplained")


def constants() -> Iterator[Constant]:
    """Yield the numeric constants of the package."""
    for path in sorted(SOURCE.rglob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        for node, after in zip(body, [*body[1:], None], strict=True):
            if isinstance(node, (ast.Assign, ast.AnnAssign)) and node.value is not None:
                names, value = tuple(_names(node)), node.value
                if names and all(name.strip("_").isupper() for name in names) and _numeric(value):
                    said = _text(after)
                    yield Constant(path, node.lineno, names, ast.unparse(value), said)


def _names(node: ast.Assign | ast.AnnAssign) -> Iterator[str]:
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    of: Sequence[ast.expr] = target.elts if isinstance(target, ast.Tuple) else [target]
    yield from (each.id for each in of if isinstance(each, ast.Name))


def _numeric(value: ast.expr) -> bool:
    held = [each.value for each in ast.walk(value) if isinstance(each, ast.Constant)]
    numbers = [each for each in held if type(each) in (int, float)]
    return bool(numbers) and not any(isinstance(each, str) for each in held)


def _text(node: ast.stmt | None) -> str:
    docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return " ".join(str(node.value.value).split()) if docstring else ""  # type: ignore[union-attr]


def main() -> None:
    """Print every constant, and how many there are of each kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kind", help="list those of one kind")
    given = parser.parse_args()
    found = [*constants()]
    for each in found:
        if given.kind in (None, each.kind):
            where = f"{each.path.relative_to(SOURCE)}:{each.line}"
            print(f"{each.kind:11} {where:38} {', '.join(each.names)} = {each.value}  {each.said}")
    counts = Counter(each.kind for each in found for _ in each.names)
    print(f"{counts.total()} names:", ", ".join(f"{n} {kind}" for kind, n in counts.most_common()))


if __name__ == "__main__":
    main()
