"""Records by name, as arguments of `splitband compare`: measured ones, and ones that are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import kinds
from benchmarks.driven import SYSTEMS, drawn
from benchmarks.sets import SETS, load
from splitband import Record

PENDULUM = '''"""A pendulum without its dry friction."""
import math


def pendulum(t, x, u, p):
    return [x[1], -p.stiffness * math.sin(x[0]) - p.damping * x[1] + u[0]]
'''


def public(name: str, folder: Path) -> list[str]:
    """Return the arguments for a public benchmark."""
    of = SETS[name]
    tests = [load(test) for test in of.tests]
    return [*_with_tests(load(of.training), tests, folder), "--initial", str(of.initial)]


def alone(make: Callable[[np.random.Generator], Record], folder: Path) -> list[str]:
    """Return the arguments for a drawn record, whose last quarter is forecast."""
    return written(make(np.random.default_rng(0)), folder / "record.csv")


def wiener_hammerstein(folder: Path) -> list[str]:
    """Return the arguments for 20,000 samples of a drawn system, and a test record."""
    record, *tests = drawn("Wiener-Hammerstein", 1000, 20_000)
    return _with_tests(record, tests, folder)


def short(system: str, folder: Path) -> list[str]:
    """Return the arguments for 400 samples of a drawn system, in deviations of its test record."""
    record, test = drawn(system, 1000, 400)
    scaled = (replace(each, y=each.y / test.y.std()) for each in (record, test))
    return _with_tests(next(scaled), [*scaled], folder)


def equation(folder: Path) -> list[str]:
    """Return the arguments for a pendulum with an equation that has parameters."""
    (folder / "plant.py").write_text(PENDULUM, encoding="utf-8")
    ranges = "stiffness=1:100,damping=0:1,x0_1=-2:2,x0_2=0"
    simulator = ["--simulator", f"{folder / 'plant.py'}:pendulum", "--parameters", ranges]
    return alone(kinds.pendulum_with_friction, folder) + simulator


SHORT = {f"{system}, 400 samples": system for system in SYSTEMS}
RECORDS: dict[str, Callable[[Path], list[str]]] = {
    **{name: partial(public, name) for name in SETS},
    "tank, 400 samples": partial(alone, partial(kinds.one_tank, samples=400)),
    "tank, 4,000 samples": partial(alone, partial(kinds.one_tank, samples=4000)),
    "five inputs, two outputs": partial(alone, kinds.five_inputs),
    "a million samples": partial(alone, partial(kinds.four_channels, samples=1_000_000)),
    "65,000 samples, no inputs": partial(alone, partial(kinds.two_tones, samples=65_000)),
    "200 samples, no inputs": partial(alone, partial(kinds.two_tones, samples=200)),
    "drill string": lambda _: ["drill-string"],
    "van der Pol": lambda _: ["van-der-pol"],
    "crane": lambda _: ["overhead-crane"],
    "pendulum": equation,
    "Wiener-Hammerstein": wiener_hammerstein,
    **{name: partial(short, system) for name, system in SHORT.items()},
}


def written(record: Record, path: Path) -> list[str]:
    """Write a record to a CSV file, without its simulator; return the arguments that name it."""
    names = ["time", *record.inputs, *record.columns]
    u = np.empty((len(record), 0)) if record.u is None else record.u
    table = np.column_stack([record.sampling_time * np.arange(len(record)), u, record.y_with_gaps])
    np.savetxt(path, table, "%.12g", ",", header=",".join(names), comments="")
    return [str(path), *(["--inputs", ",".join(record.inputs)] if record.inputs else [])]


def _with_tests(record: Record, tests: Sequence[Record], folder: Path) -> list[str]:
    words = written(record, folder / "record.csv")
    for i, test in enumerate(tests, 1):
        words += ["--test", written(test, folder / f"test{i}.csv")[0]]
    return words
