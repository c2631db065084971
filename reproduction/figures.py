"""The paper's figures, made of finished runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from reproduction import pictures as drawn
from reproduction.jobs import ORACLE, SYSTEMS, Job
from reproduction.runs import as_fit, finished, load
from reproduction.specs import SPECS, Line, chosen, lines
from splitband.comparison.backtest import Fit
from splitband.comparison.methods import QUICK
from splitband.comparison.plan import Plan
from splitband.comparison.result import Comparison


def _unfiltered(comparison: Comparison) -> Figure:
    return drawn.components(comparison, "unfiltered")


FIGURES: dict[str, Callable[[Comparison], Figure]] = {
    "spectrum": drawn.spectrum,
    "rollouts": drawn.rollouts,
    "components": drawn.components,
    "unfiltered": _unfiltered,
    "errors": drawn.errors,
}
"""By the name that the command line takes."""

_SHOWN_BASELINES = ("simulator", "seasonal-naive", "harmonic")


def needed(
    name: str,
    systems: Sequence[str] | None = None,
    methods: Sequence[str] | None = None,
    seeds: int = 5,
    epochs: int | None = None,
) -> dict[str, list[Line]]:
    """The runs that a figure shows, by system; only those that it is drawn for."""
    found = {}
    for system in chosen("systems", systems, SYSTEMS):
        rows = [
            line
            for table, spec in SPECS.items()
            if system in spec.systems and not spec.varied and spec.shows != "seconds"
            for line in lines(table, [system], None, seeds, epochs)
            if _shown(name, line.method) and (methods is None or line.method in methods)
        ]
        if rows or name == "spectrum":
            found[system] = list({line.method: line for line in rows}.values())
    return found


def figure(name: str, system: str, of: Sequence[Line], folder: Path) -> Figure:
    """Draw one figure of the runs in `folder`; raises what `load` does."""
    fits: dict[str, list[Fit]] = {}
    for line in of:
        facts = [load(job, folder) for job in finished(line.jobs, folder)]
        good = [as_fit(run, line.jobs[0].record) for run in facts if "diverged" not in run]
        if good and good[0].seed == 0:
            fits[line.method] = good
    job = Job(system, next(iter(fits), "persistence"))
    record = job.record
    setup = job.setup(record)
    plan = Plan(
        record, setup.train, len(record) - setup.train, (), setup.settings, setup.bands, setup.sizes
    )
    return FIGURES[name](Comparison(plan, fits))


def _shown(name: str, method: str) -> bool:
    if name == "spectrum" or method == ORACLE:
        return False
    if name == "components":
        return method.startswith(("split", "filtered", "residual"))
    if name == "unfiltered":
        return method.startswith("filtered")
    return method not in QUICK or method in _SHOWN_BASELINES
