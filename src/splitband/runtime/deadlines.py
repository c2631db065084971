"""Limit work by deadlines of the wall clock, common to all processes and machines."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


def now() -> float:
    """Return the wall-clock time in s; all deadlines use this clock."""
    return time.time()


class DeadlineError(Exception):
    """The deadline of a job has passed before its result."""

    def __init__(self) -> None:
        super().__init__("the time was over before its fit was done")


@dataclass(frozen=True, order=True)
class Deadline:
    """The time `at` in s, by the clock of `now`, at which work stops; by default never."""

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
    """Return the deadline of this thread's job."""
    return _current.get()


@contextmanager
def within(deadline: Deadline) -> Iterator[None]:
    """Set the deadline of the work in this context; trainings check it at every step."""
    token = _current.set(deadline)
    try:
        yield
    finally:
        _current.reset(token)


def check() -> None:
    """Raise `DeadlineError` if the deadline of this thread's job has passed."""
    if _current.get().over:
        raise DeadlineError
