"""State-space networks that begin as the linear model, and such that begin with random weights.

    python -m benchmarks.starts [--systems ...] [--seeds 100 101] [--parts FOLDER]

On long driven records (`benchmarks.driven`) two of each are trained on three quarters, and simulate
test records whose inputs are as large as those of training, or larger. Writes
docs/benchmarks/starts.json: the errors as shares of the deviation, of each alone and of means of
two. Is the linear model to be preferred, where held-out errors differ little? Records are kept in
FOLDER.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

import splitband as sb
from benchmarks.driven import SYSTEMS, drawn
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
    """How networks are trained, by what they begin as: the first candidates of a search."""
    usual = Settings.of(SAMPLES)
    window = min(usual.warmup + FREE_RUN, usual.window)
    linear = replace(usual, window=window, epochs=0, quasi_newton=ITERATIONS)
    epochs = max(1, round(FIRST_STEPS / linear.batches_of(SAMPLES)))
    return {"linear": linear, "random": replace(linear, epochs=epochs, linear_start=False)}


def measured(name: str, seed: int) -> dict[str, dict[str, float]]:
    """The errors of one record: by what is simulated, of each beginning."""
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


def main() -> None:
    """Measure what is not there yet, and print geometric means over the records."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--systems", nargs="*", default=[*SYSTEMS], choices=[*SYSTEMS])
    parser.add_argument("--seeds", nargs="*", type=int, default=[100, 101])
    parser.add_argument("--parts", type=Path, default=PARTS)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/starts.json"))
    given = parser.parse_args()
    given.parts.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", sb.ExtrapolationWarning)
    records = {}
    for seed in given.seeds:
        for name in given.systems:
            path = given.parts / f"{name}-{seed}.json"
            if not path.exists():
                write_json(path, measured(name, seed))
            records[f"{name}, seed {seed}"] = found = json.loads(path.read_text())
            print(path.stem, found, flush=True)
    means = {
        part: {
            way: statistics.geometric_mean(of[part][way] for of in records.values())
            for way in next(iter(records.values()))[part]
        }
        for part in PARTS_OF
    }
    facts = {"samples": SAMPLES, "count": len(records), "means": means, "records": records}
    write_json(given.out, facts)
    print(json.dumps(means, indent=1))


if __name__ == "__main__":
    main()
