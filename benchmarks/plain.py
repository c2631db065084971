"""The plain command by its clock, over several seeds: what it recommends, and how good that is."""

from __future__ import annotations

import json
import statistics
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import splitband as sb
from splitband import Record
from splitband.report.environment import environment
from splitband.runtime.files import write_json

Facts = dict[str, Any]
BUDGET, CORES = 120.0, 2
"""Of the plain command, in s; and the processes that it trains in here."""


def compared(
    record: Record,
    train: int | None = None,
    methods: list[str] | None = None,
    *,
    seed: int,
    budget: float = BUDGET,
    cores: int = CORES,
    **options: Any,
) -> Facts:
    """Compare and return the errors, in the record's unit, of every method's median."""
    result = sb.compare(record, train, methods, seed=seed, budget=budget, cores=cores, **options)
    best, errors = result.recommended, {}
    for name, fit in result.medians.items():
        of = result.errors(fit)
        errors[name] = [*of.tests] or ([] if fit.forecast is None else [of.forecast])
    ahead = len(result.medians[best].ahead) if result.plan.horizon else 0
    return {
        "seed": seed,
        "time": result.clock.as_json(),
        "recommended": best,
        "description": result.medians[best].description,
        "trainings": len(result.fits[best]),
        "errors": {name: of for name, of in errors.items() if of},
        "covers": result.covers(best) if ahead else None,
        "environment": environment(),
    }


def complete(
    out: Path, name: str, budget: float, seeds: Iterable[int], measured: Callable[[int], Facts],
    last: str = "",
) -> None:  # fmt: skip
    """Measure the seeds that a record's file lacks (NAME-BUDGET), each written as it is done."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{name}-{budget:g}{last}.json"
    runs = read(path)["runs"] if path.exists() else []
    for seed in seeds:
        if all(run["seed"] != seed for run in runs):
            runs.append(measured(seed))
            of_tests = [spread(each) for each in zip(*map(errors_of, runs), strict=True)]
            asked = f"`--budget {budget / 60:g}m`"
            write_json(path, {"asked": asked, "errors": of_tests, "runs": runs})
            print(path.stem, seed, runs[-1]["recommended"], errors_of(runs[-1]), flush=True)


def errors_of(run: Facts) -> list[float]:
    """Return the errors of the recommended method."""
    errors: list[float] = run["errors"][run["recommended"]]
    return errors


def spread(values: Iterable[float]) -> dict[str, float]:
    """Return the median and the range."""
    of = [*values]
    return {"median": statistics.median(of), "lowest": min(of), "highest": max(of)}


def read(path: Path) -> Facts:
    """Return what a JSON file holds."""
    return dict(json.loads(path.read_text(encoding="utf-8")))
