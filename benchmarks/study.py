"""Studies of many small trainings: one JSON file for each row and seed, made once."""

from __future__ import annotations

import json
import re
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from reproduction import tables
from splitband.report.environment import environment
from splitband.runtime.files import write_json
from splitband.training import Settings

Facts = dict[str, Any]


def path_of(out: Path, name: str, seed: int) -> Path:
    """The file of a row's run."""
    plain = re.sub(r"[^a-z0-9]+", "-", name.replace("'", "").lower()).strip("-")
    return out / f"{plain}-seed{seed}.json"


def complete(
    out: Path, names: Iterable[str], seeds: int, run: Callable[[str, int, Path], Facts]
) -> None:
    """Run what has no file yet, one seed of all rows after the other."""
    out.mkdir(parents=True, exist_ok=True)
    rows = list(names)
    for seed in range(seeds):
        for name in rows:
            path = path_of(out, name, seed)
            if not path.exists():
                print(name, seed, flush=True)
                write_json(path, run(name, seed, path))


def found(out: Path, names: Iterable[str], most: int = 100) -> dict[str, list[Facts]]:
    """The runs that are there, by row and in the order of their seeds."""
    return {
        name: [
            json.loads(path.read_text(encoding="utf-8"))
            for seed in range(most)
            if (path := path_of(out, name, seed)).exists()
        ]
        for name in names
    }


def facts(seed: int, settings: Settings, began: float) -> Facts:
    """What every run keeps beside its results; `began` is the process' time before it."""
    return {
        "seed": seed,
        "settings": asdict(settings),
        "cpu_seconds": round(time.process_time() - began, 1),
        "environment": environment(),
    }


def final(losses: Sequence[float]) -> float:
    """The training loss at the end: the median over the last tenth of the epochs."""
    return statistics.median(losses[-max(1, len(losses) // 10) :])


def few(losses: Sequence[float], most: int = 100) -> list[float]:
    """At most so many values of a curve, the last among them."""
    return [float(f"{loss:.4g}") for loss in losses[::-1][:: -(-len(losses) // most)][::-1]]


def spread(runs: Sequence[Facts], key: str) -> str:
    """Mean and, in brackets, standard deviation over seeds."""
    return tables.spread([run[key] for run in runs])


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table in Markdown, line by line; words to the left, numbers to the right."""
    rows = [*rows]
    columns = zip(*rows, strict=True) if rows else [[]] * len(header)
    number = re.compile(r"(-?\d+(\.\d+)?( \(.*\))?)?")
    ruled = ["---:" if all(map(number.fullmatch, column)) else "---" for column in columns]
    return ["| " + " | ".join(line) + " |" for line in (header, ruled, *rows)]
