"""Spend the time of a comparison: the deadline of each part, what is left, what it took.

Costs of trainings are estimated in seconds of a reference core (`evaluation.costs`). What such a
second takes on this machine, with whatever else runs on it, is measured by the trainings of the
same run, so that a busy machine is known to be slower.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from splitband.evaluation.costs import speed
from splitband.runtime.deadlines import Deadline, now

BASELINES = 0.3
"""Share of the time that baselines may take. These shares are by eye, held against `python -m
benchmarks.budget`."""
SEARCH, TRIAL, BASE = 0.5, 0.65, 0.7
"""Shares of the time after the baselines by which the search, the trial of all methods on three
quarters of the samples, and that of a network on a baseline must end; the rest is for final
trainings."""
ONE = 0.3
"""Share of the time, and of the work, that a single training of a candidate may take. By eye."""
SLOWER = 2.0
"""By how much trainings are taken to be slower than the gradient by which a core is measured, until
they have been measured themselves. By eye."""
START = "start"
"""The phase before a comparison: loading the package, reading the record."""
PROCESSES = 1.5
"""Multiples of what the command took to start that must be left for other processes to be worth
starting, too. By eye."""
BUSY = 0.8
"""Share of the time of all cores that trainings side by side make use of. By eye."""
SUPPOSED = 5.0
"""Seconds of a reference core of trainings that count as much as what was supposed of the pace.
By eye."""
NAMED = 6
"""Changes by the clock that are named in a line. By eye."""


@dataclass
class Phase:
    """Hold a part of a command: seconds that it `used`, and could when it began, if limited."""

    used: float = 0.0
    planned: float | None = None


@dataclass
class Pace:
    """Say how long trainings take on this machine.

    Attributes
    ----------
    seconds : Wall seconds that a second of a reference core takes; 1 until it is measured.
    trained : Seconds of a reference core of the trainings by which it has been measured.
    asking : Seconds that a job needs after its training, to be asked for forecasts.
    """

    seconds: float = 1.0
    trained: float = SUPPOSED
    asking: float = 0.0

    def measured(self, estimated: float, took: float, asking: float = 0.0) -> None:
        """Learn from a training that was estimated to take some time, and took another.

        The pace is that of all trainings together: in a short one much else is counted, such as the
        start of a process. For the same reason the quickest answer tells how long `asking` takes.
        """
        if estimated > 0:
            self.seconds = (self.trained * self.seconds + took) / (self.trained + estimated)
            self.trained += estimated
            self.asking = min(self.asking, asking) if self.asking else asking


@dataclass(eq=False)
class TimeBudget:
    """Hold the time of one command, and where it went.

    Attributes
    ----------
    deadline : When all forecasts must be there; what comes after them has been allowed for.
    cores : Trainings side by side.
    began : When the command began, by the clock of `runtime.deadlines.now`.
    pace : How fast this machine is, with whatever else runs on it.
    left_out : Methods for which there was no time, and why.
    cut : Trainings that the deadline ended, and choices that it narrowed.
    phases : What has been done, in its order.
    asked : Seconds of wall time, and of work of a reference core, that were allowed; None where
        there was no such limit.
    """

    deadline: Deadline = field(default_factory=Deadline)
    cores: int = 1
    began: float = field(default_factory=now)
    pace: Pace = field(default_factory=Pace)
    left_out: dict[str, str] = field(default_factory=dict)
    cut: list[str] = field(default_factory=list)
    phases: dict[str, Phase] = field(default_factory=dict)
    asked: tuple[float | None, float | None] = (None, None)

    @classmethod
    def of(
        cls, seconds: float | None, cores: int, began: float | None = None, after: float = 0.0
    ) -> TimeBudget:
        """Return the time budget of a command.

        Parameters
        ----------
        seconds : Of wall time for all of it; None: no limit.
        cores : Trainings side by side.
        began : When it began, by default now.
        after : Seconds for what is done with the forecasts.
        """
        began = now() if began is None else began
        if seconds is None:
            return cls(Deadline(), cores, began)
        deadline, pace = Deadline(began + seconds - after), Pace(SLOWER / speed())
        return cls(deadline, cores, began, pace, phases={START: Phase(now() - began)})

    @property
    def limited(self) -> bool:
        """Return whether there is a deadline at all."""
        return self.deadline != Deadline()

    @property
    def reproducible(self) -> bool:
        """Return whether the clock has changed nothing: the same command finds the same again."""
        return not self.left_out and not self.cut

    def allows_processes(self, until: Deadline) -> bool:
        """Return whether there is time to start other processes, which take as long as this one."""
        return until.left > PROCESSES * self.phases.get(START, Phase()).used

    def share(self, share: float) -> Deadline:
        """Return when so large a share of the time that is left now will be over."""
        return (
            self.deadline.earlier((1 - share) * self.deadline.left) if self.limited else Deadline()
        )

    def work_until(self, until: Deadline) -> float:
        """Return how many seconds of a reference core all cores together have until then."""
        return max(BUSY * self.cores * until.left / self.pace.seconds, 0.0)

    def work_of_one(self, until: Deadline) -> float:
        """Return the same of a single training."""
        return max(until.left / self.pace.seconds, 0.0)

    def narrowed(self, what: str) -> None:
        """Note what the clock has changed, once."""
        if what not in self.cut:
            self.cut.append(what)

    def leave_out(self, name: str, what: str, takes: float, until: Deadline) -> None:
        """Note a method for whose trial or training there is no time; it `takes` these seconds."""
        self.left_out[name] = (
            f"left out: its {what} takes about {takes:.0f} s here, and {max(until.left, 0):.0f} s "
            "were left for it"
        )

    @contextmanager
    def phase(self, name: str, until: Deadline | None = None) -> Iterator[None]:
        """Count what happens in here as a phase that is to end by `until`; a name may come again.

        By default it may take all the time that is left.
        """
        began, ends = now(), until or self.deadline
        planned = max(ends.left, 0.0) if self.limited else None
        phase = self.phases.setdefault(name, Phase(planned=planned))
        try:
            yield
        finally:
            phase.used += now() - began

    def as_json(self) -> dict[str, Any]:
        """Return what result files say: what was limited, what was asked for, what was used."""
        seconds, work = self.asked
        limited = "nothing" if work is None else "work" if seconds is None else "time"
        return {
            "limited": limited,
            "asked_seconds": seconds,
            "asked_core_seconds": work,
            "used_seconds": round(now() - self.began, 2),
            "phases": {name: round(phase.used, 2) for name, phase in self.phases.items()},
            "planned_phases": {
                name: round(phase.planned, 2)
                for name, phase in self.phases.items()
                if phase.planned is not None
            },
            "changed_by_the_clock": [*self.cut],
            "left_out": dict(self.left_out),
        }

    def in_words(self) -> str:
        """Return a line: what was planned and used, and what the clock has changed."""
        phases = ", ".join(
            f"{name} {phase.used:.0f}"
            + ("" if phase.planned is None else f" of {phase.planned:.0f}")
            for name, phase in self.phases.items()
        )
        wall, work = self.asked
        of_wall = "" if wall is None else f" of {wall:.0f}"
        said = f"time: {now() - self.began:.0f}{of_wall} s ({phases})"
        if wall is None and work is not None:
            said += f", not limited; the work was, to {work:.0f} s of a reference core"
        if self.reproducible:
            return said
        changed = [*self.cut, *(f"{name} left out" for name in self.left_out)]
        listed = ", ".join(changed[:NAMED])
        listed += f" and {len(changed) - NAMED} more" if len(changed) > NAMED else ""
        return (
            f"{said}\nthe time limit changed what was run ({listed}): another run may give another "
            "result; a longer --budget avoids that, and --effort limits work instead of time"
        )
