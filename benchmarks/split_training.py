"""What the warm-up of a split model's training windows is best cut from: development records.

    python -m benchmarks.split_training [--out docs/benchmarks] [--seeds 3]

Each split method is trained on three quarters of a training part by the default recipe, and
forecasts the rest of it from three origins; no later sample is looked at. Once with warm-ups that
are filtered alone, once with windows of the filtered record (paper, Eq. 10, training).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.comparing import held_out
from benchmarks.driven import drawn
from reproduction.systems import double_torsion_pendulum
from splitband.data import Record, double_torsion
from splitband.data.named import double_mass_spring
from splitband.evaluation.setup import Options
from splitband.forecasters.backtest import (
    Question,
    backtest,
    held_out_errors,
    held_out_origins,
    root_mean_square,
)
from splitband.metrics import spread
from splitband.runtime.files import write_json


def _driven(name: str) -> Record:
    return drawn(name, 100, 1001)[0]


RECORDS: dict[str, tuple[Callable[[], Record], int]] = {
    **{f"i, draw {d}": (partial(double_mass_spring, seed=d), 250) for d in (100, 101, 102)},
    "double-torsion record": (double_torsion, 600),
    **{
        f"pendulum {row}": (partial(double_torsion_pendulum, row, seed=100), 600)
        for row in ("ii", "iii", "iv")
    },
    **{
        f"{name}, driven": (partial(_driven, name), 1000)
        for name in ("Wiener-Hammerstein", "tank that overflows", "Duffing", "motor")
    },
}
Found = dict[str, dict[str, dict[str, list[float]]]]
METHODS = ("split-gru", "split-gru-hp", "split-gru-conditioned")


def main() -> None:
    """Train both forms and say how they do, in deviations of the record."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    file = arguments.out / "split_training.json"
    found: Found = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for name, (record, train) in RECORDS.items():
        if name in found:
            continue
        whole = record()
        part, setup = held_out(whole, Options().decided(whole, train))
        for method in METHODS:
            for own in (True, False):
                errors = []
                for seed in range(arguments.seeds):
                    one = setup.forecaster(method).clone().set_params(own_warmup=own)
                    question = Question(part, held_out_origins(one, part), len(part))
                    done = backtest(one, question, seed)
                    of = {origin: p.y for origin, p in done.predictions.items()}
                    scale = spread(part.y)
                    errors.append(root_mean_square([e / scale for e in held_out_errors(part, of)]))
                label = "own warm-up" if own else "Eq. 10"
                found.setdefault(name, {}).setdefault(method, {})[label] = errors
                print(name, method, label, [f"{e:.3f}" for e in errors], flush=True)
        write_json(file, found)


if __name__ == "__main__":
    main()
