"""State-space networks that start from the linear model, and ones from random weights.

    python -m benchmarks.starts [--systems ...] [--seeds 100 101] [--parts FOLDER]

On long driven records (`benchmarks.driven`) two of each are trained on three quarters, and simulate
test records whose inputs are as large as those of training, or larger. Writes
docs/benchmarks/starts.json: the errors as shares of the deviation, of each alone and of means of
two. Is the linear model to be preferred, where held-out errors differ little? Records are kept in
FOLDER.
"""

from __future__ import annotations

import json
import statistics
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

import splitband as sb
from benchmarks.driven import drawn, over_records
from splitband.evaluation.candidates import FIRST_STEPS, FREE_RUN
from splitband.runtime.files import write_json
from splitband.training import Settings

Array = npt.NDArray[np.float64]
PARTS = Path(tempfile.gettempdir()) / "splitband-starts"
SAMPLES, TESTED, WARMUP, ITERATIONS = 10_000, 3000, 50, 3200
AMPLITUDES = 1.0, 1.5, 2.0
HELD_OUT = "held-out part"
PARTS_OF = HELD_OUT, *(f"inputs {amplitude} times as large" for amplitude in AMPLITUDES)
MEANS = {
    "linear model": [("linear", 0), ("linear", 1)],
    "random weights": [("random", 0), ("random", 1)],
    "one of each": [("linear", 0), ("random", 0)],
}


def settings() -> dict[str, Settings]:
    """Return how networks are trained, by their start: the first candidates of a search."""
    usual = Settings.of(SAMPLES)
    window = min(usual.warmup + FREE_RUN, usual.window)
    linear = replace(usual, window=window, epochs=0, quasi_newton=ITERATIONS)
    epochs = max(1, round(FIRST_STEPS / linear.batches_of(SAMPLES)))
    return {"linear": linear, "random": replace(linear, epochs=epochs, linear_start=False)}


def measured(name: str, seed: int) -> dict[str, dict[str, float]]:
    """Train networks for a record; return their errors by what is simulated, and by the start."""
    record, *tests = drawn(name, seed, SAMPLES, TESTED, AMPLITUDES)
    fitted = 3 * SAMPLES // 4
    parts = [(record, fitted, False), *((test, WARMUP, True) for test in tests)]
    simulated = {}
    for start, how in settings().items():
        for number in range(2):
            model = sb.Single(sb.StateSpace(4, 10), settings=how).fit(record[:fitted], seed=number)
            simulated[start, number] = [_ahead(model, *part) for part in parts]
    found: dict[str, dict[str, float]] = {}
    for i, (label, (part, begin, _)) in enumerate(zip(PARTS_OF, parts, strict=True)):
        truth, scale = part.seen[begin:], part.seen.std()
        alone = {key: _rmse([of[i]], truth) / scale for key, of in simulated.items()}
        found[label] = {
            f"{start}, alone": statistics.geometric_mean(
                max(error, 1e-12) for key, error in alone.items() if key[0] == start
            )
            for start in ("linear", "random")
        } | {
            mean: _rmse([simulated[key][i] for key in of], truth) / scale
            for mean, of in MEANS.items()
        }
    return found


def _ahead(model: sb.Forecaster, record: sb.Record, begin: int, other: bool) -> Array:
    assert record.u is not None
    past, u, steps = record[:begin], record.u[begin:], len(record) - begin
    y = model.predict(steps, history=past, u=u, other_record=other).y
    return np.asarray(y).reshape(steps, -1)


def _rmse(simulations: list[Array], truth: Array) -> float:
    return float(np.sqrt(np.mean((np.mean(simulations, axis=0) - truth) ** 2)))


def kept(name: str, seed: int, path: Path) -> dict[str, dict[str, float]]:
    """Return the errors of a record, from a file where there is one."""
    file = path.with_suffix(".json")
    if not file.exists():
        write_json(file, measured(name, seed))
    errors: dict[str, dict[str, float]] = json.loads(file.read_text(encoding="utf-8"))
    return errors


def main() -> None:
    """Measure what is not there yet, and print geometric means over the records."""
    records, out = over_records(__doc__, PARTS, Path("docs/benchmarks/starts.json"), kept)
    means = {
        part: {
            way: statistics.geometric_mean(of[part][way] for of in records.values())
            for way in next(iter(records.values()))[part]
        }
        for part in PARTS_OF
    }
    facts = {"samples": SAMPLES, "count": len(records), "means": means, "records": records}
    write_json(out, facts)
    print(json.dumps(means, indent=1))


if __name__ == "__main__":
    main()
