"""Keep when a command began and how long it took to load; a light module, imported first."""

from __future__ import annotations

from splitband.runtime.deadlines import now, process_began

_times: dict[str, float] = {}
"""Times in s, by `runtime.deadlines.now`; empty before a command begins."""


def begin(own_process: bool) -> None:
    """Note that a command begins; with `own_process` it began when the process did."""
    _times["began"] = _times["loaded"] = process_began() if own_process else now()


def loaded() -> None:
    """Note that the modules of the command are loaded."""
    _times["loaded"] = now()


def begin_again(starting: float) -> None:
    """Note that part of a command begins in this process; the command took `starting` s to load."""
    _times["loaded"] = now()
    _times["began"] = _times["loaded"] - starting


def began() -> float:
    """Return when the command began."""
    return _times.get("began") or now()


def starting() -> float:
    """Return how many seconds it took to load the command."""
    return _times.get("loaded", 0.0) - _times.get("began", 0.0)
