"""How good the recommendation and its intervals are, over records of many kinds.

    python -m benchmarks.recommendation [--seeds 4] [--jobs 2] [--methods ...] [--development]
    python -m benchmarks.recommendation --methods default --seeds 3 --skip 5

Regret is the forecast error of the recommended method over that of the best one, known afterwards.
An interval's width is compared with what would just have held nine tenths of the samples, had that
been known. By default the baselines are compared, which take no training: what they are worth
differs as much as it does for networks. `--methods default` does all that `splitband compare` does
by its clock, on one core each: networks, whose training is searched, and baselines together.

Constants are chosen on `--development` seeds; without it, other seeds are drawn, and the paper's
records are added, on which nothing is chosen. Each record is a file in `--parts` that is made once
for each state of the code: stop it, go on. `docs.tables` makes tables of baselines and `default`.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks import claims
from benchmarks.kinds import DEVELOPMENT, KINDS, REPORTED, SAMPLES, TRAINING, WITH_INPUTS, drawn
from reproduction.systems import double_torsion_pendulum
from splitband import Comparison, compare
from splitband.comparison.defaults import default_names
from splitband.comparison.methods import QUICK
from splitband.comparison.recommendation import Trial
from splitband.forecasters.intervals import Interval
from splitband.metrics import rmse
from splitband.records import Record, double_torsion, drill_string
from splitband.records.named import double_mass_spring, van_der_pol
from splitband.report.environment import environment
from splitband.runtime.files import write_json
from splitband.runtime.workers import Workers, run_jobs

Array = npt.NDArray[Any]
Facts = dict[str, Any]
SIZES = ((1000, 400), (2000, 1000))
"""Samples of a record, and how many of them are trained on."""
BASELINES, DEFAULT = "baselines", "default"
FILES = {
    BASELINES: Path("docs/benchmarks/recommendation.json"),
    DEFAULT: Path("docs/benchmarks/recommendation-default.json"),
}
"""Of which methods there is a table in docs/howto/intervals.md, and where its facts are."""


@dataclass(frozen=True)
class RecordJob:
    """A record, its training samples, and where the facts about it go."""

    kind: str
    name: str
    record: Callable[[], Record]
    train: int
    methods: str
    parts: Path

    @property
    def path(self) -> Path:
        """Of its facts."""
        return self.parts / f"{self.name}, {self.train}, {self.methods}.json"


def jobs(seeds: Sequence[int], others: bool, methods: str, parts: Path) -> list[RecordJob]:
    """Every kind with every seed, the sizes in turn; and the `others`, which no seed draws."""
    found = []
    for i, seed in enumerate(seeds):
        samples, train = SIZES[i % len(SIZES)]
        for kind in KINDS:
            make = partial(drawn, kind, seed, samples)
            found.append(RecordJob(kind, f"{kind} {seed}", make, train, methods, parts))
        for kind in WITH_INPUTS:
            make = partial(drawn, kind, seed, SAMPLES)
            found.append(RecordJob(kind, f"{kind} {seed}", make, TRAINING, methods, parts))
    paper: list[tuple[str, Callable[[], Record], int]] = [
        ("double torsion", double_torsion, 600),
        *((f"pendulum {row}", partial(double_torsion_pendulum, row), 600) for row in _ROWS),
        ("v", van_der_pol, 600),
        ("vi", drill_string, 2000),
        *((f"i {draw}", partial(double_mass_spring, seed=draw), 250) for draw in range(4)),
    ]
    if others:
        found += [RecordJob("the paper's", n, make, t, methods, parts) for n, make, t in paper]
    return found


_ROWS = ("ii", "iii", "iv")


def _measured(job: RecordJob) -> Facts:
    if job.path.exists():
        return dict(json.loads(job.path.read_text(encoding="utf-8")))
    record = replace(job.record(), y_sim=None, y_true=None)
    comparison = _comparison(record, job)
    settled = comparison.require_trial()
    # A method may fail on the shorter held-out fits alone: it has no interval then.
    judged = {m: run for m, run in comparison.medians.items() if m in settled.intervals}
    left = {m: record.y[job.train :] - run.ahead for m, run in judged.items()}
    errors = {m: rmse(e, np.zeros_like(e)) for m, e in left.items()}
    facts = {
        "kind": job.kind,
        "name": job.name,
        "train": job.train,
        "recommended": settled.recommended,
        "regret": errors[settled.recommended] / min(errors.values()),
        "over_baselines": errors[settled.recommended] / errors[_of_baselines(settled)],
        "methods": {m: _method(settled, m, e) | {"error": errors[m]} for m, e in left.items()},
    }
    write_json(job.path, facts)
    return facts


def _comparison(record: Record, job: RecordJob) -> Comparison:
    if job.methods == DEFAULT:
        return compare(record, job.train, budget=120.0)
    methods = job.methods.split(",")
    if job.methods == BASELINES:
        methods = [name for name in default_names(False, record.nu > 0) if name in QUICK]
    return compare(record, job.train, methods)


def _of_baselines(trial: Trial) -> str:
    """What would be recommended without networks."""
    return replace(trial, final=tuple(m for m in trial.final if m in QUICK)).recommended


def _method(trial: Trial, method: str, errors: Array) -> Facts:
    interval = trial.intervals[method]
    return {
        "held_out": float(np.linalg.norm(trial.errors[method])),
        "inside": interval.coverage(errors),
        "width": _width(interval, errors),
    }


def _width(interval: Interval, errors: Array) -> float:
    """Mean width over that of the constant interval that holds the share, channel by channel."""
    enough = np.quantile(abs(errors), interval.share, axis=0)
    return float(np.mean(interval.half_widths(len(errors)).mean(axis=0) / enough))


def by_kind(found: Sequence[Facts]) -> dict[str, Facts]:
    """For each kind the mean of the recommended methods' facts and the worst regret."""
    kinds: dict[str, list[Facts]] = {}
    for facts in found:
        kinds.setdefault(facts["kind"], []).append(facts)
    return {kind: _summary(of_kind) for kind, of_kind in kinds.items()}


