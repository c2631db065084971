"""Public benchmarks of nonlinear system identification: the default command, and longer budgets.

    python -m benchmarks.public [--sets tanks,silverbox] [--budgets 0,1,2,5,10] [--jobs 2]

Everything is fitted and chosen on the training file alone; each test file is warmed up on its first
50 samples and simulated to its end. A budget of 0 is that of `splitband compare` without --budget,
the others are minutes of two cores. Results that are there already are not computed again, and what
was cut off goes on; the page docs/results/benchmarks.md is made of them.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

import splitband as sb
from benchmarks.sets import SETS, Benchmark, load
from splitband.evaluation.costs import FOR_TRAINING
from splitband.evaluation.runs import Work
from splitband.evaluation.search import Search
from splitband.evaluation.setup import default_setup
from splitband.report.results import results
from splitband.runtime.files import CHECKPOINTS, replacing, write_json

PICTURE = "budget.png"
CORES = 2
"""Of the reference machine, which budgets are reckoned for."""


def measure(benchmark: Benchmark, minutes: float, jobs: int, checkpoints: Path) -> dict[str, Any]:
    """What one budget comes to: the command's results, and how long it took."""
    record = load(benchmark.training)
    tests = [load(test) for test in benchmark.tests]
    setup = default_setup(record, len(record))
    if minutes:
        setup = replace(setup, search=Search(FOR_TRAINING * 60 * minutes * CORES))
    began = time.perf_counter()
    comparison = sb.compare(
        record, tests=tests, setup=setup, train=len(record), work=Work(jobs, None, checkpoints)
    )
    facts = results(comparison)
    return {"minutes": minutes, "jobs": jobs, "seconds": time.perf_counter() - began} | facts


def page(found: dict[str, dict[float, dict[str, Any]]], out: Path) -> str:
    """The results as Markdown."""
    parts = [
        "# Public benchmarks",
        "Free runs over test files that nothing was fitted to or chosen by: fitted and chosen on "
        "the training file, warmed up on the first 50 samples of each test file, simulated to its "
        "end; RMSE of the mean over seeds. `python -m benchmarks.public` makes this page. Other "
        "scores are those that their authors published.",
    ]
    for name, of_budget in found.items():
        benchmark = SETS[name]
        heads = [f"{column}, {benchmark.unit}" for column in benchmark.columns]
        rows = [
            [
                "`splitband compare`" + (f" --budget {minutes:g}m" if minutes else ""),
                facts["recommended"],
                *_errors(benchmark, facts),
                str(len(facts["methods"][facts["recommended"]]["seeds"])),
                f"{facts['seconds']:.0f}{' (disturbed)' if facts.get('disturbed') else ''}",
            ]
            for minutes, facts in sorted(of_budget.items())
        ]
        rows += [[method, "", *errors, "", ""] for method, errors in benchmark.published.items()]
        parts += [
            f"## {benchmark.title}",
            f"{benchmark.source[0].upper()}{benchmark.source[1:]}.",
            _table(["", "recommended", *heads, "seeds", "seconds"], rows),
        ]
        chosen = [
            f"- {minutes:g} min: {facts['methods'][facts['recommended']].get('description', '')}"
            for minutes, facts in sorted(of_budget.items())
        ]
        parts += ["What was found (0: the default budget):", "\n".join(chosen)]
    if (out / PICTURE).exists():
        parts += [f"![Error over budget]({out.name}/{PICTURE})"]
    return "\n\n".join(parts) + "\n"


def _errors(benchmark: Benchmark, facts: dict[str, Any]) -> list[str]:
    mean = facts["methods"][facts["recommended"]]["mean_of_seeds"]
    return [f"{benchmark.scale * error:.3g}" for error in mean["test_rmse"]]


def _table(heads: list[str], rows: list[list[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def draw(found: dict[str, dict[float, dict[str, Any]]], path: Path) -> None:
    """Error over budget, a panel for each benchmark."""
    figure, axes = plt.subplots(1, len(found), figsize=(5 * len(found), 3.6), squeeze=False)
    for axis, (name, of_budget) in zip(axes[0], found.items(), strict=True):
        benchmark = SETS[name]
        budgets = sorted(minutes for minutes in of_budget if minutes)
        for i, column in enumerate(benchmark.columns):
            errors = [float(_errors(benchmark, of_budget[minutes])[i]) for minutes in budgets]
            axis.loglog(budgets, errors, "o-", label=column)
        axis.set(
            title=benchmark.title,
            xlabel="budget (minutes of two cores)",
            ylabel=f"test RMSE ({benchmark.unit})",
        )
        axis.set_xticks(budgets, [f"{minutes:g}" for minutes in budgets])
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.yaxis.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3, which="both")
        axis.legend()
    figure.tight_layout()
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=120)
    plt.close(figure)


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--budgets", default="0,1,2,5,10", help="minutes; 0 is the default budget")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--disturbed", action="store_true", help="the machine does other work: say so of seconds"
    )
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    for minutes in map(float, arguments.budgets.split(",")):
        for name in arguments.sets.split(","):
            path = out / f"{name}-{minutes:g}.json"
            if path.exists():
                continue
            checkpoints = out / CHECKPOINTS / path.stem
            facts = measure(SETS[name], minutes, arguments.jobs, checkpoints)
            write_json(path, facts | {"disturbed": arguments.disturbed})
            shutil.rmtree(out / CHECKPOINTS)
            print(f"{path.stem}: {facts['recommended']}", *_errors(SETS[name], facts), flush=True)
    found = {
        name: {facts["minutes"]: facts for facts in map(_read, sorted(out.glob(f"{name}-*.json")))}
        for name in SETS
    }
    found = {name: of_budget for name, of_budget in found.items() if of_budget}
    several = {
        name: of_budget for name, of_budget in found.items() if sum(map(bool, of_budget)) > 1
    }
    if several:
        draw(several, out / PICTURE)
    with replacing(out.with_suffix(".md")) as temporary:
        temporary.write_text(page(found, out), encoding="utf-8")


def _read(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main()
