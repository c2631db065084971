"""What `splitband compare` makes of its time: seconds asked and used, share in trainings, error.

    python -m benchmarks.clock [--records tanks5 tanks] [--budgets 30s 2m] [--seeds 5] [--beside 2]

Each run is the plain command in a process of its own. A run is a line of JSON, appended to OUT as
it ends; what is there is not run again. Errors are those of the recommended method, in the record's
unit, on the test records, or else of the forecast. `--beside N` has N processes compute meanwhile.
The public records are read from SPLITBAND_DATA_DIR.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.commands import RECORDS
from splitband.cli.options import seconds

Row = dict[str, Any]
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
        subprocess.run([*command, *options], check=True, timeout=PATIENCE * row["asked"])
    took = time.perf_counter() - began
    found = json.loads((out / "results.json").read_text(encoding="utf-8"))
    best, spent = found["recommended"], found["time"]
    median = found["methods"][best]["median_of_seeds"]
    return row | {
        "took": round(took, 1),
        "used": spent["used_seconds"],
        "in_trainings": spent["trained_seconds"] / (spent["cores"] * spent["used_seconds"]),
        "recommended": best,
        "errors": median.get("test_rmse") or [median["forecast_rmse"]],
        "commit": found["environment"]["commit"],
    }


def table(rows: Iterable[Row]) -> Iterator[str]:
    """Yield a line for each record and budget: medians over the seeds, errors with their range.

    The seconds taken, from outside, are the most of any seed.
    """
    groups: dict[tuple[str, float, int], list[Row]] = {}
    for row in rows:
        groups.setdefault((row["record"], row["asked"], row["beside"]), []).append(row)
    yield f"{'record':26}{'beside':>7}{'asked':>7}{'used':>7}{'took':>7}{'trains':>8}  error"
    for (name, asked, beside), of in groups.items():
        used, took, share = ([row[key] for row in of] for key in ("used", "took", "in_trainings"))
        errors = [
            f"{statistics.median(each):.3g} ({min(each):.3g} to {max(each):.3g})"
            for each in zip(*(row["errors"] for row in of), strict=True)
        ]
        best = statistics.multimode(row["recommended"] for row in of)[0]
        yield (
            f"{name:26}{beside:7d}{asked:6.0f}s{statistics.median(used):6.0f}s{max(took):6.0f}s"
            f"{statistics.median(share):8.0%}  {' / '.join(errors)}  {best}, {len(of)} seeds"
        )


def main() -> None:
    """Run what is missing, and print the table of all that is there."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--records", nargs="+", default=[*RECORDS], choices=[*RECORDS])
    parser.add_argument("--budgets", nargs="*", default=["30s", "2m", "10m"], help="none: no run")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--beside", type=int, default=0, metavar="N")
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/clock.jsonl"))
    given = parser.parse_args()
    rows = _read(given.out)
    there = {(row["record"], row["asked"], row["seed"], row["beside"]) for row in rows}
    for name, budget, seed in product(given.records, given.budgets, range(given.seeds)):
        key = (name, seconds(budget), seed, given.beside)
        if key in there:
            continue
        row: Row = dict(zip(("record", "asked", "seed", "beside"), key, strict=True))
        with tempfile.TemporaryDirectory() as folder:
            try:
                row = measured(RECORDS[name](Path(folder)), row, Path(folder))
            except subprocess.SubprocessError as error:  # the next call tries it again
                print(f"{row}: {error}", file=sys.stderr, flush=True)
                continue
        with given.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(row, flush=True)
    print(*table(_read(given.out)), sep="\n")


def _read(path: Path) -> list[Row]:
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


if __name__ == "__main__":
    main()
