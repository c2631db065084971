"""Run what the paper's tables leave open, one run after the other; each is a file, made once.

These are the runs of `python -m reproduction readings`.
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks import study
from reproduction import high_pass
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
from splitband.runtime.threads import one_thread

TITLES = {
    "oracle": "Least squares on the true form of (i), 200 noise draws, under both noises",
    "baselines": "Baselines on (i) under the nearest reading, 20 noise draws",
    "seeds": "Networks on (i) under the nearest reading, five seeds",
    "readings": "Other readings of the text, one at a time, five seeds",
    "ablations": "Cut-off and down-sampling under the nearest reading",
    "draws": "Networks under the nearest reading, 20 noise draws",
    "+HP": "A high band that learns, on the double-torsion record, five seeds",
}
"""The parts of the queue."""
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
    part : One of `TITLES`.
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


def complete(out: Path, report: Callable[[str], None]) -> None:
    """Run what has no file yet, and report each run that is done."""
    for item in missing(out):
        item.path.parent.mkdir(parents=True, exist_ok=True)
        began = time.monotonic()
        with one_thread():
            write_json_lines(item.path, item.run())
        item.finish()
        report(f"{item.path.relative_to(out)} {time.monotonic() - began:.0f} s")


@dataclass(frozen=True)
class Part:
    """How much of one part is there: runs, and seconds of a core for those that are missing."""

    name: str
    runs: int
    there: int
    seconds: float


def parts(out: Path) -> list[Part]:
    """Return what is there and what is missing, by part.

    The cost of a part's missing runs is corrected by how long its finished ones took.
    """
    every = once(out)
    found = []
    for name in dict.fromkeys(item.part for item in every):
        of_part = [item for item in every if item.part == name]
        todo = [item for item in of_part if not item.path.exists()]
        factor = _correction([item for item in of_part if item.path.exists()])
        seconds = factor * sum(item.seconds for item in todo)
        found.append(Part(name, len(of_part), len(of_part) - len(todo), seconds))
    return found


def _correction(done: list[Item]) -> float:
    ratios = [
        facts["cpu_seconds"] / item.seconds
        for item in done
        if "cpu_seconds" in (facts := json.loads(item.path.read_text(encoding="utf-8")))
        and not facts.get("resumed")
    ]
    return statistics.mean(ratios) if ratios else 1.0
