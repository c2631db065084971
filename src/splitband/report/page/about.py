"""What every page says of the record, and of how it was made."""

from __future__ import annotations

from splitband.data import Record
from splitband.report.page.parts import Section
from splitband.report.page.usage import Usage
from splitband.report.results import environment


def lead(record: Record) -> str:
    """The record in a line."""
    every = f"{record.sampling_time:.6g} s"
    said = f"{len(record):,} samples every {every}, measured: {', '.join(record.columns)}"
    return said + (f"; known inputs: {', '.join(record.inputs)}" if record.nu else "")


def settings(facts: list[tuple[str, str]], used: Usage) -> Section:
    """What the numbers were made with."""
    made = environment()
    pairs = [("command", used.asked)] if used.asked else []
    versions = ", ".join(f"{name} {v}" for name, v in made["versions"].items())
    pairs += [*facts, ("versions", versions), ("machine", made["machine"])]
    pairs += [("commit", made["commit"])] if made["commit"] else []
    return Section("settings", "Settings and versions", facts=pairs, folded=True)
