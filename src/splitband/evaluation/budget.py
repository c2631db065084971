"""Manage the time of a comparison: the deadline of each part, time left, time used.

Costs of trainings are estimated in seconds of a reference core (`evaluation.costs`). How long such
a second takes on this machine, under its present load, is measured on the trainings of the same
run.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from splitband.evaluation.costs import speed
from splitband.runtime.deadlines import Deadline, now

BASELINES_SHARE = 0.3
"""Share of the time that baselines may take, if there are networks too. These shares are by eye,
checked with `python -m benchmarks.budget`."""
SEARCH_SHARE, TRIAL_SHARE, BASE_SHARE = 0.5, 0.65, 0.7
"""Deadlines of the search, of the trial of all methods on three quarters of the samples, and of the
trial of a network on a baseline, as shares of the time left when baselines are done. The rest is
for final trainings."""
MOST_FOR_ONE_TRAINING = 0.3
"""Share of the time, and of the work, that a single training of a candidate may take. By eye."""
ASSUMED_SLOWDOWN = 2.0
"""Assumed slowdown of trainings, relative to the gradient that `costs.speed` times, until they have
been timed themselves. By eye."""
START = "start"
"""The phase before a comparison: loading the package, reading the record."""
PROCESSES = 1.5
"""Other processes are started if the time left is more than this many times the seconds that the
command took to start. By eye."""
BUSY = 0.8
"""Share of the time of all cores that parallel trainings use. By eye."""
PRIOR_WEIGHT = 5.0
"""Weight of the assumed pace in the measured one, in seconds of a reference core of trainings.
By eye."""
NAMED = 6
"""Largest number of changes by the time limit that a line lists. By eye."""


@dataclass
class Phase:
    """Hold the seconds that a part of a command `used` and, if limited, was `planned` to use."""

    used: float = 0.0
    planned: float | None = None


@dataclass
class Pace:
    """Hold the measured pace of trainings on this machine.

    Attributes
    ----------
    seconds : Wall seconds per second of a reference core; an assumed value until it is measured.
    trained : Work on which `seconds` rests, in seconds of a reference core: `PRIOR_WEIGHT` plus the
        estimated cost of all timed trainings.
    forecasting : Seconds that a job needs for its forecasts, after its training.
    """

    seconds: float = 1.0
    trained: float = PRIOR_WEIGHT
    forecasting: float = 0.0

    def measured(self, estimated: float, took: float, forecasting: float = 0.0) -> None:
        """Update the pace with the estimated cost and the measured time of a training.

        The pace is that of all trainings together, because the time of a short one is mostly
        overhead, such as the start of a process. For the same reason `forecasting` is the shortest
        time that was measured.
        """
        if estimated > 0:
            self.seconds = (self.trained * self.seconds + took) / (self.trained + estimated)
            self.trained += estimated
            self.forecasting = (
                min(self.forecasting, forecasting) if self.forecasting else forecasting
            )


@dataclass(eq=False)
class TimeBudget:
    """Hold the time limit of one command, and how the time was used.

    Attributes
    ----------
    deadline : When all forecasts must be ready; time for what follows is already subtracted.
    cores : Number of parallel trainings.
    began : When the command began, by the clock of `runtime.deadlines.now`.
    pace : Pace of this machine under its present load.
    left_out : Methods for which there was no time, and why.
    cut : Trainings that the deadline ended, and choices that it narrowed.
    phases : Time used by each phase, in order.
    requested_limits : Seconds of wall time, and of a reference core; None: no limit.
    """

    deadline: Deadline = field(default_factory=Deadline)
    cores: int = 1
    began: float = field(default_factory=now)
    pace: Pace = field(default_factory=Pace)
    left_out: dict[str, str] = field(default_factory=dict)
    cut: list[str] = field(default_factory=list)
    phases: dict[str, Phase] = field(default_factory=dict)
    requested_limits: tuple[float | None, float | None] = (None, None)

    @classmethod
    def of(
        cls, seconds: float | None, cores: int, began: float | None = None, after: float = 0.0
    ) -> TimeBudget:
        """Return the time budget of a command.

        Parameters
        ----------
        seconds : Wall time of the whole command; None: no limit.
        cores : Number of parallel trainings.
        began : When it began, by default now.
        after : Seconds reserved for what follows the forecasts.
        """
        began = now() if began is None else began
        if seconds is None:
            return cls(Deadline(), cores, began)
        deadline, pace = Deadline(began + seconds - after), Pace(ASSUMED_SLOWDOWN / speed())
        return cls(deadline, cores, began, pace, phases={START: Phase(now() - began)})

    @property
    def limited(self) -> bool:
        """Return whether there is a deadline."""
        return self.deadline != Deadline()

    @property
    def reproducible(self) -> bool:
        """Return whether the time limit changed nothing, so that a repetition gives the same."""
        return not self.left_out and not self.cut

    def allows_processes(self, until: Deadline) -> bool:
        """Return whether there is enough time to start other processes, see `PROCESSES`."""
        return until.left > PROCESSES * self.phases.get(START, Phase()).used

    def share(self, share: float) -> Deadline:
        """Return the deadline after this share of the time that is left now."""
        return (
            self.deadline.earlier((1 - share) * self.deadline.left) if self.limited else Deadline()
        )

    def work_until(self, until: Deadline) -> float:
        """Return the work that all cores can do until then, in seconds of a reference core."""
        return max(BUSY * self.cores * until.left / self.pace.seconds, 0.0)

    def work_of_one(self, until: Deadline) -> float:
        """Return the work that a single training can do until then, in the same unit."""
        return max(until.left / self.pace.seconds, 0.0)

    def narrowed(self, what: str) -> None:
        """Note a choice that the time limit has changed, once."""
        if what not in self.cut:
            self.cut.append(what)

    def leave_out(self, name: str, what: str, takes: float, until: Deadline) -> None:
        """Note a method that is left out, as its trial or training `takes` too many seconds."""
        self.left_out[name] = (
            f"left out: its {what} takes about {takes:.0f} s here, and {max(until.left, 0):.0f} s "
            "were left for it"
        )

    @contextmanager
    def phase(self, name: str, until: Deadline | None = None) -> Iterator[None]:
        """Time the enclosed work as a phase that should end by `until`, by default the deadline.

        Times of phases with the same name are added up.
        """
        began, ends = now(), until or self.deadline
        planned = max(ends.left, 0.0) if self.limited else None
        phase = self.phases.setdefault(name, Phase(planned=planned))
        try:
            yield
        finally:
            phase.used += now() - began

    def as_json(self) -> dict[str, Any]:
        """Return the entries of result files: kind of limit, its values, the time used."""
        seconds, work = self.requested_limits
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
        """Describe the time planned and used, and what the time limit has changed."""
        phases = ", ".join(
            f"{name} {phase.used:.0f}"
            + ("" if phase.planned is None else f" of {phase.planned:.0f}")
            for name, phase in self.phases.items()
        )
        wall, work = self.requested_limits
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
