"""When a command began, and how long it took to load; light, as it is asked before that."""

from __future__ import annotations

from dataclasses import dataclass

from splitband.runtime.deadlines import now, process_began


@dataclass
class _Clock:
    """By the clock of `runtime.deadlines.now`; 0 before there is a command."""

    began: float = 0.0
    loaded: float = 0.0


_clock = _Clock()


def begin(own_process: bool) -> None:
    """A command begins: with the process, where that has been started for it."""
    _clock.began = _clock.loaded = process_began() if own_process else now()


def loaded() -> None:
    """The modules of the command are loaded."""
    _clock.loaded = now()


def begin_again(starting: float) -> None:
    """A part of a command begins in another process; the command took `starting` s to load."""
    _clock.loaded = now()
    _clock.began = _clock.loaded - starting


def began() -> float:
    """Return when the command began."""
    return _clock.began or now()


def starting() -> float:
    """Return how many seconds it took to load the command."""
    return _clock.loaded - _clock.began
