"""Whose median is handed out: as many of the best trainings as have the best median.

    python -m benchmarks.members [--systems ...] [--seeds 100 101 102] [--parts FOLDER]

State-space networks of eight settings, two seeds each, are trained on three quarters of a short
driven record (`benchmarks.driven`) and scored on the rest, as the search does; all go on on the
whole of it and simulate the test record. Writes docs/benchmarks/members.json: errors there as
shares of its deviation, by what is handed out. Trainings are kept in FOLDER.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

import splitband as sb
from benchmarks.driven import drawn, over_records
from splitband.evaluation.trials import MOST_MEMBERS
from splitband.forecasters.initialisation import Earlier
from splitband.runtime.files import write_json
from splitband.training import Settings

Array = npt.NDArray[np.float64]
Combine = Callable[..., Array]
PARTS = Path(tempfile.gettempdir()) / "splitband-members"
SAMPLES, SEEDS, WARMUP = 400, 2, 50
TRIED, LAST = 400, 500
"""Iterations of L-BFGS in the trial, and after the training that goes on from it."""


def ways(samples: int) -> dict[str, tuple[sb.StateSpace, Settings]]:
    """Return the settings, by what they are called."""
    usual = Settings.of(samples)
    window = min(usual.warmup + 150, usual.window)
    base = replace(usual, window=window, epochs=0, quasi_newton=TRIED, penalty=1e-4)
    adam = max(1, round(300 / base.batches_of(samples)))
    small = sb.StateSpace(4, 10)
    return {
        "no penalty": (small, replace(base, penalty=0.0)),
        "penalty 1e-4": (small, base),
        "penalty 1e-3": (small, replace(base, penalty=1e-3)),
        "whole record": (small, replace(base, window=3 * samples // 4)),
        "2 states": (sb.StateSpace(2, 10), base),
        "6 states": (sb.StateSpace(6, 15), base),
        "20 units": (sb.StateSpace(4, 20), base),
        "random weights": (small, replace(base, epochs=adam, linear_start=False)),
    }


def trained(name: str, seed: int) -> dict[str, Array]:
    """Train every way with every seed; return forecasts of the held-out and of the test samples."""
    record, test = drawn(name, seed, SAMPLES)
    fitted = 3 * SAMPLES // 4
    origins = [fitted + i * (SAMPLES - fitted) // 3 for i in range(3)]
    assert record.u is not None
    assert test.u is not None
    found = {
        "held": np.concatenate([record.seen[o:].ravel() for o in origins]),
        "test": test.y.ravel()[WARMUP:],
        "scale": np.array([record.seen.std(), test.y.std()]),
    }
    for way, (cell, settings) in ways(SAMPLES).items():
        for s in range(SEEDS):
            tried = sb.Single(cell, settings=settings).fit(record[:fitted], seed=s)
            ahead = [
                tried.predict(SAMPLES - o, history=record[:o], u=record.u[o:]).y for o in origins
            ]
            window = SAMPLES if way == "whole record" else settings.window
            more = replace(settings, quasi_newton=LAST, window=window)
            last = sb.Single(cell, settings=more).continued(Earlier(TRIED, {s: tried.state()}))
            last.fit(record, seed=s)
            stable = last.require_fitted().report.stable
            y = last.predict(
                len(test) - WARMUP, history=test[:WARMUP], u=test.u[WARMUP:], other_record=True
            ).y
            found[f"held|{way}|{s}"] = np.concatenate([each.ravel() for each in ahead])
            found[f"test|{way}|{s}"], found[f"stable|{way}|{s}"] = y.ravel(), np.array(stable)
    return found


def errors(found: dict[str, Array]) -> dict[str, float]:
    """Return the test errors by what is handed out."""
    runs = [tuple(key.split("|")[1:]) for key in found if key.startswith("test|")]
    # As in use: what is unstable is left out, unless everything is.
    every = [run for run in runs if found["|".join(["stable", *run])]] or runs

    def error(part: str, runs: list[tuple[str, ...]], way: Combine) -> float:
        y = way([found["|".join([part, *run])] for run in runs], axis=0)
        scale = found["scale"][0 if part == "held" else 1]
        return float(np.sqrt(np.mean((y - found[part]) ** 2)) / scale)

    def alone(run: tuple[str, ...]) -> float:
        return error("held", [run], np.mean)

    by_way = [[run for run in every if run[0] == way] for way in {way: None for way, _ in every}]
    ranked = sorted(every, key=alone)[:MOST_MEMBERS]
    firsts = [ranked[: i + 1] for i in range(len(ranked))]
    handed_out = {"the best training": error("test", ranked[:1], np.mean)}
    for name, way in (("mean", np.mean), ("median", np.median)):
        held_out = partial(error, "held", way=way)
        handed_out |= {
            f"the {name} of {those}": error("test", of, way)
            for those, of in {
                "the seeds of the best setting": min(by_way, key=held_out),
                "the best eight": ranked,
                "the best eight within twice the lowest error": [
                    run for run in ranked if alone(run) <= 2 * alone(ranked[0])
                ],
                f"as many of the best as have the best {name}": min(firsts, key=held_out),
            }.items()
        }
    return handed_out


def measured(name: str, seed: int, path: Path) -> dict[str, float]:
    """Return the errors on a record, whose forecasts are kept."""
    kept = path.with_suffix(".npz")
    if not kept.exists():
        np.savez(kept, **trained(name, seed))  # type: ignore[arg-type]
    with np.load(kept) as file:
        return errors(dict(file))


def main() -> None:
    """Train what is not there yet, and print the geometric means over the records."""
    records, out = over_records(__doc__, PARTS, Path("docs/benchmarks/members.json"), measured)
    means = {
        kind: statistics.geometric_mean(of[kind] for of in records.values())
        for kind in next(iter(records.values()))
    }
    facts = {"samples": SAMPLES, "count": len(records), "means": means, "records": records}
    write_json(out, facts)
    for kind, mean in means.items():
        print(f"{kind}: {mean:.4f}")


if __name__ == "__main__":
    main()
