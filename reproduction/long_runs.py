"""Run what the paper's tables leave open, one run after the other; each is a file, made once.

python -m reproduction.long_runs --out DIR             # goes on where it was stopped
python -m reproduction.long_runs --out DIR --plan      # what is missing, and for how long
python -m reproduction.long_runs --out DIR --tables    # the results so far, in Markdown
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks import study
from reproduction import high_pass, long_tables
from reproduction.readings import (
    ABLATIONS,
    BASE,
    COLUMN,
    FALLING_RATE,
    GRU_READINGS,
    HP_READINGS,
    PRINTED,
    READINGS,
    Reading,
)
from reproduction.specs import DRAWS
from reproduction.system_i import NAIVE, NETWORKS, path_of, quick, settings_of, tried
from reproduction.systems import MassSpringOracle
from splitband.runtime.files import write_json_lines

SEEDS = 5
ORACLE_DRAWS = 200
_SECONDS = {"gru": 0.045, "split-gru": 0.018, "split-gru-hp": 0.025}
_HIGH_PASS_SECONDS = {"ii": 0.2, "iii": 0.14, "iv": 0.14}
"""Of a core, an epoch; to begin with."""


@dataclass(frozen=True)
class Item:
    """A run of the queue.

    Attributes
    ----------
    part : For the plan.
    path : Its file.
    seconds : Of a core, roughly.
    run : Makes its facts.
    finish : Called when the file is written.
    """

    part: str
    path: Path
    seconds: float
    run: Callable[[], study.Facts]
    finish: Callable[[], Any] = int


def items(out: Path) -> Iterator[Item]:
    """Yield every run in its order."""
    near = out / "system-i"
    yield Item("oracle", near / "oracle-draws.json", 10, oracle_draws)
    rate = Reading().record(0).sampling_rate
    for draw in range(DRAWS):
        for method in (*NAIVE, "oracle"):
            forecaster = (
                MassSpringOracle()
                if method == "oracle"
                else COLUMN.setup(rate, method).forecaster(method)
            )
            run = partial(quick, method, forecaster, Reading(), draw)
            yield Item("baselines", path_of(near, method, BASE, 0, draw), 0.3, run)
    # What is quick comes first: a single GRU is trained for 2,000 epochs.
    for method in ("split-gru", "split-gru-hp"):
        yield from _seeds("seeds", near, method, {BASE: Reading()})
    yield from _seeds("readings", near, "split-gru", READINGS)
    yield from _seeds("readings", near, "split-gru-hp", HP_READINGS)
    yield from _seeds("seeds", near, "gru", {BASE: Reading()})
    yield from _seeds("readings", near, "gru", GRU_READINGS)
    for method in NETWORKS[1:]:
        yield from _seeds("ablations", near, method, ABLATIONS)
    for method in NETWORKS[::-1]:
        for draw in range(DRAWS):
            path = path_of(near, method, BASE, 0, draw)
            run = partial(tried, method, Reading(), 0, draw)
            yield Item("draws", path, _cost(method, Reading()), run)
    for draw in range(DRAWS):
        for name in (PRINTED, FALLING_RATE):
            path = path_of(near, "split-gru", name, 0, draw)
            run = partial(tried, "split-gru", READINGS[name], 0, draw)
            yield Item("draws", path, _cost("split-gru", READINGS[name]), run)
    for row in high_pass.SYSTEM_ROWS:
        for seed in range(SEEDS):
            for name in high_pass.RECIPES:
                path = study.path_of(out / "high-pass" / row, name, seed)
                run = partial(high_pass.trained, row, name, seed, path)
                seconds = _HIGH_PASS_SECONDS[row] * high_pass.epochs(row)
                finish = partial(high_pass.clean, path)
                yield Item("+HP", path, seconds, run, finish)


def _seeds(part: str, out: Path, method: str, readings: dict[str, Reading]) -> Iterator[Item]:
    """Yield one seed of all readings after the other."""
    for seed in range(SEEDS):
        for name, reading in readings.items():
            run = partial(tried, method, reading, seed)
            yield Item(part, path_of(out, method, name, seed), _cost(method, reading), run)


def _cost(method: str, reading: Reading) -> float:
    return _SECONDS[method] * settings_of(method, reading).epochs


def oracle_draws() -> study.Facts:
    """Return the errors of least squares on the true form over many draws, by the noise."""
    return {
        f"variance {variance:g}": [
            quick("oracle", MassSpringOracle(), Reading(variance), draw)["total_rmse"]
            for draw in range(ORACLE_DRAWS)
        ]
        for variance in (0.01, 0.1)
    }


def missing(out: Path) -> list[Item]:
    """Return the runs without a file, each once."""
    return [item for item in once(out) if not item.path.exists()]


def once(out: Path) -> list[Item]:
    """Return every run, the first time that it is asked for."""
    by_path: dict[Path, Item] = {}
    for item in items(out):
        by_path.setdefault(item.path, item)
    return [*by_path.values()]


def complete(out: Path) -> None:
    """Run what has no file yet."""
    for item in missing(out):
        item.path.parent.mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        write_json_lines(item.path, item.run())
        item.finish()
        took = time.monotonic() - began
        print(f"{time.strftime('%H:%M:%S')} {item.path.relative_to(out)} {took:.0f} s", flush=True)


def plan(out: Path) -> str:
    """Return what is missing: runs and minutes of a core by part, as measured where runs are there.

    The cost of a part's missing runs is corrected by how long its finished ones took.
    """
    every = once(out)
    rows = []
    for part in dict.fromkeys(item.part for item in every):
        of_part = [item for item in every if item.part == part]
        todo = [item for item in of_part if not item.path.exists()]
        factor = _correction([item for item in of_part if item.path.exists()])
        minutes = factor * sum(item.seconds for item in todo) / 60
        rows.append((part, str(len(of_part)), str(len(of_part) - len(todo)), f"{minutes:.0f}"))
    return "\n".join(study.table(("part", "runs", "there", "minutes of a core left"), rows))


def _correction(done: list[Item]) -> float:
    ratios = [
        facts["cpu_seconds"] / item.seconds
        for item in done
        if "cpu_seconds" in (facts := json.loads(item.path.read_text(encoding="utf-8")))
        and not facts.get("resumed")
    ]
    return statistics.mean(ratios) if ratios else 1.0


def main() -> None:
    """Run, or print the plan or the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--plan", action="store_true", help="print what is missing")
    parser.add_argument("--tables", action="store_true", help="print the results so far")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.plan:
        print(plan(arguments.out))
    elif arguments.tables:
        print(long_tables.page(arguments.out))
    else:
        complete(arguments.out)


if __name__ == "__main__":
    main()
