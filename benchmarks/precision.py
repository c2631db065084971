"""Trainings that end where float32 settles, and ones that go on in float64.

    python -m benchmarks.precision [--systems ...] [--seeds 100 101] [--parts FOLDER]

On long driven records (`benchmarks.driven`) a state-space network is trained by as many iterations
of L-BFGS as the last round of a search allows, and simulates test records whose inputs are as large
as those of training, or larger. Writes docs/benchmarks/precision.json: the errors as shares of the
deviation, and their geometric means over the records where float32 settles.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import splitband as sb
from benchmarks.driven import drawn, kept, over_records
from benchmarks.starts import AMPLITUDES, SAMPLES, TESTED, WARMUP, ahead, rmse, settings
from splitband.evaluation.candidates import LADDER
from splitband.runtime.files import write_json
from splitband.training.network import NetworkTraining
from splitband.training.settings import ROUND

PARTS = Path(tempfile.gettempdir()) / "splitband-precision"
MOST_ROUNDS = LADDER[-1] // ROUND
SETTLING, GOING_ON = "float32", "float32, then float64"


def measured(name: str, seed: int) -> dict[str, Any]:
    """Train a network for a record in both ways; return iterations, CPU time and test errors."""
    record, *tests = drawn(name, seed, SAMPLES, TESTED, AMPLITUDES)
    how = replace(settings()["linear"], quasi_newton=LADDER[-1])
    found: dict[str, Any] = {}
    for label in (SETTLING, GOING_ON):
        began = time.process_time()
        if label == SETTLING:
            with mock.patch.object(NetworkTraining, "_go_on_in_float64"):
                model = sb.Single(sb.StateSpace(4, 10), settings=how).fit(record)
        else:
            model = sb.Single(sb.StateSpace(4, 10), settings=how).fit(record)
        losses = model.require_fitted().report.losses["network"]
        found[label] = {
            "cpu_seconds": time.process_time() - began,
            "rounds": len(losses),
            "loss": losses[-1],
            "errors": [
                rmse([ahead(model, test, WARMUP, True)], test.y[WARMUP:]) / test.y.std()
                for test in tests
            ],
        }
    return found


def main() -> None:
    """Measure what is not there yet, and print geometric means over the records."""
    records, out = over_records(
        __doc__, PARTS, Path("docs/benchmarks/precision.json"), kept(measured)
    )
    settled = {name: of for name, of in records.items() if of[SETTLING]["rounds"] < MOST_ROUNDS}
    means = {
        label: {
            f"inputs {amplitude} times as large": statistics.geometric_mean(
                of[label]["errors"][i] for of in settled.values()
            )
            for i, amplitude in enumerate(AMPLITUDES)
        }
        for label in (SETTLING, GOING_ON)
    }
    facts = {
        "samples": SAMPLES,
        "iterations": LADDER[-1],
        "count": len(records),
        "settled": len(settled),
        "means": means,
        "records": records,
    }
    write_json(out, facts)
    print(json.dumps({"settled": [*settled], "means": means}, indent=1))


if __name__ == "__main__":
    main()
