"""Limit the time of work by the wall clock, which all processes and machines share."""

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
    """Return the wall clock's time, in s; all that keeps a deadline asks it here."""
    return time.time()


class OverError(Exception):
    """Report that the time of a job is over, and that it has nothing to hand out."""

    def __init__(self) -> None:
        super().__init__("the time was over before its fit was done")


def process_began() -> float:
    """Return when this process was started, by the clock of `now`; elsewhere than on Linux roughly.

    There it is taken to have computed since then without a break.
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
    """Say when work has to end with what there is; by default never.

    `at`: by the clock of `now`, in s.
    """

    at: float = math.inf

    @classmethod
    def after(cls, seconds: float | None) -> Deadline:
        """Return the deadline so many seconds from now; None is no deadline."""
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
        """Return the deadline so many seconds before this one."""
        return Deadline(self.at - seconds)


NEVER = Deadline()
_current: ContextVar[Deadline] = ContextVar("deadline", default=NEVER)


def current() -> Deadline:
    """Return the deadline of the job that runs in this thread."""
    return _current.get()


@contextmanager
def within(deadline: Deadline) -> Iterator[None]:
    """Let what runs in here end by a deadline; trainings look at it step by step."""
    token = _current.set(deadline)
    try:
        yield
    finally:
        _current.reset(token)


def check() -> None:
    """Raise `OverError` where the deadline of the job that runs in this thread has passed."""
    if _current.get().over:
        raise OverError
