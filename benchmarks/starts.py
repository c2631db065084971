"""State-space networks that start from the linear model, and ones from random weights.

    python -m benchmarks.starts [--systems ...] [--seeds 100 101] [--parts FOLDER]

On long driven records (`benchmarks.driven`) two of each are trained on three quarters, and simulate
test records whose inputs are as large as those of training, or larger. Writes
docs/benchmarks/starts.json: the errors as shares of the deviation, of every mean of these four,
and of the means that three rules choose by the errors on the held-out part (`RULES`). Records are
kept in FOLDER.
"""

from __future__ import annotations

import itertools
import json
import statistics
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

import splitband as sb
from benchmarks.driven import drawn, kept, over_records
from splitband.evaluation.candidates import FIRST_STEPS, FREE_RUN_FROM_LINEAR
from splitband.runtime.files import write_json
from splitband.training import Settings

Array = npt.NDArray[np.float64]
PARTS = Path(tempfile.gettempdir()) / "splitband-starts"
SAMPLES, TESTED, WARMUP, ITERATIONS = 10_000, 3000, 50, 3200
FAILED = 2.0
"""Multiple of the lowest held-out error."""
MOST = 10.0
"""Largest error, as a share of the deviation: one that is larger counts as this one."""
AMPLITUDES = 1.0, 1.5, 2.0
HELD_OUT = "held-out part"
PARTS_OF = HELD_OUT, *(f"inputs {amplitude} times as large" for amplitude in AMPLITUDES)
Errors = dict[str, dict[str, float]]
"""By what is simulated, and by the trainings of the mean."""


def settings() -> dict[str, Settings]:
    """Return how networks are trained, by their start: the first candidates of a search."""
    usual = Settings.of(SAMPLES)
    window = min(usual.warmup + FREE_RUN_FROM_LINEAR, usual.window)
    linear = replace(usual, window=window, epochs=0, quasi_newton=ITERATIONS)
    epochs = max(1, round(FIRST_STEPS / linear.batches_of(SAMPLES)))
    return {"linear": linear, "random": replace(linear, epochs=epochs, linear_start=False)}


def measured(name: str, seed: int) -> Errors:
    """Train networks for a record; return the errors of all their means, by what is simulated."""
    record, *tests = drawn(name, seed, SAMPLES, TESTED, AMPLITUDES)
    fitted = 3 * SAMPLES // 4
    parts = [(record, fitted, False), *((test, WARMUP, True) for test in tests)]
    simulated = {}
    for start, how in settings().items():
        for number in range(2):
            model = sb.Single(sb.StateSpace(4, 10), settings=how).fit(record[:fitted], seed=number)
            simulated[f"{start} {number}"] = [ahead(model, *part) for part in parts]
    every = [of for n in range(len(simulated)) for of in itertools.combinations(simulated, n + 1)]
    found: Errors = {}
    for i, (label, (part, begin, _)) in enumerate(zip(PARTS_OF, parts, strict=True)):
        truth = part.seen[begin:]
        found[label] = {
            ", ".join(of): rmse([simulated[each][i] for each in of], truth) / part.seen.std()
            for of in every
        }
    return found


def ahead(model: sb.Forecaster, record: sb.Record, begin: int, other: bool) -> Array:
    """Simulate a record after its first samples, `(time, ny)`."""
    assert record.u is not None
    past, u, steps = record[:begin], record.u[begin:], len(record) - begin
    y = model.predict(steps, history=past, u=u, other_record=other).y
    return np.asarray(y).reshape(steps, -1)


def rmse(simulations: list[Array], truth: Array) -> float:
    """Return the error of the simulations' mean."""
    return float(np.sqrt(np.mean((np.mean(simulations, axis=0) - truth) ** 2)))


def prefix(held_out: Mapping[str, float]) -> str:
    """Return the n best trainings, whose mean has the lowest error of all n."""
    ranked = _ranked(held_out)
    means = [", ".join(sorted(ranked[: n + 1])) for n in range(len(ranked))]
    return min(means, key=held_out.__getitem__)


def one_of_each(held_out: Mapping[str, float]) -> str:
    """Return the best training of each start, if it is within `FAILED` times the lowest error."""
    ranked = _able(held_out)
    best = {each.split()[0]: each for each in reversed(ranked)}
    return ", ".join(sorted(best.values()))


def every(held_out: Mapping[str, float]) -> str:
    """Return all trainings that are within `FAILED` times the lowest error."""
    return ", ".join(sorted(_able(held_out)))


RULES: dict[str, Callable[[Mapping[str, float]], str]] = {
    "the lowest held-out error": prefix,
    "the best of each start": one_of_each,
    "all": every,
    "linear model": lambda held_out: "linear 0, linear 1",
    "random weights": lambda held_out: "random 0, random 1",
}


def _ranked(held_out: Mapping[str, float]) -> list[str]:
    return sorted((each for each in held_out if "," not in each), key=held_out.__getitem__)


def _able(held_out: Mapping[str, float]) -> list[str]:
    ranked = _ranked(held_out)
    return [each for each in ranked if held_out[each] <= FAILED * held_out[ranked[0]]]


def main() -> None:
    """Measure what is not there yet, and print geometric means over the records."""
    records, out = over_records(__doc__, PARTS, Path("docs/benchmarks/starts.json"), kept(measured))
    means = {
        part: {
            rule: statistics.geometric_mean(
                min(of[part][choose(of[HELD_OUT])], MOST) for of in records.values()
            )
            for rule, choose in RULES.items()
        }
        for part in PARTS_OF
    }
    facts = {"samples": SAMPLES, "count": len(records), "means": means, "records": records}
    write_json(out, facts)
    print(json.dumps(means, indent=1))


if __name__ == "__main__":
    main()
