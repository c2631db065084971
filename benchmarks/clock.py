"""What `splitband compare` makes of its time: seconds asked and used, share in trainings, error.

    python -m benchmarks.clock [--records tanks5 tanks] [--budgets 30s 2m] [--seeds 5] [--beside 2]

Each run is the plain command in a process of its own. A run is a line of JSON, written to OUT as it
ends; what is there, and of today's code (`benchmarks.claims`), is not run again. Errors are those
of the recommended method, in the record's unit, on the test records, or else of the forecast.
`--beside N` has N processes compute meanwhile. The public records are read from SPLITBAND_DATA_DIR.
`python -m benchmarks.page` makes the tables of docs/results/benchmarks.md of the runs there are.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path

from benchmarks import claims
from benchmarks.claims import Row
from benchmarks.commands import RECORDS
from splitband.cli.options import seconds
from splitband.runtime.files import write_text

FILE = "clock.jsonl"
PATIENCE = 10.0
"""A command is ended after this multiple of its budget."""


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Let so many processes compute in the meantime."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def measured(words: Sequence[str], row: Row, folder: Path) -> Row:
    """Run the command and return what it came to."""
    out = folder / "out"
    command = [sys.executable, "-m", "splitband", "--quiet", "compare", *words, "--out", str(out)]
    options = ["--budget", f"{row['asked']:g}s", "--seed", str(row["seed"])]
    began = time.perf_counter()
    with busy(row["beside"]):
        subprocess.run(
            [*command, *options], check=True, timeout=PATIENCE * row["asked"], env=usual()
        )
    took = time.perf_counter() - began
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    best, spent = found["recommended"], found["time"]
    median = found["methods"][best]["median_of_seeds"]
    return row | {
        "took": round(took, 1),
        "used": spent["used_seconds"],
        "first_training": spent["first_training_seconds"],
        "parts": spent["parts_seconds"],
        "in_trainings": spent["trained_seconds"] / (spent["cores"] * spent["used_seconds"]),
        "recommended": best,
        "errors": median.get("test_rmse") or [median["forecast_rmse"]],
        "commit": found["environment"]["commit"],
    }


def usual() -> dict[str, str]:
    """Return the environment of a user: without compiled modules, torch takes twice as long."""
    return {n: of for n, of in os.environ.items() if n != "PYTHONDONTWRITEBYTECODE"}


def groups(rows: Iterable[Row]) -> dict[tuple[str, float, int], list[Row]]:
    """Return the runs of each record, budget and number of busy processes."""
    found: dict[tuple[str, float, int], list[Row]] = {}
    for row in rows:
        found.setdefault((row["record"], row["asked"], row["beside"]), []).append(row)
    return dict(sorted(found.items(), key=lambda item: ([*RECORDS].index(item[0][0]), item[0][1:])))


def recommended(rows: Iterable[Row]) -> str:
    """Return what is recommended, the most frequent first."""
    names = [row["recommended"] for row in rows]
    return ", ".join(sorted({*names}, key=lambda name: (-names.count(name), name)))


def main() -> None:
    """Run what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--records", nargs="+", default=[*RECORDS], choices=[*RECORDS])
    parser.add_argument("--budgets", nargs="+", default=["30s", "2m", "10m"])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--beside", type=int, default=0, metavar="N")
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    given = parser.parse_args()
    # Budget by budget and seed by seed, so that an early end leaves all records.
    asked = product(given.budgets, range(given.seeds), given.records)
    rows: list[Row] = [
        {"record": name, "asked": seconds(budget), "seed": seed, "beside": given.beside}
        for budget, seed, name in asked
    ]
    complete(given.out / FILE, rows, lambda row, to: measured(RECORDS[row["record"]](to), row, to))


def complete(path: Path, rows: Iterable[Row], run: Callable[[Row, Path], Row]) -> None:
    """Run what is missing in a file, and write each run as it ends, in place of a stale one.

    A run is missing where no current line has all the values of its row; `run` completes the row,
    with a folder for its files.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    there = [*filter(claims.current, claims.read(path))]
    rows = [row for row in rows if not any(row.items() <= each.items() for each in there)]
    hours = sum(row.get("asked", 0.0) for row in rows) / 3600
    print(f"{path}: {len(rows)} runs are missing, with budgets of {hours:.1f} hours", flush=True)
    for row in rows:
        before = claims.reference()
        with tempfile.TemporaryDirectory() as folder:
            try:
                found = run(row, Path(folder))
            except subprocess.SubprocessError as error:  # the next call tries it again
                print(f"{row}: {error}", file=sys.stderr, flush=True)
                continue
        kept = [each for each in claims.read(path) if not row.items() <= each.items()]
        lines = [json.dumps(each) + "\n" for each in (*kept, claims.marked(found, before))]
        write_text(path, "".join(lines))
        print(found, flush=True)


if __name__ == "__main__":
    main()