def _summary(found: Sequence[Facts]) -> Facts:
    chosen = [facts["methods"][facts["recommended"]] for facts in found]
    inside = [of_method["inside"] for of_method in chosen]
    return {
        "records": len(found),
        "mean_log_regret": statistics.mean(math.log(f["regret"]) for f in found),
        "worst_regret": max(f["regret"] for f in found),
        "inside": statistics.mean(inside),
        # Of the mean over the records: they are few, and each is mostly inside or mostly outside.
        "inside_error": statistics.pstdev(inside) / math.sqrt(max(len(inside) - 1, 1)),
        "width": statistics.median(c["width"] for c in chosen),
        "inside_of_all_methods": statistics.mean(
            m["inside"] for f in found for m in f["methods"].values()
        ),
        "networks": sum(facts["recommended"] not in QUICK for facts in found),
        "mean_log_over_baselines": statistics.mean(math.log(f["over_baselines"]) for f in found),
    }


def table(facts: Facts) -> str:
    """Coverage, width and regret by kind, in Markdown; where networks were tried, what they add."""
    (first, last), which = facts["seeds"], facts["seeds_are"]
    with_networks = facts["methods"] != BASELINES
    heads = ["kind", "inside", "width", "inside, all methods"]
    heads.append("regret, geometric mean and worst")
    if with_networks:
        heads += ["network recommended", "error over that without networks"]
    lines = [
        f"{facts['all']['records']} records, by kind one of each of the {which} seeds {first} to "
        f"{last} if nothing else is said, methods: {facts['methods']}\n",
        f"| {' | '.join(heads)} |",
        "|---|" + "---:|" * (len(heads) - 1),
    ]
    for kind, of_kind in [*facts["kinds"].items(), ("all", facts["all"])]:
        error = f" ± {of_kind['inside_error']:.0%}" if of_kind["records"] > 1 else ""
        usual = kind == "all" or of_kind["records"] == 1 + last - first
        cells = [
            (kind if usual else f"{kind} ({of_kind['records']})") + claims.sign([facts]),
            f"{of_kind['inside']:.0%}{error}",
            f"{of_kind['width']:.2f}",
            f"{of_kind['inside_of_all_methods']:.0%}",
            f"{math.exp(of_kind['mean_log_regret']):.2f}, {of_kind['worst_regret']:.2f}",
        ]
        if with_networks:
            of_baselines = math.exp(of_kind["mean_log_over_baselines"])
            cells += [str(of_kind["networks"]), f"{of_baselines:.2f}"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n" + claims.note([facts])


def main() -> None:
    """Measure all records and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", type=Path, default=Path("out/recommendation"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--skip", type=int, default=0, help="seeds that have been looked at before")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--methods", default=BASELINES, help=f"{BASELINES}, {DEFAULT} or names")
    parser.add_argument("--development", action="store_true", help="print, and write nothing else")
    arguments = parser.parse_args()
    parts = arguments.parts / claims.sources()  # those of older code are made again
    parts.mkdir(parents=True, exist_ok=True)
    seeds = (DEVELOPMENT if arguments.development else REPORTED)[arguments.skip :]
    seeds = seeds[: arguments.seeds]
    # What the default command does on the paper's records is in docs/results/beyond.
    others = not arguments.development and arguments.methods != DEFAULT
    before = claims.reference()
    todo = jobs(seeds, others, arguments.methods, parts)
    with Workers(arguments.jobs) as workers:
        done = {job.name: future.result() for job, future in run_jobs(_measured, todo, workers)}
    found = [done[job.name] for job in todo]
    facts = claims.marked({"commit": environment()["commit"]}, before) | {
        "seeds": [seeds[0], seeds[-1]],
        "seeds_are": "development" if arguments.development else "reported",
        "methods": arguments.methods,
        "all": _summary(found),
        "kinds": by_kind(found),
        "found": found,
    }
    print(table(facts))
    if arguments.methods in FILES and not arguments.development:
        write_json(FILES[arguments.methods], facts)


if __name__ == "__main__":
    main()
