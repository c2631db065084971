"""The median of the trainings that are handed out, beside their mean.

    python -m benchmarks.medians [--systems ...] [--seeds 100 101] [--parts FOLDER]

`compare` with its default methods on short driven records (`benchmarks.driven`), which simulates a
test record. Writes docs/benchmarks/medians.json: for each network of several trainings, the errors
of the best and the worst of them, of their mean and of their median, as shares of the deviation.
Records are kept in FOLDER. Beside it, how mean and median compare on the seeds of the paper's
networks, whose predictions docs/results/runs holds.
"""

from __future__ import annotations

import itertools
import json
import statistics
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

import splitband as sb
from benchmarks.driven import drawn, kept, over_records
from reproduction.jobs import Job
from reproduction.runs import as_run
from splitband.metrics import rmse
from splitband.runtime.files import write_json

RUNS = Path("docs/results/runs")
PARTS = Path(tempfile.gettempdir()) / "splitband-medians"
SAMPLES, WORK = 400, 240.0
Errors = dict[str, dict[str, float]]
"""By network, and by what is made of its trainings."""


def measured(name: str, seed: int) -> Errors:
    """Compare the default methods; return the errors of all networks of several trainings."""
    record, test = drawn(name, seed, SAMPLES)
    result = sb.compare(record, tests=[test], setup=sb.Options(search=sb.Search(WORK)))
    found: Errors = {}
    for method, runs in result.runs.items():
        if len(runs) > 1:
            every = np.array([run.tests[0].y for run in runs])
            truth, scale = test.y[-len(every[0]) :], float(test.y.std())
            alone = [rmse(truth, y) / scale for y in every]
            found[method] = {
                "best": min(alone),
                "worst": max(alone),
                "mean": rmse(truth, every.mean(axis=0)) / scale,
                "median": rmse(truth, np.median(every, axis=0)) / scale,
                "trainings": len(runs),
            }
    return found


def ratios(records: Mapping[str, Errors]) -> dict[str, float]:
    """Return how the median's error compares with that of the mean, over all networks."""
    return _summary(
        [of["median"] / of["mean"] for errors in records.values() for of in errors.values()]
    )


def of_the_paper() -> dict[str, float]:
    """Return the same of the forecasts by the seeds of the paper's networks."""
    found = []
    every = sorted(RUNS.glob("*/*/seed*.json"))
    for _, paths in itertools.groupby(every, key=lambda path: path.parent):
        facts = [json.loads(path.read_text(encoding="utf-8")) for path in paths]
        record = Job(**facts[0]["job"]).record
        if len(facts) > 2 and all("forecast" in each for each in facts):
            y = [as_run(each, record).ahead for each in facts]
            truth = record.truth[-len(y[0]) :]
            found.append(rmse(truth, np.median(y, axis=0)) / rmse(truth, np.mean(y, axis=0)))
    return _summary(found)


def _summary(every: Sequence[float]) -> dict[str, float]:
    facts = {"networks": len(every), "lowest": min(every), "highest": max(every)}
    return facts | {"geometric mean": statistics.geometric_mean(every)}


def main() -> None:
    """Measure what is not there yet, and print the ratios."""
    records, out = over_records(
        __doc__, PARTS, Path("docs/benchmarks/medians.json"), kept(measured)
    )
    facts = {"drawn": ratios(records), "paper": of_the_paper()}
    write_json(out, {"samples": SAMPLES, "work": WORK} | facts | {"records": records})
    print(json.dumps(facts, indent=1))


if __name__ == "__main__":
    main()
