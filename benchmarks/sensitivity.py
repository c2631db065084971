"""What becomes of the results where a constant of the package is halved or doubled.

    python -m benchmarks.sensitivity [--groups linear time ...] [--names _PAST ...]

Development seeds only. A share above one half is moved towards 1 or away from it. A line of OUT has
the constant, in how many of the cases the result changes by more than 1 %, and the geometric mean,
the least and the largest of the new results over the usual ones: the smaller the better. What is
there is not computed again. A docstring that names this program has its evidence here; where even
30 times a constant changes nothing, these records do not decide it, and it stays by eye.
"""

from __future__ import annotations

import argparse
import importlib
import json
import math
import statistics
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import splitband as sb
from benchmarks import clock, driven, kinds, residuals
from benchmarks.commands import PENDULUM
from benchmarks.recommendation import BASELINES, RecordJob, _comparison
from docs.constants import SOURCE, constants
from splitband.filters.cutoff import choose
from splitband.forecasters.held_out import after
from splitband.metrics import rmse

FILE = Path(__file__).parents[1] / "docs/results/benchmarks/constants.jsonl"
FACTORS = 0.5, 2.0
CHANGED = 0.01
"""A result that differs by less than this share of it has not changed."""
SEEDS = 100, 101, 102, 103
Results = dict[str, float]
"""A positive number of each case, for an error, a width or a count: the smaller the better."""


def linear() -> Results:
    """Errors of the linear model's free runs on another record, as shares of the deviation."""
    found: Results = {}
    pairs: list[tuple[str, sb.Record, sb.Record]] = []
    for system, seed in product(driven.SYSTEMS, SEEDS):
        record, test = driven.drawn(system, seed, 400 if seed % 2 else 1000)
        pairs.append((f"{system} {seed}", record, test))
    makes = [*kinds.WITH_INPUTS.items(), ("five inputs", kinds.five_inputs)]
    makes += [("tank", partial(kinds.one_tank, samples=2000)), ("cycle", kinds.tanks_and_cycle)]
    for name, make in makes:
        record = make(np.random.default_rng(SEEDS[0]))
        half = len(record) // 2
        pairs.append((name, record[:half], record[half:]))
    for name, record, test in pairs:
        model = sb.Linear().fit(record)
        y = model.predict(**after(test, 50)).y
        found[name] = rmse(test.y[50:] / test.y.std(axis=0), y / test.y.std(axis=0))
    return found


def time() -> Results:
    """Errors of the functions of time on records without inputs, as shares of the deviation."""
    found = {}
    for kind in kinds.KINDS:
        for seed, (samples, train) in zip(SEEDS, [(1000, 400), (2000, 1000)], strict=False):
            record = kinds.drawn(kind, seed, samples)
            job = RecordJob(kind, kind, lambda: record, train, BASELINES, Path())  # noqa: B023
            for name, run in _comparison(record, job).medians.items():
                error = rmse(record.y[train:], run.ahead)
                found[f"{kind} {seed} {name}"] = error / record.y.std()
    return found


def comparison() -> Results:
    """Errors of the recommended baseline, and the mean score of its 90 % interval (Winkler)."""
    found = {}
    for kind in [*kinds.KINDS, *kinds.WITH_INPUTS]:
        for seed, (samples, train) in zip(SEEDS, [(1000, 400), (2000, 1000)], strict=False):
            record = kinds.drawn(kind, seed, samples)
            job = RecordJob(kind, kind, lambda: record, train, BASELINES, Path())  # noqa: B023
            result = _comparison(record, job)
            trial = result.require_trial()
            left = abs(record.y[train:] - result.medians[trial.recommended].ahead)
            half = trial.intervals[trial.recommended].half_widths(len(left))
            outside = np.maximum(left - half, 0.0)
            found[f"{kind} {seed} error"] = float(np.sqrt(np.mean(left**2)) / record.y.std())
            score = np.mean(2 * half + 2 / 0.1 * outside) / record.y.std()
            found[f"{kind} {seed} interval"] = float(score)
    return found


def bands() -> Results:
    """Cut-offs and down-sampling factors that are chosen; how good they are, this does not say."""
    found = {}
    for kind in kinds.KINDS:
        record = kinds.drawn(kind, SEEDS[0], 1000)
        chosen = choose(record.y, record.sampling_rate, 50)
        found[f"{kind} cut-off"] = chosen.cutoff
        found[f"{kind} down-sampling"] = float(chosen.downsampling)
    return found


def simulators() -> Results:
    """Errors of grey boxes and calibrated simulators on held-out samples."""
    found = {}
    scope: dict[str, Any] = {}
    exec(PENDULUM, scope)
    for seed in SEEDS[:2]:
        record = kinds.pendulum_with_friction(np.random.default_rng(seed))
        ranges = {"stiffness": (1, 100), "damping": (0, 1), "x0_1": (-2, 2)}
        plant = sb.Ode(scope["pendulum"], [0, 0], parameters=ranges)
        model = sb.GreyBox(plant).fit(record[:1000])
        y = model.predict(500, u=record.u[1000:]).y  # type: ignore[index]
        found[f"pendulum {seed}"] = rmse(record.y[1000:], y)
    return found


