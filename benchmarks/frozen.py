"""What a commit computes, to the bit, against what another one computes on this machine.

    python -m benchmarks.frozen COMMIT [--records "drill string" demo] [--rounds 2]
    python -m benchmarks.frozen COMMIT --list [--but pendulum]

Both commits run `splitband compare --rounds 2 --seed 0` on the same records, each with its own
source (COMMIT from a worktree that is removed afterwards). Compared are the errors of every method,
the predictions as written, and to eight digits what the stream of the saved model says and what it
says once exported to C. A change that should alter no number is one after which each line says
"equal"; the others name what differs and by how much. Rounding differs between processors, so that
no number is stored. `--list` compares all records and, where all are equal, adds the hashes of both
sources to those for which stored runs of either are current (`benchmarks.claims`). A change that
is to alter some records names them by `--but`, those of `benchmarks.clock` that are not compared
here, too: the list then holds for runs of all other records.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks import claims
from benchmarks.commands import RECORDS
from splitband.report.environment import environment

ROOT = Path(__file__).parents[1]
_STEPPED = """
import ctypes, subprocess, sys
import numpy as np
import splitband as sb

model = sb.load(sys.argv[1])
record, stream = model.fitted.record, model.stream()
given = [] if record.u is None else [record.u[-1]]
said = [stream.step(*given) for _ in range(20)]
model.export("model.c")
subprocess.run("gcc -shared -fPIC model.c -o model.so -lm".split(), check=True)
program, state = ctypes.CDLL("./model.so"), ctypes.create_string_buffer(10**7)
program.model_init(state)
arrays = [*map(np.ascontiguousarray, given), np.zeros(record.ny)]
for _ in range(20):
    program.model_step(state, *(a.ctypes.data_as(ctypes.c_void_p) for a in arrays))
    said.append(arrays[-1].copy())
print([[f"{x:.8g}" for x in y] for y in said])
"""
"""Twenty steps of a model with its last inputs, as a stream and in C."""
_NAMED = "double-mass-spring", "double-torsion"
_TANKS = "tanks", "tank, 400 samples", "tank, 4,000 samples"
_OTHERS = (
    *("van der Pol", "five inputs, two outputs", "200 samples, no inputs"),
    *("drill string", "crane", "pendulum"),
)
COMPARED: dict[str, Callable[[Path], list[str]]] = {
    **{name: lambda _, name=name: [name] for name in _NAMED},  # type: ignore[misc]
    **{name: RECORDS[name] for name in (*_TANKS, *_OTHERS)},
}
"""Records of all kinds of plans, the demo beside them."""


@contextmanager
def source_of(commit: str) -> Iterator[Path]:
    """Check a commit out for as long as the context lasts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "source"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(path), commit], check=True)
        try:
            yield path
        finally:
            subprocess.run([*git, "remove", "--force", str(path)], check=True)


def computed(source: Path, words: list[str], folder: Path) -> dict[str, Any]:
    """Run a command with the package of `source`; return its errors and digests of its files."""
    environment = {**os.environ, "PYTHONPATH": str(source / "src")}
    out = folder / "out"
    run = [sys.executable, "-m", "splitband", "--quiet"]
    subprocess.run([*run, *words, "--out", str(out)], check=True, env=environment, cwd=folder)
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    facts: dict[str, Any] = {
        f"{name}: {kind}": error
        for name, of in found["methods"].items()
        for kind, error in of.get("median_of_seeds", {"failed": of.get("failed")}).items()
    }
    facts["recommended"] = found["recommended"]
    stepped = [sys.executable, "-c", _STEPPED, str(out / "model")]
    done = subprocess.run(
        stepped, check=False, capture_output=True, env=environment, cwd=folder, text=True
    )
    facts["steps"] = done.stdout or done.stderr.strip().splitlines()[-1]
    paths = sorted(out.glob("*.csv"))
    return facts | {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def differences(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return in words what is not the same in both."""
    found = []
    for name in dict.fromkeys([*old, *new]):
        a, b = old.get(name, "none"), new.get(name, "none")
        if a != b:
            digest = isinstance(a, str) and len(a) == 64
            found.append(f"{name} differs" if digest else f"{name}: {a} was, {b} is")
    return found


def main() -> None:
    """Print a line for each record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit")
    parser.add_argument("--records", nargs="*", default=[*COMPARED, "demo"])
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="keep that all are equal")
    parser.add_argument("--but", nargs="*", default=[], help="records that may differ")
    given = parser.parse_args()
    if given.list and (len(given.records), given.rounds) != (len(COMPARED) + 1, 2):
        parser.error("--list compares all records in two rounds: leave out --records and --rounds")
    lines, others = list[str](), list[str]()
    with source_of(given.commit) as old:
        hashes = [claims.sources(old), claims.sources()]
        for name in given.records:
            found = []
            for source in (old, ROOT):
                with tempfile.TemporaryDirectory() as at:
                    words = COMPARED[name](Path(at)) if name in COMPARED else []
                    command = ["compare", *words] if words else ["demo"]
                    options = ["--rounds", str(given.rounds), "--seed", "0"] if words else []
                    found.append(computed(source, [*command, *options], Path(at)))
            differ = differences(*found)
            others += [name] if differ else []
            lines.append(f"{name}: {'; '.join(differ) or f'equal ({len(found[0])} facts)'}")
            print(lines[-1], flush=True)
        if given.list and {*others} <= {*given.but}:
            others += [name for name in given.but if name not in given.records]  # not compared
            list_as_equal(given.commit, hashes, lines, others)
    sys.exit(bool({*others} - {*given.but}))


def list_as_equal(
    commit: str, hashes: list[str], lines: list[str], others: Sequence[str] = ()
) -> None:
    """Add two sources that compute the same to the list, with the output of the check.

    Not for the records `others`, nor for runs that name no record.
    """
    commits, today = [commit, environment()["commit"]], datetime.now(UTC).date().isoformat()
    row = {"date": today, "commits": commits, "sources": hashes, "output": lines}
    row |= {"others": [*others]} if others else {}
    with claims.EQUAL.open("a", encoding="utf-8") as file:
        file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
