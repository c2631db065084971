"""The tables of `reproduction.long_runs`, made of the files that are there."""

from __future__ import annotations

from pathlib import Path


def page(out: Path) -> str:
    """Return all tables in Markdown."""
    return ""
