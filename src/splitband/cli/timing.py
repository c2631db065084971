"""How much of the time of a command is kept for writing its results, and what is said of it."""

from __future__ import annotations

from splitband.cli import clock
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.setup import Setup

WRITING, AS_STARTING = 2.0, 1.5
"""Seconds for pictures and page, besides so many times what the command took to start: both are
work of the same kind on the same machine, whatever else it does."""
NUMBER, USUAL_START = 3e-6, 3.0
"""Seconds for a number in the tables, where a command starts within so many."""
MOST = 0.4
"""Share of the time that is kept for writing, at most."""


def planned(setup: Setup, cores: int, numbers: int, began: float | None = None) -> TimeBudget:
    """The time budget of a command that will write so many numbers.

    It counts from when it `began`, by default from when the command did.
    """
    search = setup.search
    if search is None or search.seconds is None:
        return TimeBudget.of(None, cores, clock.began() if began is None else began)
    slow = max(clock.starting() / USUAL_START, 1.0)
    writing = AS_STARTING * clock.starting() + slow * (WRITING + NUMBER * numbers)
    return TimeBudget.of(
        search.seconds,
        cores,
        clock.began() if began is None else began,
        min(writing, MOST * search.seconds),
    )


def in_words(time: TimeBudget) -> str:
    """A line below the table: what was planned and used, and what the clock has changed."""
    used = time.as_json()["used_seconds"]
    phases = ", ".join(
        f"{name} {phase.used:.0f}" + ("" if phase.planned is None else f" of {phase.planned:.0f}")
        for name, phase in time.phases.items()
    )
    said = f"time: {used:.0f} s ({phases})"
    wall, work = time.asked
    if wall is not None:
        said = f"time: {used:.0f} of {wall:.0f} s ({phases})"
    elif work is not None:
        said += f", not limited; the work was, to {work:.0f} s of a reference core"
    if time.reproducible:
        return said
    changed = [*time.cut, *(f"{name} left out" for name in time.left_out)]
    listed = ", ".join(changed[:6]) + (f" and {len(changed) - 6} more" if len(changed) > 6 else "")
    return (
        f"{said}\nthe clock changed what was done ({listed}): another run may find something else; "
        "a longer --budget avoids that, --effort limits the work in place of the time"
    )
