"""What a short history costs: networks that were trained with 50 samples to start from, given 5.

    python -m benchmarks.warmup [--systems ...] [--seeds 100 101] [--samples 600]

Each network simulates pieces of the test record of `benchmarks.driven`, each from its last samples
before: as many as in training, or a few, where what came before is estimated
(`splitband.forecasters.prehistory`). `rest` is what a system at rest would have done before: the
first of the few samples, repeated. Errors are shares of the test record's deviation, all pieces
together. Nothing is searched: sizes and training are the same for all records.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import geometric_mean

import numpy as np

import splitband as sb
from benchmarks.driven import SYSTEMS, drawn
from splitband import Record
from splitband.runtime.files import write_json
from splitband.runtime.threads import use_one_thread

WARMUP, FEW = 50, 5
PIECE, APART = 200, 60
"""Samples of a simulation, and from the beginning of one to that of the next."""
NETWORKS: dict[str, Callable[[sb.Settings], sb.Forecaster]] = {
    "state-space": lambda settings: sb.Single(sb.StateSpace(4, 8), settings),
    "gru": lambda settings: sb.Single(sb.GRU(16), settings),
    "split-gru": lambda settings: sb.Split(sb.GRU(16), sb.GRU(8), settings=settings),
    "residual": lambda settings: sb.Residual(sb.Linear(), sb.GRU(16), settings=settings),
    "filtered": lambda settings: sb.Filtered(
        sb.Linear(), sb.GRU(16), conditioned=True, settings=settings
    ),
}
ITERATIONS = 200
"""Of L-BFGS, after the recipe's epochs."""


def errors(network: sb.Forecaster, test: Record) -> dict[str, float]:
    """Return the errors of all pieces together, by what each of them is given."""
    assert test.u is not None
    left: dict[str, list[float]] = {}
    for origin in range(APART, len(test) - PIECE, APART):
        few = np.arange(origin - FEW, origin)
        rows = {
            "all": np.arange(origin - WARMUP, origin),
            "few": few,
            "rest": np.concatenate([np.repeat(few[:1], WARMUP - FEW), few]),
        }
        ahead = slice(origin, origin + PIECE)
        for name, before in rows.items():
            history = Record(test.y[before], test.sampling_time, u=test.u[before])
            with warnings.catch_warnings(action="ignore", category=sb.ExtrapolationWarning):
                found = network.predict(PIECE, history, u=test.u[ahead], other_record=True)
            left.setdefault(name, []).append(float(np.mean((found.y - test.y[ahead]) ** 2)))
    return {name: float(np.mean(each) ** 0.5 / test.y.std()) for name, each in left.items()}


def main() -> None:
    """Measure what is missing, and print the geometric means over systems and seeds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--systems", nargs="*", default=[*SYSTEMS], choices=[*SYSTEMS])
    parser.add_argument("--seeds", nargs="*", type=int, default=[100, 101])
    parser.add_argument("--samples", type=int, default=600)
    parser.add_argument("--networks", nargs="*", default=[*NETWORKS], choices=[*NETWORKS])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/warmup.json"))
    given = parser.parse_args()
    use_one_thread()
    found = json.loads(given.out.read_text()) if given.out.exists() else {}
    for name in given.networks:
        of_network = found.setdefault(name, {})
        for system in given.systems:
            for seed in given.seeds:
                key = f"{system}, {seed}, {given.samples} samples"
                if key not in of_network:
                    record, test = drawn(system, seed, given.samples)
                    settings = replace(
                        sb.Settings.of(given.samples), warmup=WARMUP, quasi_newton=ITERATIONS
                    )
                    network = NETWORKS[name](settings).fit(record, seed=0)
                    of_network[key] = errors(network, test)
                    write_json(given.out, found)
        for kind in ("few", "rest"):
            over = geometric_mean(each[kind] / each["all"] for each in of_network.values())
            print(f"{name}: {kind} over all {over:.2f}", flush=True)


if __name__ == "__main__":
    main()
