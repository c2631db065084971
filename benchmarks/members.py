"""Whose median is handed out: as many of the best trainings as have the best median.

    python -m benchmarks.members [--systems ...] [--seeds 100 101 102 103] [--parts FOLDER]

Networks of several settings, two seeds each, are trained on three quarters of a short record and
scored on the rest, as the search does; all go on on the whole of it. State-space networks simulate
the test record of a driven system (`benchmarks.driven`), GRUs forecast a record without inputs
(`benchmarks.kinds`). Writes docs/benchmarks/members.json: errors as shares of the deviation, by
what is handed out. Trainings are kept in FOLDER.
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

import splitband as sb
from benchmarks import kinds
from benchmarks.driven import SYSTEMS, drawn
from benchmarks.plain import Facts
from splitband.evaluation.search import LEAST_MEMBERS, MOST_MEMBERS
from splitband.runtime.files import write_json
from splitband.training import Settings

Array = npt.NDArray[np.float64]
Combine = Callable[..., Array]
PARTS = Path(tempfile.gettempdir()) / "splitband-members"
SAMPLES, FITTED, AHEAD, SEEDS, WARMUP = 400, 300, 200, 2, 50
TRIED, TRIED_GRU = 400, 100
"""Iterations of L-BFGS in the trial. The training that goes on from it has a quarter more."""
WITHOUT_INPUTS = ", no inputs"
UNDRIVEN = (
    "Duffing", "Lorenz", "Mackey-Glass", "beating", "five tones", "square wave",
    "resonance driven by noise",
)  # fmt: skip


def driven_ways() -> dict[str, sb.Single]:
    """Return the networks of driven systems, by what they are called."""
    usual = Settings.of(SAMPLES)
    window = min(usual.warmup + 150, usual.window)
    base = replace(usual, window=window, epochs=0, quasi_newton=TRIED, penalty=1e-4)
    small = sb.StateSpace(4, 10)
    found = {
        "no penalty": (small, replace(base, penalty=0.0)),
        "penalty 1e-4": (small, base),
        "penalty 1e-3": (small, replace(base, penalty=1e-3)),
        "whole record": (small, replace(base, window=FITTED)),
        "2 states": (sb.StateSpace(2, 10), base),
        "6 states": (sb.StateSpace(6, 15), base),
        "20 units": (sb.StateSpace(4, 20), base),
        "random weights": (small, replace(base, epochs=_adam(base), linear_start=False)),
    }
    return {way: sb.Single(cell, settings=how) for way, (cell, how) in found.items()}


def undriven_ways() -> dict[str, sb.Single]:
    """Return the networks of records without inputs, by what they are called."""
    usual = Settings.of(SAMPLES)
    base = replace(usual, epochs=_adam(usual), quasi_newton=TRIED_GRU)
    short, shortest = (replace(base, window=usual.warmup + free) for free in (100, 50))
    found = {
        "longest windows": (16, replace(base, window=min(base.window, FITTED))),
        "100 samples": (16, short),
        "32 units": (32, short),
        "50 samples": (16, shortest),
        "penalty": (16, replace(short, penalty=1e-4)),
    }
    return {way: sb.Single(sb.GRU(units), settings=how) for way, (units, how) in found.items()}


def _adam(settings: Settings) -> int:
    return max(1, round(300 / settings.batches_of(SAMPLES)))


def trained(name: str, seed: int) -> dict[str, Array]:
    """Train every way with every seed; return forecasts of the held-out and of the test samples."""
    kind = name.removesuffix(WITHOUT_INPUTS)
    if kind == name:
        record, test = drawn(name, seed, SAMPLES)
        train, truth, ways = record, test.y[WARMUP:], driven_ways()
    else:
        record = kinds.drawn(kind, seed, SAMPLES + AHEAD)
        train, truth, ways = record[:SAMPLES], record.y_with_gaps[SAMPLES:], undriven_ways()

    def simulated(model: sb.Forecaster) -> Array:
        if kind != name:
            return model.predict(AHEAD).y
        past, u = test[:WARMUP], test.u
        assert u is not None
        return model.predict(len(truth), history=past, u=u[WARMUP:], other_record=True).y

    origins = [FITTED + i * (SAMPLES - FITTED) // 3 for i in range(3)]
    found = {
        "held": np.concatenate([train.y_with_gaps[o:].ravel() for o in origins]),
        "test": truth.ravel(),
        "scale": np.array([train.y_with_gaps.std(), truth.std()]),
    }
    for way, network in ways.items():
        for s in range(SEEDS):
            tried = network.clone().fit(train[:FITTED], seed=s)
            ahead = [_forecast(tried, train, o).ravel() for o in origins]
            last = _longer(network).fit(train, seed=s, start=tried)
            stable = last.require_fitted().report.stable
            found[f"held|{way}|{s}"] = np.concatenate(ahead)
            found[f"test|{way}|{s}"] = simulated(last).ravel()
            found[f"stable|{way}|{s}"] = np.array(stable)
    return found


def _forecast(model: sb.Forecaster, record: sb.Record, begin: int) -> Array:
    u = None if record.u is None else record.u[begin:]
    return np.asarray(model.predict(SAMPLES - begin, history=record[:begin], u=u).y)


def _longer(network: sb.Single) -> sb.Forecaster:
    """Return the network set to go on from the trial's weights, on all samples."""
    settings = network.settings
    assert settings is not None
    assert settings.quasi_newton is not None
    iterations, window = round(1.25 * settings.quasi_newton), settings.window
    window = SAMPLES if window == FITTED else window
    return network._trained_as(replace(settings, quasi_newton=iterations, window=window))


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
    firsts = [ranked[:n] for n in range(1, len(ranked) + 1)]
    handed_out = {"the best training": error("test", ranked[:1], np.mean)}
    least = min(LEAST_MEMBERS, len(ranked))
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
                f"at least three of the best, as many as have the best {name}": min(
                    firsts[least - 1 :], key=held_out
                ),
            }.items()
        }
    return handed_out


def main() -> None:
    """Train what is not there yet, and print the geometric means over the records."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    systems = [*SYSTEMS, *(kind + WITHOUT_INPUTS for kind in UNDRIVEN)]
    parser.add_argument("--systems", nargs="*", default=systems, choices=systems)
    parser.add_argument("--seeds", nargs="*", type=int, default=[100, 101])
    parser.add_argument("--parts", type=Path, default=PARTS)
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/members.json"))
    given = parser.parse_args()
    given.parts.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", sb.ExtrapolationWarning)
    records: dict[str, dict[str, float]] = {}
    for seed, name in itertools.product(given.seeds, given.systems):
        kept = given.parts / f"{name}-{seed}.npz"
        if not kept.exists():
            np.savez(kept, **trained(name, seed))  # type: ignore[arg-type]
        with np.load(kept) as file:
            records[f"{name}, seed {seed}"] = errors(dict(file))
        print(name, seed, flush=True)
    facts: Facts = {"samples": SAMPLES, "records": records}
    for part, undriven in (("driven", False), ("undriven", True)):
        every = [of for name, of in records.items() if (WITHOUT_INPUTS in name) == undriven]
        means = {way: statistics.geometric_mean(of[way] for of in every) for way in every[0]}
        facts[part] = {"count": len(every), "means": means}
        print(part, json.dumps(means, indent=1))
    write_json(given.out, facts)


if __name__ == "__main__":
    main()
