"""How long the final training of a short record is: as many iterations as the trial, or fewer.

    python -m benchmarks.finals [--seeds 100 101 102]

Of each driven system, a GRU and a state-space network are trained by 100 iterations of L-BFGS on
300 of 400 samples, and go on on all of them for 25, 100 and 300; others are trained anew. Errors
are those of the median of three trainings on the test record, as shares of its deviation; the last
lines are geometric means of their ratios to those of 25, an error above 2 counting as 2.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

import splitband as sb
from benchmarks.driven import SYSTEMS, drawn
from splitband.runtime.threads import use_one_thread

TRIAL, WINDOW, MOST = 100, 200, 2.0
GOING_ON, ANEW = (25, 100, 300), (100, 300)


def errors(system: str, seed: int, cell: Any, epochs: int) -> dict[str, float]:
    """Return the error of each way to end the training."""
    record, test = drawn(system, seed, 400)
    usual = sb.Settings(WINDOW, 50, epochs, 25, quasi_newton=TRIAL)
    said: dict[str, list[Any]] = {}

    def keep(name: str, model: sb.Forecaster) -> None:
        y = model.predict(len(test) - 50, history=test[:50]).y
        said.setdefault(name, []).append(y)

    for training in range(3):
        network = sb.Single(cell, replace(usual, window=3 * WINDOW // 4))
        trial = network.fit(record[:300], seed=training)
        keep("trial", trial)
        for more in GOING_ON:
            settings = replace(usual, epochs=0, quasi_newton=more)
            keep(f"{more} more", sb.Single(cell, settings).fit(record, seed=training, start=trial))
        for most in ANEW:
            settings = replace(usual, quasi_newton=most)
            keep(f"{most} anew", sb.Single(cell, settings).fit(record, seed=training))
    left = {name: np.median(of, axis=0) - test.y[50:] for name, of in said.items()}
    return {name: float(np.sqrt(np.mean(e**2)) / test.y.std()) for name, e in left.items()}


def main() -> None:
    """Print the errors, and their means."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", nargs="+", type=int, default=[100, 101, 102])
    seeds = parser.parse_args().seeds
    use_one_thread()
    warnings.simplefilter("ignore")
    networks = {"gru": (sb.GRU(16), 12), "state-space": (sb.StateSpace(4, 10), 0)}
    ratios: dict[str, list[float]] = {}
    for seed, system, name in product(seeds, SYSTEMS, networks):
        found = errors(system, seed, *networks[name])
        print(system, seed, name, {what: round(error, 4) for what, error in found.items()})
        for what, error in found.items():
            ratios.setdefault(what, []).append(min(error, MOST) / min(found["25 more"], MOST))
    for what, of in ratios.items():
        print(f"{what}: {statistics.geometric_mean(of):.2f}, {len(of)} pairs")


if __name__ == "__main__":
    main()
