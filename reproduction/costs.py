"""How long the runs of a table would take that are not there yet."""

from __future__ import annotations

import json
import statistics
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from reproduction import published
from reproduction.jobs import ORACLE, Job
from reproduction.runs import missing
from splitband.comparison.methods import QUICK


@dataclass(frozen=True)
class Progress:
    """How far the runs of a table are.

    Attributes
    ----------
    there, needed : Runs with all of the paper's epochs.
    seconds : Of the missing ones together, one after another.
    measured : Whether all of that is estimated from finished runs, of any number of epochs, in the
        same folder; otherwise some of it is the paper's own run time.
    """

    there: int
    needed: int
    seconds: float
    measured: bool


def progress(jobs: Iterable[Job], folder: Path) -> Progress:
    """Count the jobs that have a file in `folder`, and estimate the others."""
    needed = list(dict.fromkeys(jobs))
    todo = missing(needed, folder)
    measured = cache(lambda system, method: _seconds_per_epoch(folder / system / method))
    seconds, known = 0.0, True
    for job in todo:
        if job.method in (*QUICK, ORACLE):
            continue
        one = measured(job.system, job.method)
        known = known and one is not None
        one = _papers_seconds_per_epoch(job) if one is None else one
        seconds += one * (job.epochs or job.full_epochs)
    return Progress(len(needed) - len(todo), len(needed), seconds, known)


def _seconds_per_epoch(folder: Path) -> float | None:
    """The median over the finished runs of a method, or None where there is none to go by.

    By the time of their core, if some say it: by the clock, runs that had to wait take longer.
    """
    found: dict[str, list[float]] = {"cpu_seconds": [], "seconds": []}
    for path in folder.glob("*.json"):
        facts = json.loads(path.read_text(encoding="utf-8"))
        if "resumed" in facts:
            continue
        for clock, of_clock in found.items():
            if clock in facts:
                of_clock.append(facts[clock] / facts["settings"]["settings"]["epochs"])
    return next((statistics.median(of) for of in found.values() if of), None)


def _papers_seconds_per_epoch(job: Job) -> float:
    """From the run times that the paper reports; a simulated record costs what its model does."""
    system = job.system.removesuffix("-simulated").removesuffix("-noisy")
    tables = (published.SECONDS, published.SECONDS_RNN, published.SECONDS_GRU)
    row = {method: value for table in tables for method, value in table.get(system, {}).items()}
    return row[job.method].mean / job.full_epochs
