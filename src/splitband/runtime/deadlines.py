"""Limit work by deadlines of the wall clock, which all processes and machines share."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path


def now() -> float:
    """Return the wall-clock time in s; all deadlines use this clock."""
    return time.time()


class DeadlineError(Exception):
    """Report that the deadline of a job passed before it had a result."""

    def __init__(self) -> None:
        super().__init__("the time was over before its fit was done")


def process_began() -> float:
    """Return when this process was started, by the clock of `now`; only roughly outside Linux.

    There it is estimated from the CPU time, as if the process had never been idle.
    """
    try:
        said = Path("/proc/self/stat").read_text(encoding="ascii")
        ticks = float(said.rpartition(")")[2].split()[19])
        uptime = float(Path("/proc/uptime").read_text(encoding="ascii").split()[0])
        return now() - max(uptime - ticks / os.sysconf("SC_CLK_TCK"), 0.0)
    except (OSError, ValueError, IndexError):
        return now() - time.process_time()


@dataclass(frozen=True, order=True)
class Deadline:
    """Hold the time at which work has to stop and return what it has; by default never.

    `at` is in s, by the clock of `now`.
    """

    at: float = math.inf

    @classmethod
    def after(cls, seconds: float | None) -> Deadline:
        """Return the deadline `seconds` from now; None means no deadline."""
        return cls(math.inf if seconds is None else now() + seconds)

    @property
    def left(self) -> float:
        """Return the seconds until the deadline, negative afterwards."""
        return self.at - now()

    @property
    def over(self) -> bool:
        """Return whether the deadline has passed."""
        return self.left <= 0

    def earlier(self, seconds: float) -> Deadline:
        """Return the deadline `seconds` before this one."""
        return Deadline(self.at - seconds)


NEVER = Deadline()
_current: ContextVar[Deadline] = ContextVar("deadline", default=NEVER)


def current() -> Deadline:
    """Return the deadline of the job that runs in this thread."""
    return _current.get()


@contextmanager
def within(deadline: Deadline) -> Iterator[None]:
    """Set the deadline of what runs in this context; trainings check it at each step."""
    token = _current.set(deadline)
    try:
        yield
    finally:
        _current.reset(token)


def check() -> None:
    """Raise `DeadlineError` if the deadline of the job that runs in this thread has passed."""
    if _current.get().over:
        raise DeadlineError
