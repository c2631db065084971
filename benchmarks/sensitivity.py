"""What becomes of the results where a constant of the package is halved or doubled.

    python -m benchmarks.sensitivity [--groups linear time ...] [--jobs 2] [--names _PAST ...]

Development seeds only. A constant that changes no result in either direction needs no better value;
one that never decides anything should go. A share above one half is moved towards 1 or away from
it. Figures are appended to docs/benchmarks/constants.jsonl as they come, and what is there is not
computed again; the table of docs/tables/constants.md is made of them.
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
from benchmarks import driven, kinds, residuals
from benchmarks.commands import PENDULUM
from benchmarks.recommendation import BASELINES, RecordJob, _comparison
from docs.constants import SOURCE, Constant, constants
from splitband.filters.cutoff import choose
from splitband.metrics import rmse
from splitband.runtime.caching import KEPT
from splitband.runtime.files import replacing
from splitband.runtime.workers import Workers, run_jobs

FILE, PAGE = Path("docs/benchmarks/constants.jsonl"), Path("docs/tables/constants.md")
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
        y = model.predict(len(test) - 50, history=test[:50]).y
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
        how = sb.Settings(200, 50, steps, 25, quasi_newton=100, linear_start=linear_start)
        model = sb.Single(sb.StateSpace(4, 8), how).fit(record)
        y = model.predict(len(test) - 50, history=test[:50]).y
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


GROUPS: dict[str, tuple[Callable[[], Results], tuple[str, ...]]] = {
    "linear": (linear, tuple(f"baselines/{n}.py" for n in
                             ("delays", "identification", "kalman", "linear", "selection"))),
    "time": (time, ("baselines/seasonal.py", "baselines/sinusoids.py",
                    "forecasters/closed_form.py")),
    "comparison": (comparison, ("forecasters/backtest.py", "forecasters/intervals.py", "metrics.py",
                                "forecasters/prehistory.py", "evaluation/recommendation.py")),
    "bands": (bands, ("filters/cutoff.py",)),
    "simulators": (simulators, ("forecasters/grey_box.py", "simulators/identification.py",
                                "simulators/parameters.py", "simulators/shooting.py",
                                "simulators/calibration.py")),
    "networks": (networks, ("networks/state_space.py",)),
    "tests": (tests, ("forecasters/residuals.py",)),
}  # fmt: skip
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
        before = getattr(importlib.import_module(f"splitband.{stem}"), self.name)
        with_it = [
            module
            for name, module in [*sys.modules.items()]
            if name.startswith("splitband") and getattr(module, self.name, None) is before
        ]
        KEPT.clear()
        try:
            for module in with_it:
                setattr(module, self.name, moved(before, self.factor))
            return GROUPS[self.group][0]()
        finally:
            for module in with_it:
                setattr(module, self.name, before)
            KEPT.clear()


def moved(value: Any, factor: float) -> Any:
    """Return a number, or several, multiplied by a factor; a share above 1/2 keeps below 1."""
    if isinstance(value, tuple):
        return tuple(moved(each, factor) for each in value)
    if isinstance(value, int):
        return max(1, round(value * factor))
    return 1 - (1 - value) / factor if 0.5 < value < 1 else value * factor


def _by_eye(files: Sequence[str]) -> Iterator[tuple[Constant, str]]:
    for each in constants():
        path = str(each.path.relative_to(SOURCE))
        if path in files and (each.kind == "by eye" or "constants.md" in each.said):
            yield from ((each, name) for name in each.names)


def main() -> None:
    """Compute what is missing, and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--groups", nargs="+", default=[*GROUPS], choices=[*GROUPS])
    parser.add_argument("--names", nargs="+", help="only these constants")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    there = {(row["path"], row["name"], row["factor"]) for row in _rows()}
    jobs = []
    for group in given.groups:
        every = [
            (str(each.path.relative_to(SOURCE)), name)
            for each, name in _by_eye(GROUPS[group][1])
            if given.names is None or name in given.names
        ]
        wanted = [(group, "", 1.0), *((p, n, f) for p, n in every for f in FACTORS)]
        jobs += [Moved(group, *each) for each in wanted if each not in there]
    with Workers(given.jobs) as workers:
        for job, future in run_jobs(Moved.results, jobs, workers):
            row = {**vars(job), "results": future.result()}
            with FILE.open("a", encoding="utf-8") as file:
                file.write(json.dumps(row) + "\n")
            print(job, flush=True)
    with replacing(PAGE) as temporary:
        temporary.write_text(page(), encoding="utf-8")


def _rows() -> list[dict[str, Any]]:
    lines = FILE.read_text(encoding="utf-8").splitlines() if FILE.exists() else []
    return [json.loads(line) for line in lines]


def page() -> str:
    """Return the table of all constants that were moved, as Markdown."""
    rows = _rows()
    usual = {row["group"]: row["results"] for row in rows if row["factor"] == 1.0}
    found: dict[tuple[str, str], dict[float, str]] = {}
    for row in rows:
        if row["factor"] != 1.0:
            of = found.setdefault((row["path"], row["name"]), {})
            of[row["factor"]] = _in_words(row["results"], usual[row["group"]])
    doc = (__doc__ or "").split("\n\n")
    lines = [f"# Constants, halved and doubled\n\n{doc[0]} ({doc[1].strip()}) {doc[2]}"]
    lines.append("| constant | halved | doubled |\n|---|---|---|")
    text = "\n".join(f"| {p} `{n}` | {of.get(0.5, '')} | {of.get(2.0, '')} |"
                     for (p, n), of in sorted(found.items()))  # fmt: skip
    return "\n\n".join(lines) + "\n" + text + "\n"


def _in_words(results: Results, usual: Results) -> str:
    ratios = [max(results.get(case, math.inf), 1e-12) / max(value, 1e-12)
              for case, value in usual.items()]  # fmt: skip
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    changed = [ratio for ratio in ratios if abs(ratio - 1) > CHANGED]
    if not changed:
        return f"none of {len(ratios)} changes"
    mean, least, most = statistics.geometric_mean(finite), min(ratios), max(ratios)
    return f"{len(changed)} of {len(ratios)}: {mean:.3f} times ({least:.2f} to {most:.2f})"


if __name__ == "__main__":
    main()
