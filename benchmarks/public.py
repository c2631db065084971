"""Public benchmarks of nonlinear system identification: the default command, and longer budgets.

    python -m benchmarks.public [--sets tanks,silverbox] [--budgets 0,1,2,5,10] [--jobs 2]
    python -m benchmarks.public --no-run

Everything is fitted and chosen on the training file alone; of each test file the first samples are
known, 50 unless a set says otherwise, and the rest is simulated. A budget of 0 is that of
`splitband compare` without --budget, the others are minutes of two cores. Results that are there
already are not computed again, and what was cut off goes on; the page docs/results/benchmarks.md is
made of them.
"""

from __future__ import annotations

import argparse
import shutil
import time
from pathlib import Path
from typing import Any

import splitband as sb
from benchmarks import public_page
from benchmarks.public_page import CORES, IN_TRAINING, errors_of
from benchmarks.sets import SETS, Benchmark, load
from splitband.evaluation.search import Search
from splitband.evaluation.setup import Options
from splitband.evaluation.work import Work
from splitband.report.results import results
from splitband.runtime.files import CHECKPOINTS, write_json


def measure(benchmark: Benchmark, minutes: float, jobs: int, checkpoints: Path) -> dict[str, Any]:
    """What one budget comes to: the command's results, and how long it took."""
    record = load(benchmark.training)
    tests = [load(test) for test in benchmark.tests]
    # As work, and not as time: the errors do not depend on what else the machine does.
    effort = Search(IN_TRAINING * 60 * minutes * CORES) if minutes else Search()
    options = Options(search=effort, initial=benchmark.initial)
    setup = options.decided(record, len(record))
    began = time.perf_counter()
    comparison = sb.compare(
        record, tests=tests, setup=setup, train=len(record), work=Work(jobs, None, checkpoints)
    )
    facts = results(comparison)
    return {"minutes": minutes, "jobs": jobs, "seconds": time.perf_counter() - began} | facts


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--budgets", default="0,1,2,5,10", help="minutes; 0 is the default budget")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--disturbed", action="store_true", help="the machine does other work: say so of seconds"
    )
    parser.add_argument("--no-run", action="store_true", help="make the page of what is there")
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    missing = [] if arguments.no_run else arguments.budgets.split(",")
    for minutes in map(float, missing):
        for name in arguments.sets.split(","):
            path = out / f"{name}-{minutes:g}.json"
            if path.exists():
                continue
            checkpoints = out / CHECKPOINTS / path.stem
            facts = measure(SETS[name], minutes, arguments.jobs, checkpoints)
            write_json(path, facts | {"disturbed": arguments.disturbed})
            shutil.rmtree(out / CHECKPOINTS)
            print(f"{path.stem}: {facts['recommended']}", *errors_of(SETS[name], facts), flush=True)
    public_page.write(out)


if __name__ == "__main__":
    main()
