"""The figures behind docs/results/claims.md, out of the run files: OUT/readings.json."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import study
from reproduction import high_pass, published
from reproduction.jobs import Job
from reproduction.readings import BASE, FALLING_RATE, GRU_READINGS, HP_READINGS, READINGS
from reproduction.runs import load
from reproduction.specs import DRAWS
from reproduction.system_i import NAIVE, NETWORKS, path_of
from splitband.filters import ComplementaryPair

SEEDS = 5
SOON = 100
"""Samples after the warm-up that are called the short term."""
_HYBRIDS = ("gru", "residual-gru", "filtered-gru", "rnn", "residual-rnn", "filtered-rnn")
HORIZONS = {
    **dict.fromkeys(("i", "ii", "iii", "iv"), NETWORKS),
    **dict.fromkeys(("ii-simulated", "iii-simulated", "iv-simulated"), NETWORKS),
    **dict.fromkeys(("v", "vi"), (*_HYBRIDS, "simulator")),
}
Runs = Sequence[Mapping[str, Any]]


def of_reading(near: Path, method: str, name: str, draw: int = 0, seeds: int = 100) -> Runs:
    """Return the runs on system (i) that are there, by seed; `late` is added to each.

    `late` is the mean error over the last tenth of the epochs: the last one alone is a lottery.
    """
    paths = [path_of(near, method, name, seed, draw) for seed in range(seeds)]
    runs = [json.loads(path.read_text(encoding="utf-8")) for path in paths if path.exists()]
    for run in runs:
        if "errors" in run:
            run["late"] = float(np.mean(run["errors"][-max(1, len(run["errors"]) // 10) :]))
    return runs


def of_table(results: Path, system: str, method: str) -> Runs:
    """Return the runs of the paper's tables that are there, by seed."""
    jobs = [Job(system, method, seed) for seed in range(SEEDS)]
    return [load(job, results) for job in jobs if (results / job.path).exists()]


def horizons(results: Path, system: str, method: str) -> dict[str, list[float]]:
    """Return the errors of each free run: of its first samples, its last quarter, all of it."""
    runs = of_table(results, system, method)
    if not runs:
        return _by_horizon([])
    truth = Job(system, method).record.truth  # simulated, which takes seconds
    errors = [truth[-len(run["from_start"][0]) :] - np.array(run["from_start"]).T for run in runs]
    return _by_horizon(errors)


def _by_horizon(errors: Iterable[Any]) -> dict[str, list[float]]:
    parts = {"soon": slice(SOON), "late": slice(-1, None), "total": slice(None)}
    found: dict[str, list[float]] = {name: [] for name in parts}
    for error in errors:
        parts["late"] = slice(-len(error) // 4, None)
        for name, part in parts.items():
            found[name].append(float(np.sqrt(np.mean(error[part] ** 2))))
    return found


def low_band(results: Path, system: str) -> dict[str, list[float]]:
    """Return the errors of the first split GRU's low band, beside the low-passed true signal."""
    job = Job(system, "split-gru", 0)
    run, record = load(job, results), job.record
    settings = run["settings"]
    pair = ComplementaryPair.butterworth(
        settings["cutoff"], record.sampling_rate, settings["order"]
    )
    low = np.array(run["components"]["low band"]).T
    return _by_horizon([pair.lowpass(record.truth)[-len(low) :] - low])


def collected(out: Path) -> dict[str, Any]:
    """Return every figure by what it is of; each mean has its standard deviation beside it."""
    near, results = out / "system-i", out / "runs"
    readings = {"gru": GRU_READINGS, "split-gru": READINGS, "split-gru-hp": HP_READINGS}
    oracle = json.loads((near / "oracle-draws.json").read_text(encoding="utf-8"))
    paper = published.LEARNING_BASED["i"]["split-gru"].mean
    return {
        "horizons": {
            system: {method: _spreads(horizons(results, system, method)) for method in methods}
            for system, methods in HORIZONS.items()
        },
        "low band": {s: _spreads(low_band(results, s)) for s in ("i", "ii", "iii", "iv")},
        "readings": {
            method: {name: _of_runs(of_reading(near, method, name)) for name in (BASE, *of)}
            for method, of in readings.items()
        },
        "draws": {
            method: {
                name: _of_runs([run for draw in range(DRAWS)
                                for run in of_reading(near, method, name, draw, seeds=1)])
                for name in (BASE, FALLING_RATE)
            }
            for method in (*NETWORKS, *NAIVE, "oracle")
        },
        "oracle": {
            noise: {"median": float(np.median(errors)),
                    "below": float(np.mean(np.array(errors) < paper))}
            for noise, errors in oracle.items()
        },
        "high pass": {
            row: {name: _of_runs(runs) for name, runs in
                  study.found(out / "high-pass" / row, high_pass.RECIPES).items()}
            for row in high_pass.SYSTEM_ROWS
        },
    }  # fmt: skip


_KEYS = ("total_rmse", "forecast_rmse", "late", "late_deviation", "best", "lowest")


def _of_runs(runs: Runs) -> dict[str, Any]:
    there = [key for key in _KEYS if runs and all(key in run for run in runs)]
    return _spreads({key: [run[key] for run in runs] for key in there})


def _spreads(values: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Return mean, standard deviation and median of each that has any, to six digits."""
    return {
        key: {
            "mean": _short(np.mean(of)),
            "deviation": _short(np.std(of, ddof=1)) if len(of) > 1 else 0.0,
            "median": _short(np.median(of)),
            "runs": len(of),
        }
        for key, of in values.items()
        if of
    }


def _short(value: Any) -> float:
    return float(f"{value:.6g}")
