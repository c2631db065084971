"""How long 10,000 records x 10 methods x 3 seeds take on many workers, by a model of a queue.

    python -m benchmarks.scaling [--out FILE.json] [--page docs/scaling.md]

Its costs are measured: a job's overhead and what travels by `benchmarks.cluster`, the times of
fits by `splitband compare drill-string`. The scheduler serves one job after the other; a worker
asks for the next one when it has done one. Each record is compared in two stages, on three quarters
of its training part and on all of it, and the second one waits for the first.
"""

from __future__ import annotations

import argparse
import heapq
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splitband.runtime.files import replacing, write_json

ROOT = Path(__file__).resolve().parents[1]
RECORDS, SEEDS, STAGES = 10_000, 3, 2
WORKERS = 1, 10, 100, 1000
COMMANDS = 1, 10, 100
"""How many commands share the records and the cluster, each with a part of the list."""
BANDWIDTH = 100e6
"""Bytes a second from and to a scheduler, assumed: a network of 1 Gbit/s."""
BEGIN, END = "<!-- scaling -->\n", "<!-- end of scaling -->\n"
_FEWER = 10
"""One of so many records is simulated; the others take as long."""


def finished(jobs: Sequence[float], overhead: float, workers: int, commands: int) -> float:
    """Seconds until `RECORDS / _FEWER` records are compared.

    Parameters
    ----------
    jobs : Seconds of each job of a stage, the longest first.
    overhead : Seconds of the scheduler for each job.
    workers, commands : How many there are; a command has one record at a time.
    """
    left = RECORDS // _FEWER
    waiting = [0.0] * min(commands, left)
    stages = [(at, 0) for at in waiting]  # when a command goes on, and with which stage
    left -= len(stages)
    heapq.heapify(stages)
    free, scheduler, last = [0.0] * workers, 0.0, 0.0
    while stages:
        at, stage = heapq.heappop(stages)
        ends = at
        for seconds in jobs:
            begins = max(heapq.heappop(free), at, scheduler)
            scheduler = begins + overhead
            heapq.heappush(free, scheduler + seconds)
            ends = max(ends, scheduler + seconds)
        last = max(last, ends)
        if stage + 1 < STAGES:
            heapq.heappush(stages, (ends, stage + 1))
        elif left:
            left -= 1
            heapq.heappush(stages, (ends, 0))
    return last


def simulated(cost: dict[str, Any], fits: Sequence[float]) -> dict[str, Any]:
    """What follows from the costs of a job and the seconds of each method's fit."""
    travels = (cost["bytes"]["job"] + cost["bytes"]["result"]) / BANDWIDTH
    overhead = cost["two workers"]["empty job, s"] + travels
    jobs = sorted([seconds for seconds in fits for _ in range(SEEDS)], reverse=True)
    alone = STAGES * RECORDS * sum(seconds + overhead for seconds in jobs)
    hours = {
        str(commands): {
            str(n): _FEWER * finished(jobs, overhead, n, commands) / 3600 for n in WORKERS
        }
        for commands in COMMANDS
    }
    count = STAGES * RECORDS * len(jobs)
    return {
        "records": RECORDS,
        "methods": len(fits),
        "seeds": SEEDS,
        "jobs": count,
        "mean job, s": sum(jobs) / len(jobs),
        "overhead, s": overhead,
        "jobs a second of the scheduler": 1 / overhead,
        "workers that keep the scheduler busy": sum(jobs) / len(jobs) / overhead,
        "bytes": cost["bytes"],
        "trainings": cost["trainings"],
        "two workers / half of one": cost["two workers / half of one"],
        "results, GB": count * cost["bytes"]["result"] / 1e9,
        "hours of one core": alone / 3600,
        "hours, by commands and workers": hours,
    }


def table(facts: dict[str, Any]) -> str:
    """The part of the page that is made of figures."""
    hours = facts["hours, by commands and workers"]
    size = facts["bytes"]
    heading = " | ".join(f"{n:,} worker{'s' * (n > 1)}" for n in WORKERS)
    rows = [f"| commands at once | {heading} |", "|---:" * (len(WORKERS) + 1) + "|"]
    for commands, of in hours.items():
        rows.append(f"| {commands} | " + " | ".join(_time(of[str(n)]) for n in WORKERS) + " |")
    return "\n".join([
        f"{facts['records']:,} records x {facts['methods']} methods x {facts['seeds']} seeds, each "
        f"fitted on three quarters of the training part and on all of it, are {facts['jobs']:,} "
        f"jobs of {facts['mean job, s']:.1f} s on average:",
        "",
        *rows,
        "",
        f"A job costs the scheduler {1000 * facts['overhead, s']:.1f} ms, so that it can serve "
        f"{facts['jobs a second of the scheduler']:.0f} jobs a second, which is what "
        f"{facts['workers that keep the scheduler busy']:,.0f} workers do with jobs of this "
        f"length. The results are {facts['results, GB']:.0f} GB in all.",
        "",
        f"Measured: {size['shared'] / 1e3:.0f} kB go to each worker once, for all jobs of a stage; "
        f"{size['job']} bytes with each job, and {size['result'] / 1e3:.0f} kB come back. "
        f"{facts['trainings']} trainings by two workers of one thread took "
        f"{facts['two workers / half of one']:.2f} times half of what they took by one.",
        "",
    ])  # fmt: skip


def _time(hours: float) -> str:
    return f"{hours / 24:,.0f} days" if hours >= 72 else f"{hours:.1f} h"


def costs() -> tuple[dict[str, Any], list[float]]:
    """What has been measured: of a job, and the seconds of each method's fit."""
    cost = json.loads((ROOT / "docs/benchmarks/cluster.json").read_text(encoding="utf-8"))
    compared = json.loads((ROOT / "docs/results/drill-string.json").read_text(encoding="utf-8"))
    fits = [sum(m["seconds"]) / len(m["seconds"]) for m in compared["methods"].values()]
    return cost, fits


def main() -> None:
    """Simulate, and write the figures and the part of the page that states them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "docs/benchmarks/scaling.json")
    parser.add_argument("--page", type=Path, default=ROOT / "docs/scaling.md")
    arguments = parser.parse_args()
    facts = simulated(*costs())
    write_json(arguments.out, facts)
    before, _, rest = arguments.page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    with replacing(arguments.page) as temporary:
        temporary.write_text(before + BEGIN + table(facts) + END + after, encoding="utf-8")
    print(table(facts))


if __name__ == "__main__":
    main()
