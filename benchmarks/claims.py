"""Which stored results are of today's code, and on what machine they were measured.

    python -m benchmarks.claims         count the stored runs whose code has changed since

A run carries `sources`: a hash of all code that decides accuracy, as Python's parser reads it, so
that comments, docstrings and layout do not count. A run with `rooms` is decided by these alone: no
other one was loaded in its process. It is current if the hash is today's, or if
`python -m benchmarks.frozen COMMIT --list` found the same numbers, to the bit, for both. A commit
would need the history, which shallow clones lack, and would change when branches are rebased. Runs
without a hash are older than it. Tables mark what is not current; README.md leaves it out.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import os
import platform
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

Row = dict[str, Any]
ROOT = Path(__file__).parents[1]
STORED = ROOT / "docs/results/benchmarks"
EQUAL = STORED / "equal.jsonl"
"""Pairs of hashes whose sources compute the same, with the output of that check."""
ROOMS = (
    *("baselines", "comparison", "filters", "forecasters", "kernels"),
    *("linear", "models", "networks", "simulators", "training"),
)
"""Folders of the package that decide accuracy, beside `metrics.py`: whatever is fitted, trained,
searched or chosen. Not those that read records and run processes, whose results tests compare
exactly, nor those that show and export what was found."""
SIGN = "†"
_STEPS = 60


def loaded() -> list[str]:
    """Return the rooms that decide accuracy of which this process has loaded something."""
    return [room for room in ROOMS if f"splitband.{room}" in sys.modules]


def sources(root: Path = ROOT, rooms: Sequence[str] = ROOMS) -> str:
    """Return the hash of the code below `root`, in these rooms, that decides accuracy."""
    package, found = root / "src/splitband", hashlib.sha256()
    paths = [package / "metrics.py"]
    paths += sorted(path for room in rooms for path in (package / room).rglob("*.py"))
    for path in paths:
        told = _told(ast.parse(path.read_text(encoding="utf-8")))
        found.update(f"{path.relative_to(package).as_posix()}: {told}\n".encode())
    return found.hexdigest()[:12]


def _told(node: Any) -> Any:
    """Return a syntax tree as tuples, which are the same for every version of Python."""
    if isinstance(node, list):
        return [_told(each) for each in node if not _is_text(each)]
    if not isinstance(node, ast.AST):
        return node
    fields = ((name, _told(value)) for name, value in ast.iter_fields(node))
    return type(node).__name__, *(
        (name, value) for name, value in fields if value not in ([], None)
    )


def _is_text(node: Any) -> bool:
    """Return whether a statement is a docstring, or a string that explains a constant."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


@cache
def equal(
    path: Path = EQUAL, rooms: Sequence[str] = ROOMS, record: str | None = None
) -> frozenset[str]:
    """Return the hashes of the sources that are known to compute what today's do, of a record."""
    alike = [row for row in read(path) if record not in row.get("others", [])]
    pairs = [{*row["sources"]} for row in alike if record or "others" not in row]
    found = {_read_once(rooms)}
    while more := {each for pair in pairs if pair & found for each in pair} - found:
        found |= more
    return frozenset(found)


@cache
def _read_once(rooms: Sequence[str]) -> str:
    """Return the hash of today's sources, which take half a second to read."""
    return sources(rooms=rooms)


def current(row: Row) -> bool:
    """Return whether a run is of today's sources, or of equal ones."""
    rooms = tuple(row.get("rooms", ROOMS))
    return row.get("sources") in equal(rooms=rooms, record=row.get("record"))


def sign(rows: Iterable[Row]) -> str:
    """Return the mark of a line of a table, if one of its runs is not current."""
    return "" if all(map(current, rows)) else f" {SIGN}"


def note(rows: Sequence[Row]) -> str:
    """Return the sentences below a table: where its runs were measured, and the mark's meaning."""
    old = [row for row in rows if not current(row)]
    new = [row for row in rows if current(row)]
    said = []
    if old:
        said.append(f"{SIGN} Measured at {_where(old)}, before code that decides accuracy changed.")
    if new:
        said.append(f"{'The others were measured' if old else 'Measured'} at {_where(new)}.")
    return "".join(f"\n{sentence}\n" for sentence in said)


def _where(rows: Iterable[Row]) -> str:
    """Return commits and machines of runs in words."""
    rows = [*rows]
    commits = [*dict.fromkeys(filter(None, (row.get("commit") for row in rows)))]
    plural = "s" if len(commits) > 1 else ""
    where = f"commit{plural} {', '.join(commits)}" if commits else "an earlier commit"
    machines: dict[str, list[float]] = {}
    for of in filter(None, (row.get("computer") for row in rows)):
        name = f"{of['processor']}, {of['cores']} cores"
        machines.setdefault(name, []).extend(of["reference_seconds"])
    said = [
        f"{name}, reference training {min(took):.2g} to {max(took):.2g} s" if took else name
        for name, took in machines.items()
    ]
    return where + (f" ({'; '.join(said)})" if said else "")


def reference() -> float:
    """Return the seconds of a fixed training on one thread, of torch's own GRU."""
    import torch  # noqa: PLC0415

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        torch.manual_seed(0)
        network, u = torch.nn.GRU(2, 32, batch_first=True), torch.randn(50, 150, 2)
        adam = torch.optim.Adam(network.parameters())
        began = time.perf_counter()
        for _ in range(_STEPS):
            adam.zero_grad()
            network(u)[0].square().mean().backward()
            adam.step()
        return time.perf_counter() - began
    finally:
        torch.set_num_threads(threads)


def marked(row: Row, *before: float) -> Row:
    """Return a run with the hash of today's sources and the computer.

    `before`: seconds of reference trainings before the run, to which one is added now.
    """
    took = [round(seconds, 3) for seconds in (*before, reference())]
    computer = {"processor": _processor(), "cores": os.cpu_count(), "reference_seconds": took}
    return row | {"sources": sources(), "computer": computer}


def _processor() -> str:
    """Return the name of the processor; the platform module knows none on Linux."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def read(path: Path) -> list[Row]:
    """Return the runs of a file, one in a line."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def stored() -> Iterator[tuple[str, list[Row]]]:
    """Yield each file of runs of the plain command, and its runs."""
    for name in ("clock", "families"):
        yield f"{name}.jsonl", read(STORED / f"{name}.jsonl")
    for path in sorted(STORED.glob("against-*.json")):
        points = json.loads(path.read_text(encoding="utf-8"))["points"]
        yield path.name, [point for point in points if point["library"] == "splitband"]


def main() -> None:
    """Print how many runs of each file are not current."""
    argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0]).parse_args()
    for name, rows in stored():
        print(f"{name}: {sum(not current(row) for row in rows)} of {len(rows)} runs are stale")


if __name__ == "__main__":
    main()
