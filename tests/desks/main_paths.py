"""The main paths of a user, in the working folder: they run on every system of the package.

    python main_paths.py

It needs the installed package with the extra `networks`, and nothing of this repository beside it.
"""

from __future__ import annotations

import csv
import json
import math
import sys
from pathlib import Path
from typing import Any

SAMPLES, AHEAD, TRAIN, STEP = 240, 20, 180, 0.1
CHANNEL = "φ (°)"  # which the code page of Western Europe cannot hold
SIMULATOR = "def swing(time):\n    print('a simulator may print')\n    return 0.3 * time\n"
SHORT = "--recipe constant-rate --epochs 2 --hidden 3,4 --window 30 --warmup 10"


def force(n: int) -> float:
    """The input at a sample."""
    return math.copysign(1.0, math.sin(0.17 * n))


def write_files() -> None:
    """A record with one input, the inputs of the samples after it, and a simulator."""
    y = 0.0
    with Path("rig.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", "force", CHANNEL])
        for n in range(SAMPLES):
            rows.writerow([round(STEP * n, 9), force(n), round(y, 9)])
            y = 0.9 * y + 0.1 * force(n) + 0.02 * math.sin(0.9 * n)
    with Path("future.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", "force"])
        rows.writerows([round(STEP * n, 9), force(n)] for n in range(SAMPLES, SAMPLES + AHEAD))
    Path("swing.py").write_text(SIMULATOR, encoding="utf-8")


def splitband(line: str, *paths: str) -> None:
    """Run a command as the entry point does; it must succeed. Paths may have blanks."""
    from splitband.cli import main  # noqa: PLC0415  workers, which import this file, do not need it

    sys.argv = ["splitband", *line.split(), *paths]
    assert main() == 0, line


def results(folder: str) -> dict[str, Any]:
    """What a command has written."""
    found: dict[str, Any] = json.loads(Path(folder, "results.json").read_text(encoding="utf-8"))
    return found


def main_paths() -> None:
    """Compare on two cores, with a simulator in its own process; forecast, fit, use, export."""
    import splitband as sb  # noqa: PLC0415  as above
    from splitband.comparison import candidates  # noqa: PLC0415

    candidates.FIRST_STEPS = candidates.FIRST_ROUND = 3  # a round takes a moment
    given, methods = "rig.csv --inputs force", f"--train {TRAIN} --methods"
    search = "--hidden 3,4 --rounds 1 --seeds 1 --jobs 2"
    splitband(f"compare {given} {methods} gru,linear {search} --out out")
    assert {"gru", "linear"} <= {*results("out")["methods"]}
    assert CHANNEL in Path("out/report.html").read_text(encoding="utf-8")
    splitband(f"compare {given} {methods} linear --out out")
    assert "gru" not in results("out")["methods"]
    swing = f"{Path('swing.py').resolve()}:swing"  # on Windows C:\...\swing.py:swing
    beside = f"compare {given} {methods} simulator,mean --warmup 10 --jobs 1 --out beside"
    splitband(f"{beside} --simulator", swing)
    splitband("summary out beside --out table.csv")
    assert b"\r" not in Path("table.csv").read_bytes()
    coming = "--future-inputs future.csv"
    splitband(f"forecast {given} --method linear --steps 5 {coming} --out ahead")
    splitband(f"fit {given} --method gru {SHORT} --out model")
    splitband(f"simulate model --steps {AHEAD} {coming} --out simulated.csv")
    splitband("export model model.c")
    splitband(f"inspect {given} --out inspected")
    record = sb.read("rig.csv", inputs=["force"])
    inputs = [[force(n)] for n in range(SAMPLES, SAMPLES + AHEAD)]
    model = sb.load("model").predict(AHEAD, u=inputs)
    assert abs(model.y - sb.read("simulated.csv").y).max() < 1e-9
    assert sb.compare(record, TRAIN, ["mean", "linear"]).recommended in ("mean", "linear")
    print("all main paths run")


if __name__ == "__main__":
    write_files()
    main_paths()
