"""Errors of the paper's runs in the short and in the long term: docs/results/horizons.json."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reproduction.jobs import Job
from reproduction.runs import load
from splitband.filters import ComplementaryPair

SOON = 100
"""Samples after the warm-up that are called the short term; the last quarter is the long term."""
SEEDS = 5
_NETWORKS = ("gru", "split-gru", "split-gru-hp")
_HYBRIDS = ("gru", "residual-gru", "filtered-gru", "rnn", "residual-rnn", "filtered-rnn")
METHODS = {
    **dict.fromkeys(("i", "ii", "iii", "iv"), _NETWORKS),
    **dict.fromkeys(("v", "vi"), (*_HYBRIDS, "simulator")),
}


def collected(runs: Path) -> dict[str, Any]:
    """Return every figure by system and method; each mean has its standard deviation beside it."""
    return {
        "horizons": {
            system: {method: _spreads(horizons(runs, system, method)) for method in methods}
            for system, methods in METHODS.items()
        },
        "low band": {s: _spreads(low_band(runs, s)) for s in ("i", "ii", "iii", "iv")},
    }


def horizons(folder: Path, system: str, method: str) -> dict[str, list[float]]:
    """Return the errors of each free run: of its first samples, its last quarter, all of it."""
    jobs = [Job(system, method, seed) for seed in range(SEEDS)]
    runs = [load(job, folder) for job in jobs if (folder / job.path).exists()]
    if not runs:
        return {}
    truth = jobs[0].record.truth  # simulated, which takes seconds
    return _by_horizon(
        truth[-len(run["from_start"][0]) :] - np.array(run["from_start"]).T for run in runs
    )


def low_band(folder: Path, system: str) -> dict[str, list[float]]:
    """Return the errors of the first split GRU's low band, beside the low-passed true signal."""
    job = Job(system, "split-gru")
    run, record = load(job, folder), job.record
    settings = run["settings"]
    pair = ComplementaryPair.butterworth(
        settings["cutoff"], record.sampling_rate, settings["order"]
    )
    low = np.array(run["components"]["low band"]).T
    return _by_horizon([pair.lowpass(record.truth)[-len(low) :] - low])


def _by_horizon(errors: Iterable[Any]) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {"soon": [], "late": [], "total": []}
    for error in errors:
        parts = {"soon": error[:SOON], "late": error[-len(error) // 4 :], "total": error}
        for name, part in parts.items():
            found[name].append(float(np.sqrt(np.mean(part**2))))
    return found


def _spreads(values: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Return mean, standard deviation and median of each, to six digits."""
    return {
        key: {
            "mean": _short(np.mean(of)),
            "deviation": _short(np.std(of, ddof=1)) if len(of) > 1 else 0.0,
            "median": _short(np.median(of)),
            "runs": len(of),
        }
        for key, of in values.items()
    }


def _short(value: Any) -> float:
    return float(f"{value:.6g}")
