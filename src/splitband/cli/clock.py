"""Keep when a command began; a light module, imported first."""

from __future__ import annotations

import time

from splitband.runtime.deadlines import now

_began: dict[str, float] = {}
"""By `runtime.deadlines.now`; empty before a command begins."""


def begin(own_process: bool) -> None:
    """Note that a command begins; with `own_process` it began when the process did.

    What the interpreter has done before is its CPU time so far.
    """
    _began["command"] = now() - (time.process_time() if own_process else 0.0)


def began() -> float:
    """Return when the command began."""
    return _began.get("command") or now()
