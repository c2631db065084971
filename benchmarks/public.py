"""Public benchmarks of nonlinear system identification: the plain command by its clock.

    python -m benchmarks.public [--sets tanks silverbox] [--budgets 120 600] [--seeds 5]
    python -m benchmarks.public --no-run

Everything is fitted and chosen on the training file alone; of each test file the first samples are
known, 50 unless a set says otherwise, and the rest is simulated. Budgets are seconds of wall time
on two cores. A seed that is there is not run again; the page docs/results/benchmarks.md is made of
all of them.
"""

from __future__ import annotations

import argparse
from functools import partial
from itertools import product
from pathlib import Path

from benchmarks import plain, public_page
from benchmarks.sets import SETS, load
from splitband import Record


def _measured(
    record: Record, tests: list[Record], initial: int, budget: float, seed: int
) -> plain.Facts:
    return plain.compared(record, tests=tests, initial=initial, budget=budget, seed=seed)


def main() -> None:
    """Measure what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sets", nargs="+", default=[*SETS], choices=[*SETS])
    parser.add_argument("--budgets", nargs="+", type=float, default=[plain.BUDGET, 600.0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--no-run", action="store_true", help="make the page of what is there")
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    given = parser.parse_args()
    for budget, name in [] if given.no_run else product(given.budgets, given.sets):
        of = SETS[name]
        run = partial(_measured, load(of.training), [*map(load, of.tests)], of.initial, budget)
        plain.complete(given.out, name, budget, range(given.seeds), run)
    public_page.write(given.out)


if __name__ == "__main__":
    main()
