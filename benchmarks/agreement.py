"""How far the numbers of `compare` depend on who trains: this machine, one worker, two workers.

python -m benchmarks.agreement [--out FILE.json]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.timing import circumstances, write
from splitband.cli import main as splitband

COMPARE = "compare record.csv --columns y --inputs force --methods gru,split-gru,linear,mean "
COMPARE += "--epochs 20 --seeds 3"
TIMES = {"seconds", "cpu_seconds", "arguments", "environment"}
"""What says how and where numbers were computed, and is none of them."""


def write_record(path: Path) -> None:
    """Two tones under a little noise, and a force that jumps."""
    t, rng = 0.1 * np.arange(600), np.random.default_rng(0)
    force = np.repeat(rng.choice([-1.0, 1.0], 30), 20)
    y = np.sin(2 * np.pi * 0.1 * t) + 0.4 * np.sin(2 * np.pi * 1.1 * t) + 0.2 * force
    y += 0.05 * rng.standard_normal(len(t))
    pd.DataFrame({"time": t, "y": y, "force": force}).to_csv(path, index=False)


def numbers(facts: Any, where: str = "") -> Iterator[tuple[str, float]]:
    """All numbers of a JSON file, and where each of them stands; but for times."""
    if isinstance(facts, dict):
        for key in facts.keys() - TIMES:
            yield from numbers(facts[key], f"{where}/{key}")
    elif isinstance(facts, list):
        for i, each in enumerate(facts):
            yield from numbers(each, f"{where}/{i}")
    elif isinstance(facts, int | float):
        yield where, float(facts)


def compared(folder: Path, trained_by: str) -> dict[str, float]:
    """The numbers of `results.json`."""
    out = folder / f"{len([*folder.iterdir()])}"
    line = COMPARE.replace("record.csv", str(folder / "record.csv"))
    if status := splitband([*line.split(), *trained_by.split(), "--out", str(out)]):
        raise SystemExit(status)
    return dict(numbers(json.loads((out / "results.json").read_text(encoding="utf-8"))))


def by_cluster(folder: Path, workers: int) -> dict[str, float]:
    """The same from workers of one thread each."""
    from distributed import LocalCluster  # noqa: PLC0415

    with (
        TemporaryDirectory() as scratch,
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=":0",
            local_directory=scratch,
        ) as local,
    ):
        return compared(folder, f"--cluster {local.scheduler_address}")


def difference(found: dict[str, float], expected: dict[str, float]) -> dict[str, float]:
    """The largest one, as it is and in multiples of the number itself."""
    assert found.keys() == expected.keys()
    by = {where: abs(found[where] - value) for where, value in expected.items()}
    relative = [by[where] / abs(value) for where, value in expected.items() if value]
    return {"largest difference": max(by.values()), "largest relative difference": max(relative)}


def main() -> None:
    """Compare, print, and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    arguments = parser.parse_args()
    figures = circumstances("torch", "numpy", "distributed") | {"command": COMPARE}
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_record(folder / "record.csv")
        here = compared(folder, "--jobs 1")
        figures["numbers"] = len(here)
        for words, workers in (("one worker", 1), ("two workers", 2)):
            figures[words] = difference(by_cluster(folder, workers), here)
    print(figures)
    write(figures, arguments.out)


if __name__ == "__main__":
    main()
