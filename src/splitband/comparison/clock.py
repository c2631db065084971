"""Measure the time of a command: one deadline, in seconds of wall time.

What a thing costs is what it took when it was last done, on this machine, under its present load.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from splitband.runtime.deadlines import Deadline, now

MOST_OF_TIME_LEFT = 0.5
"""Largest share of the time left for what is done once before the best go on: fits of simulators,
further choices of training settings, fits without networks. Bounds the time."""

MOST_OF_BASELINE = 10.0
"""Most seconds in which a fit without networks has to end with what it has. Bounds the time."""

PAGE_SHARE = 0.1
"""Largest share of the time left for writing the whole result meanwhile. Bounds the time."""

LEAST_ROUND = 0.05
"""Share of the time for which a further round is not begun any more. Bounds the time."""


@dataclass(eq=False)
class Clock:
    """Hold the time limit of a command, and how its time was used.

    Attributes
    ----------
    limit : Wall time in s of the whole command; None: no limit.
    began : When it began, by the clock of `runtime.deadlines.now`.
    writing : Seconds that are kept for writing the result: what the last writing took.
    cores : Trainings that run side by side.
    trained : Seconds that all trainings took together.
    first_training : When the first training of a network began, by the same clock.
    part : What the command does now.
    parts : Seconds of wall time by part of the command, those of the present one left out.
    notes : What the deadline has changed, in sentences.
    settled : Whether every training has settled, so that more time would change little.
    interrupted : Whether Ctrl-C ended it early.
    """

    limit: float | None = None
    began: float = field(default_factory=now)
    writing: float = 0.0
    cores: int = 1
    trained: float = 0.0
    first_training: float = math.inf
    part: str = "start"
    parts: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    interrupted: bool = False
    settled: bool = False

    @property
    def used(self) -> float:
        """Return the seconds since the command began."""
        return now() - self.began

    @property
    def deadline(self) -> Deadline:
        """Return when the last prediction must be there."""
        return (
            Deadline() if self.limit is None else Deadline(self.began + self.limit - self.writing)
        )

    @property
    def left(self) -> float:
        """Return the seconds until then, at least 0; infinite without a limit."""
        return max(self.deadline.left, 0.0)

    @property
    def shared(self) -> Deadline:
        """Return the deadline of what does not train networks, where others do."""
        return Deadline.after(MOST_OF_TIME_LEFT * self.left)

    @property
    def least_round(self) -> float:
        """Return the seconds that are too few for a further round."""
        return 0.0 if self.limit is None else LEAST_ROUND * self.limit

    def of_baseline(self, count: int) -> float:
        """Return the seconds of one of so many fits without networks; without a limit no end."""
        if self.limit is None:
            return math.inf
        return min(MOST_OF_TIME_LEFT * self.limit / count, MOST_OF_BASELINE)

    @property
    def allows_pages(self) -> bool:
        """Return whether writing the result meanwhile takes little of the time that is left."""
        return self.writing < PAGE_SHARE * self.left

    def enter(self, part: str) -> str:
        """End the present part of the command, begin another one, and return the present one."""
        before, self.part = self.part, part
        self.parts[before] = self.parts.get(before, 0.0) + self.used - sum(self.parts.values())
        return before

    def as_json(self) -> dict[str, Any]:
        """Return the entries of result files."""
        self.enter(self.part)
        first = self.first_training - self.began
        return {
            "asked_seconds": self.limit,
            "used_seconds": round(self.used, 2),
            "cores": self.cores,
            "trained_seconds": round(self.trained, 2),
            "writing_seconds": round(self.writing, 2),
            "first_training_seconds": round(first, 2) if math.isfinite(first) else None,
            "parts_seconds": {part: round(seconds, 2) for part, seconds in self.parts.items()},
            "notes": [*self.notes],
            "settled": self.settled,
        }

    def in_words(self) -> str:
        """Return the time that was used, in a line; of more than was asked for, what took it."""
        self.enter(self.part)
        asked = "" if self.limit is None else f" of {self.limit:.0f}"
        said = f"time: {self.used:.0f}{asked} s, {self.trained:.0f} s of training on "
        said += f"{self.cores} core{'s' if self.cores > 1 else ''}"
        if self.limit is not None and round(self.used) > round(self.limit):
            took = sorted(self.parts.items(), key=lambda part: -part[1])
            said += "; " + ", ".join(f"{part} {spent:.0f} s" for part, spent in took if spent > 1)
        return said + ("; settled: more time would change little" if self.settled else "")

    def left_in_words(self) -> str:
        """Return the time that is left, in minutes and seconds; without a limit the time used."""
        if self.limit is None:
            return f"{_minutes(self.used)} so far"
        return f"{_minutes(self.left)} left of {_minutes(self.limit)}"


def _minutes(seconds: float) -> str:
    """Return a duration in minutes and seconds."""
    whole, rest = divmod(round(seconds), 60)
    return f"{whole}:{rest:02d}"
