"""How long 10,000 records x 10 methods x 3 seeds take on many workers, by a model of a queue.

    python -m benchmarks.scaling [--out FILE.json] [--page docs/scaling.md]

Its costs are measured: a job's overhead, what travels and what the command itself computes by
`benchmarks.cluster`, the times of fits by `splitband compare drill-string`. The scheduler serves
one job after the other; a worker asks for the next one when it has done one. Each record is
compared in two stages, on three quarters of its training part and on all of it, and the second one
waits for the first. The machine of the command reads the record before them, and writes the page
after them.
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
AT_ONCE = 1, 8, 64
"""How many records are compared at once, each in a process of the machine that commands: the last
is what `splitband benchmark` takes on `COMMANDING` cores."""
COMMANDING = 16
"""Cores of that machine, assumed."""
BANDWIDTH = 100e6
"""Bytes a second from and to a scheduler, assumed: a network of 1 Gbit/s."""
BEGIN, END = "<!-- scaling -->\n", "<!-- end of scaling -->\n"
_FEWER = 10
"""One of so many records is simulated; the others take as long."""


def finished(
    jobs: Sequence[float], overhead: float, own: float, workers: int, at_once: int
) -> tuple[float, float]:
    """Return the seconds until `RECORDS / _FEWER` records are compared, and the share of idle time.

    Parameters
    ----------
    jobs : Seconds of each job of a stage, the longest first.
    overhead : Seconds of the scheduler for each job.
    own : Seconds of a core of the machine that commands for each record, half of them before its
        first stage and half after its last.
    workers, at_once : How many workers there are, and how many records at once.
    """
    left = RECORDS // _FEWER
    waiting = [(0.0, 0)] * min(at_once, left)  # when a record goes on, and with which step
    left -= len(waiting)
    free, commanding = [0.0] * workers, [0.0] * COMMANDING
    scheduler = last = 0.0
    while waiting:
        ends, step = heapq.heappop(waiting)
        at = ends
        if step in (0, STAGES + 1):
            ends = max(heapq.heappop(commanding), at) + own / 2
            heapq.heappush(commanding, ends)
        else:
            for seconds in jobs:
                begins = max(heapq.heappop(free), at, scheduler)
                scheduler = begins + overhead
                heapq.heappush(free, scheduler + seconds)
                ends = max(ends, scheduler + seconds)
        last = max(last, ends)
        if step <= STAGES:
            heapq.heappush(waiting, (ends, step + 1))
        elif left:
            left -= 1
            heapq.heappush(waiting, (ends, 0))
    busy = STAGES * (RECORDS // _FEWER) * sum(jobs)
    return last, 1 - busy / (workers * last)


def simulated(cost: dict[str, Any], fits: Sequence[float]) -> dict[str, Any]:
    """What follows from the costs of a job and the seconds of each method's fit."""
    travels = (cost["bytes"]["job"] + cost["bytes"]["result"]) / BANDWIDTH
    overhead, own = cost["two workers"]["empty job, s"] + travels, cost["command, s a record"]
    jobs = sorted([seconds for seconds in fits for _ in range(SEEDS)], reverse=True)
    alone = STAGES * RECORDS * sum(seconds + overhead for seconds in jobs)
    found = {(k, n): finished(jobs, overhead, own, n, k) for k in AT_ONCE for n in WORKERS}
    count = STAGES * RECORDS * len(jobs)
    return {
        "records": RECORDS,
        "methods": len(fits),
        "seeds": SEEDS,
        "jobs": count,
        "mean job, s": sum(jobs) / len(jobs),
        "overhead, s": overhead,
        "command, s a record": own,
        "cores of the command": COMMANDING,
        "jobs a second of the scheduler": 1 / overhead,
        "workers that keep the scheduler busy": sum(jobs) / len(jobs) / overhead,
        "bytes": cost["bytes"],
        "trainings": cost["trainings"],
        "two workers / half of one": cost["two workers / half of one"],
        "results, GB": count * cost["bytes"]["result"] / 1e9,
        "hours of one core": alone / 3600,
        "hours, by records at once and workers": {
            str(k): {str(n): _FEWER * found[k, n][0] / 3600 for n in WORKERS} for k in AT_ONCE
        },
        "idle, by records at once and workers": {
            str(k): {str(n): found[k, n][1] for n in WORKERS} for k in AT_ONCE
        },
    }


def table(facts: dict[str, Any]) -> str:
    """The part of the page that is made of figures."""
    hours = facts["hours, by records at once and workers"]
    idle = facts["idle, by records at once and workers"]
    size = facts["bytes"]
    heading = " | ".join(f"{n:,} worker{'s' * (n > 1)}" for n in WORKERS)
    rows = [f"| records at once | {heading} |", "|---:" * (len(WORKERS) + 1) + "|"]
    for at_once, of in hours.items():
        cells = [f"{_time(of[str(n)])}, {idle[at_once][str(n)]:.0%} idle" for n in WORKERS]
        rows.append(f"| {at_once} | " + " | ".join(cells) + " |")
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
        f"length. The command itself computes {facts['command, s a record']:.1f} s for each record "
        f"on one of {facts['cores of the command']} cores. The results are "
        f"{facts['results, GB']:.0f} GB in all.",
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