def networks() -> Results:
    """Errors of short trainings of a state-space network, from the linear model and at random."""
    found = {}
    for system, linear_start in product(driven.SYSTEMS, (True, False)):
        record, test = driven.drawn(system, SEEDS[0], 400)
        steps = 0 if linear_start else 50
        how = sb.TrainingSettings.paper(
            200, 50, steps, 25, lbfgs_iterations=100, linear_start=linear_start
        )
        model = sb.Single(sb.StateSpace(4, 8), how).fit(record)
        y = model.predict(**after(test, 50)).y
        found[f"{system} {'linear' if linear_start else 'random'}"] = rmse(test.y[50:], y)
    return found


def tests() -> Results:
    """Shares of right models that the residual tests reject, and of wrong ones that they accept."""
    found = {}
    for model in residuals.MODELS:
        for noise in ("white", "AR(0.8)"):
            said = [
                bool(residuals.tested(kind, noise, model, seed).dependent)
                for kind in residuals.INPUTS
                for seed in range(3)
            ]
            share = statistics.mean(said)
            found[f"{model} {noise}"] = (share if model == "right" else 1 - share) + 0.01
    return found


def _files(folder: str, *names: str) -> tuple[str, ...]:
    return tuple(f"{folder}/{name}.py" for name in names)


_LINEAR = "delays", "identification", "kalman", "linear", "selection"
_SIMULATORS = "identification", "parameters", "shooting", "calibration"
_COMPARISON = "held_out", "intervals", "prehistory"
GROUPS: dict[str, tuple[Callable[[], Results], tuple[str, ...]]] = {
    "linear": (linear, _files("baselines", *_LINEAR)),
    "time": (time, (*_files("baselines", "seasonal", "sinusoids"), "forecasters/baselines.py")),
    "comparison": (
        comparison,
        (*_files("forecasters", *_COMPARISON), "metrics.py", "comparison/recommendation.py"),
    ),
    "bands": (bands, ("filters/cutoff.py",)),
    "simulators": (simulators, ("forecasters/grey_box.py", *_files("simulators", *_SIMULATORS))),
    "networks": (networks, ("networks/state_space.py",)),
    "tests": (tests, ("checks/residuals.py",)),
}
"""Results of a group, and the files whose constants they depend on."""


@dataclass(frozen=True)
class Moved:
    """Hold a constant and the factor by which it is multiplied; 1 for the results as they are."""

    group: str
    path: str
    name: str
    factor: float

    def results(self) -> Results:
        """Return the results of the group with it."""
        warnings.simplefilter("ignore")
        if self.factor == 1.0:
            return GROUPS[self.group][0]()
        stem = self.path.removesuffix(".py").replace("/", ".")
        before = vars(importlib.import_module(f"splitband.{stem}"))[self.name]
        with_it = [
            module
            for name, module in [*sys.modules.items()]
            if name.startswith("splitband") and vars(module).get(self.name) is before
        ]
        try:
            for module in with_it:
                setattr(module, self.name, moved(before, self.factor))
            return GROUPS[self.group][0]()
        finally:
            for module in with_it:
                setattr(module, self.name, before)


def moved(value: Any, factor: float) -> Any:
    """Return a number, or several, multiplied by a factor; a share above 1/2 keeps below 1."""
    if isinstance(value, tuple):
        return tuple(moved(each, factor) for each in value)
    if isinstance(value, int):
        return max(1, round(value * factor))
    return 1 - (1 - value) / factor if 0.5 < value < 1 else value * factor


def _checked(files: Sequence[str]) -> Iterator[tuple[str, str]]:
    for each in constants():
        path = str(each.path.relative_to(SOURCE))
        if path in files and (each.kind == "by eye" or "benchmarks.sensitivity" in each.said):
            yield from ((path, name) for name in each.names)


def main() -> None:
    """Compute what is missing, one constant after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--groups", nargs="+", default=[*GROUPS], choices=[*GROUPS])
    parser.add_argument("--names", nargs="+", help="only these constants")
    parser.add_argument("--out", type=Path, default=FILE)
    given = parser.parse_args()
    there = {(row["path"], row["name"], row["factor"]) for row in clock.read(given.out)}
    for group in given.groups:
        every = [
            Moved(group, path, name, factor)
            for path, name in _checked(GROUPS[group][1])
            for factor in FACTORS
            if given.names is None or name in given.names
        ]
        missing = [each for each in every if (each.path, each.name, each.factor) not in there]
        usual = Moved(group, "", "", 1.0).results() if missing else {}
        for each in missing:
            row = vars(each) | summary(each.results(), usual)
            with given.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(row, flush=True)


def summary(results: Results, usual: Results) -> dict[str, float]:
    """Return how results compare with the usual ones; a missing one is infinite."""
    ratios = [
        max(results.get(case, math.inf), 1e-12) / max(value, 1e-12) for case, value in usual.items()
    ]
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    return {
        "cases": len(ratios),
        "changed": sum(abs(ratio - 1) > CHANGED for ratio in ratios),
        "mean": round(statistics.geometric_mean(finite), 4),
        "least": round(min(ratios), 4),
        "most": round(max(ratios), 4),
    }


if __name__ == "__main__":
    main()
