"""What the mean of more seeds is worth, on held-out training samples.

    python -m benchmarks.seeds [--most 32] [--out FILE.json]

GRUs of 16 units, trained as the search of `compare` trains its first candidates, on the first three
quarters of a training part; of the mean of each 1, 2, 4, ... of their forecasts the error on the
rest. The records are development records, and of the cascaded tanks the training file.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import replace
from pathlib import Path

import numpy as np

import splitband as sb
from benchmarks import inputs, sets
from benchmarks.inputs import TRAINING
from splitband.evaluation.candidates import FIRST_STEPS, LADDER
from splitband.evaluation.trials import held_out_score
from splitband.forecasters.backtest import Question, backtest, for_trial, held_out_origins
from splitband.runtime.files import write_json

UNITS = 16
SEED = 150  # of the records


def scores(record: sb.Record, most: int) -> dict[str, float]:
    """By the number of seeds: the held-out error of their mean, on average over disjoint sets."""
    usual = sb.Settings.of(len(record))
    epochs = max(1, round(FIRST_STEPS / usual.batches_of(len(record))))
    settings = replace(usual, epochs=epochs, quasi_newton=LADDER[0])
    network = for_trial(sb.Single(sb.GRU(UNITS), settings), len(record))
    question = Question(record, held_out_origins(network, record), len(record))
    done = [backtest(network, question, seed) for seed in range(most)]
    counts = [2**i for i in range(most.bit_length()) if 2**i <= most]
    return {
        str(n): statistics.mean(
            held_out_score(record, done[i : i + n]) for i in range(0, most - n + 1, n)
        )
        for n in counts
    }


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--most", type=int, default=32)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/seeds.json"))
    arguments = parser.parse_args()
    records = {
        "cascaded tanks": sets.load(sets.SETS["tanks"].training),
        "duffing": inputs.duffing(np.random.default_rng(SEED))[:TRAINING],
        "two tanks": inputs.tanks(np.random.default_rng(SEED))[:TRAINING],
    }
    found = {}
    for name, record in records.items():
        found[name] = scores(record, arguments.most)
        print(name, {n: round(score, 4) for n, score in found[name].items()}, flush=True)
    write_json(arguments.out, {"units": UNITS, "held-out error by seeds": found})


if __name__ == "__main__":
    main()
