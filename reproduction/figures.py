"""The paper's figures, made of finished runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from reproduction import pictures as drawn
from reproduction.jobs import ORACLE, Job
from reproduction.runs import as_fit, finished, load
from reproduction.specs import SPECS, Line, lines
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
NUMBERED: dict[int, tuple[tuple[str, str], ...]] = {
    2: (("spectrum", "i"), ("components", "i"), ("errors", "i")),
    3: (("rollouts", "i"), ("rollouts", "ii"), ("rollouts", "iv")),
    4: (("rollouts", "v"), ("unfiltered", "v"), ("rollouts", "vi")),
    5: (("spectrum", "i"), ("spectrum", "v"), ("spectrum", "vi")),
    6: (("spectrum", "ii"), ("spectrum", "iii"), ("spectrum", "iv")),
    7: (("rollouts", "iii"), ("rollouts", "vi"), ("rollouts", "v")),
    8: (("errors", "ii"), ("errors", "iii"), ("errors", "iv")),
    9: (("errors", "v"),),
    10: (("errors", "vi"),),
}
"""What the paper's figures show, by number, counted on through its supplement; 1 is a sketch. The
captions of 8 to 10 speak of absolute errors, the text of the RMSE up to each time, as here."""

_SHOWN_BASELINES = ("simulator", "seasonal-naive", "harmonic")


def needed(
    name: str,
    system: str,
    methods: Sequence[str] | None = None,
    seeds: int = 5,
    **changes: float | None,
) -> list[Line] | None:
    """Return the runs that a figure of a system shows, each once; None if it is not drawn for it.

    `changes`: see `lines`.
    """
    rows = [
        line
        for table, spec in SPECS.items()
        if system in spec.systems and "errors" in spec.shows
        if not spec.varied and not spec.own_warmup
        for line in lines(table, [system], None, seeds, **changes)
        if _shown(name, line.method) and (methods is None or line.method in methods)
    ]
    return [*{line.method: line for line in rows}.values()] if rows or name == "spectrum" else None


def figure(name: str, system: str, of: Sequence[Line], folder: Path) -> Figure:
    """Draw one figure of the runs in `folder`; raises what `load` does."""
    fits: dict[str, list[Fit]] = {}
    for line in of:
        facts = [load(job, folder) for job in finished(line.jobs, folder)]
        good = [as_fit(run, line.jobs[0].record) for run in facts if "diverged" not in run]
        if good and good[0].seed == 0:
            fits[line.method] = [*good]
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
