"""Which trainings count: three rules for those that failed.

    python -m benchmarks.failed [--systems ...] [--seeds 100 101 102 103] [--parts FOLDER]

`compare` with its default work and two networks on short driven records (`benchmarks.driven`),
which simulates a test record. Writes docs/benchmarks/failed.json: errors on the test record as
shares of its deviation, of the median of the trainings that each of the `RULES` keeps. Records are
kept in FOLDER.
"""

from __future__ import annotations

import json
import statistics
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import splitband as sb
from benchmarks.driven import drawn, kept, over_records
from splitband.evaluation.jobs import FAILED
from splitband.evaluation.protocols import error_from_start
from splitband.forecasters.backtest import Backtest
from splitband.metrics import rmse
from splitband.runtime.files import write_json

PARTS = Path(tempfile.gettempdir()) / "splitband-failed"
SAMPLES, WORK, METHODS = 400, 240.0, ("state-space", "gru")
RULES: dict[str, Callable[[Sequence[float]], float]] = {
    "within twice the lowest error": min,
    "within twice the median error": statistics.median_low,
    "all": max,
}
"""By what the errors on the training record are compared with; of stable trainings."""
Errors = dict[str, dict[str, float]]
"""By network, and by rule."""


def measured(name: str, seed: int) -> Errors:
    """Compare networks, none of whose trainings is left out; return the errors by rule."""
    record, test = drawn(name, seed, SAMPLES)
    setup = sb.Options(search=sb.Search(WORK))

    fits: dict[str, dict[int, Backtest]] = {}

    def all_of_them(_: sb.Record, done: dict[str, dict[int, Backtest]]) -> Any:
        fits.update(done)
        return done, {}

    with patch("splitband.evaluation.run.without_failed", all_of_them):
        result = sb.compare(record, methods=METHODS, tests=[test], setup=setup)
    found: Errors = {}
    for method, runs in result.runs.items():
        sound = [run for run in runs if run.fit.stable] or runs
        if len(sound) > 1:
            errors = [error_from_start(fits[method][run.seed], record) for run in sound]
            simulated = np.array([run.tests[0].y for run in sound])
            truth = test.y[-simulated.shape[1] :]
            found[method] = {"trainings": len(sound)}
            for rule, usual in RULES.items():
                within = np.array(errors) <= FAILED * usual(errors)
                median = np.median(simulated[within], axis=0)
                found[method][rule] = rmse(truth, median) / float(test.y.std())
    return found


def main() -> None:
    """Measure what is not there yet, and print geometric means over records and networks."""
    records, out = over_records(__doc__, PARTS, Path("docs/benchmarks/failed.json"), kept(measured))
    every = [errors for of in records.values() for errors in of.values()]
    means = {rule: statistics.geometric_mean(each[rule] for each in every) for rule in RULES}
    write_json(out, {"networks": len(every), "means": means, "records": records})
    print(json.dumps(means, indent=1))


if __name__ == "__main__":
    main()
