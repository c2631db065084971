"""What a short warm-up costs: networks that start a simulation from 5 samples, 10 and 50.

    python -m benchmarks.warmup [--systems ...] [--seeds 100 101] [--samples 600]

Each network is trained with warm-ups of so many samples, and simulates the test record of
`benchmarks.driven` from as many. The network trained with 50 is also given only 5: before them
their first sample and input are repeated. Errors count from the 51st sample of the test record on
in every case, as shares of its deviation; `early` are those of the 100 samples after it. Nothing
is searched: sizes and training are the same for all warm-ups.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import splitband as sb
from benchmarks.driven import SYSTEMS, drawn
from splitband import Record
from splitband.networks.cell import Template
from splitband.runtime.files import write_json
from splitband.runtime.threads import use_one_thread

WARMUPS = 5, 10, 50
LONGEST, EARLY = 50, 100
"""Samples of the test record that do not count, and those after them that do as `early`."""
CELLS: dict[str, Template] = {"gru": sb.GRU(16), "state-space": sb.StateSpace(4, 8)}
ITERATIONS = 200
"""Of L-BFGS, after the recipe's epochs."""


def errors(network: sb.Forecaster, test: Record, given: int, needed: int) -> dict[str, float]:
    """Return the errors of a simulation from so many samples, of which it needs some number."""
    assert test.u is not None
    missing = max(needed - given, 0)
    y, u = (
        np.concatenate([np.repeat(x[:1], missing, axis=0), x[:given]]) for x in (test.y, test.u)
    )
    history = Record(y, test.sampling_time, u=u, name=test.name)
    predicted = network.predict(len(test) - given, history, u=test.u[given:], other_record=True)
    wrong = (predicted.y[LONGEST - given :] - test.y[LONGEST:])[:, 0] / test.y.std()
    rms = [float(np.sqrt(np.mean(each**2))) for each in (wrong, wrong[:EARLY])]
    return {"error": rms[0], "early": rms[1]}


def measured(system: str, seed: int, samples: int, cell: str) -> dict[str, Any]:
    """Train with each warm-up, and simulate the test record."""
    record, test = drawn(system, seed, samples)
    found: dict[str, Any] = {}
    for warmup in WARMUPS:
        settings = replace(sb.Settings.of(samples), warmup=warmup, quasi_newton=ITERATIONS)
        network = sb.Single(CELLS[cell], settings).fit(record, seed=0)
        for given in {warmup, WARMUPS[0], LONGEST} - ({5} if warmup == 10 else set()):
            found[f"trained {warmup}, given {given}"] = errors(network, test, given, warmup)
    return found


def main() -> None:
    """Measure what is missing, and print the geometric means over systems and seeds."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--systems", nargs="*", default=[*SYSTEMS], choices=[*SYSTEMS])
    parser.add_argument("--seeds", nargs="*", type=int, default=[100])
    parser.add_argument("--samples", type=int, default=600)
    parser.add_argument("--cells", nargs="*", default=[*CELLS], choices=[*CELLS])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/warmup.json"))
    given = parser.parse_args()
    use_one_thread()
    found = json.loads(given.out.read_text()) if given.out.exists() else {}
    for cell in given.cells:
        for seed in given.seeds:
            for system in given.systems:
                key = f"{cell}, {system}, {seed}, {given.samples}"
                if key not in found:
                    found[key] = measured(system, seed, given.samples, cell)
                    write_json(given.out, found)
                    print(key, {k: round(v["error"], 4) for k, v in found[key].items()}, flush=True)
        of_cell = [each for key, each in found.items() if key.startswith(f"{cell},")]
        for case in of_cell[0]:
            means = [np.exp(np.mean([np.log(each[case][what]) for each in of_cell]))
                     for what in ("error", "early")]  # fmt: skip
            print(f"{cell:12} {case:24} {means[0]:.4f}  early {means[1]:.4f}", flush=True)


if __name__ == "__main__":
    main()
