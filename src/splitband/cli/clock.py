"""Keep when a command began; a light module, imported first."""

from __future__ import annotations

from splitband.runtime.deadlines import now

_began: dict[str, float] = {}
"""By `runtime.deadlines.now`; empty before a command begins."""


def begin(began: float | None = None) -> None:
    """Note that a command begins, or when it `began`."""
    _began["command"] = began or now()


def began() -> float:
    """Return when the command began."""
    return _began.get("command") or now()
