"""Write the files of results; results.json has all numbers and all settings to reproduce them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from splitband.checks.inspection import Inspection
from splitband.checks.model import ModelCheck
from splitband.checks.responses import Responses, of_stable_plant
from splitband.comparison.backtest import Fit
from splitband.comparison.result import Comparison
from splitband.comparison.running import RunningComparison
from splitband.forecasters import saving
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import time_header
from splitband.records.timing import as_json
from splitband.report.environment import environment
from splitband.report.page import NAME as PAGE
from splitband.report.page.parts import Usage
from splitband.report.predictions import Predicted, predicted
from splitband.report.tables import columns, tried
from splitband.runtime.deadlines import now
from splitband.runtime.files import replacing
from splitband.runtime.outputs import MODEL_FOLDER, TEST_PREDICTIONS, staged, write_facts

Facts = dict[str, Any]
MOST_ROWS = 100_000
"""Largest number of samples of a record with a row for every sample. Bounds the time of writing."""


def save(
    comparison: Comparison,
    folder: Path,
    facts: dict[str, Any] | None = None,
    usage: Usage | None = None,
) -> None:
    """Write all files of a comparison in place of an earlier result; after an error none.

    The files are predictions.csv, one such file per test record, the page, the trained model, and
    results.json, with `facts` first. The page shows `usage`.
    """
    with staged(folder) as new:
        began = now()
        every, tests = predicted(comparison), len(comparison.tests)
        tables = {TEST_PREDICTIONS.format(i + 1): [every[i]] for i in range(tests)}
        for name, shown in {**tables, "predictions.csv": every[tests:]}.items():
            write_csv(new / name, samples(shown, comparison.recommended))
        # Tables of a long record take longest; their time grows with the number of results.
        coming = len(comparison.plan.methods) - len(comparison.require_trial().failed)
        further = (now() - began) * max(coming / len(comparison.fits) - 1, 0)
        page = _page()
        page.of_comparison(comparison, new / PAGE, usage)
        comparison.model.save(new / MODEL_FOLDER)
        comparison.clock.writing = now() - began + further
        numbers = results(comparison) | {"time": comparison.clock.as_json()}
        write_facts(new, (facts or {}) | numbers)


def _page() -> ModuleType:
    """Import the module of pages, only here: its libraries load slowly."""
    from splitband.report.page import document  # noqa: PLC0415

    return document


def save_unfinished(state: RunningComparison, folder: Path, facts: dict[str, Any]) -> None:
    """Write the best model so far in place of an earlier result; after an error nothing.

    results.json has the held-out errors so far, and `unfinished`.
    """
    trial, record = state.trial, state.plan.record
    with staged(folder) as new:
        model = state.model
        samples = len(model.require_fitted().record)
        marked = {"unfinished": state.doing, "trained_on": f"the first {samples} samples"}
        saving.save(model, new / MODEL_FOLDER, marked)
        numbers = {
            "unfinished": state.doing,
            "recommended": trial.recommended,
            "table": [c.as_json() for c in tried(trial, record, [*trial.errors])],
            "time": state.clock.as_json(),
            "environment": environment(),
        }
        write_facts(new, facts | numbers)


def results(comparison: Comparison) -> dict[str, Any]:
    """Return the content of results.json by `compare`.

    `table` has the displayed errors of the median over seeds, by channel. Errors in `methods` are
    over all channels: the root of the sum of squares.
    """
    record, trial = comparison.record, comparison.require_trial()
    return {
        "inputs_beyond_training": [asdict(u) for u in comparison.inputs_beyond_training],
        "record": {
            "name": record.name,
            "samples": len(record),
            "sampling_time": record.sampling_time,
            "start": as_json(record.start),
            "columns": list(record.columns),
            "units": list(record.units),
            "inputs": record.nu,
            "gaps": 0 if record.measured is None else int((~record.complete).sum()),
            "reading": asdict(record.reading),
            "truth": "measured" if record.y_true is None else "noise-free",
        },
        **({"tests": [*_test_facts(comparison)]} if comparison.tests else {}),
        "settings": comparison.plan.as_json(),
        "warnings": comparison.warnings,
        "interrupted": comparison.interrupted,
        "residual_tests": [test.as_json() for test in comparison.residual_tests],
        "recommended": trial.recommended,
        "table": [c.as_json() for c in columns(comparison)],
        "search": [asdict(attempt) for attempt in comparison.attempts],
        "methods": {
            name: _method(comparison, name)
            | {
                "score": trial.penalized_score(name),
                "held_out_rmse": math.hypot(*trial.errors[name]),
                "interval": _interval(comparison, name),
                "median_of_seeds": _errors(comparison, comparison.medians[name]),
            }
            for name in comparison.fits
        }
        | {name: {"failed": reason} for name, reason in trial.failed.items()},
        "environment": environment(),
    }


def samples(every: Sequence[Predicted], recommended: str) -> pd.DataFrame:
    """Return a record and the predictions of its last samples, one row per sample.

    There is a column by channel, and one by channel, method and protocol: the median over seeds,
    empty before the prediction. The interval of the recommended method's forecast has columns, too.
    For a long record only the samples of the first protocol have rows.
    """
    record = every[0].record
    rows = min(every[0].steps, len(record)) if len(record) > MOST_ROWS else len(record)
    table: dict[str, Any] = {time_header(record.columns): record.stamps[-rows:]}
    for i, column in enumerate(record.columns):
        table[column] = record.y_with_gaps[-rows:, i]
        for runs in every:
            what = "forecast" if runs.protocol == "forecast" else "from start"
            for name, p in runs.predictions.items():
                edges = {"lower": p.lower, "upper": p.upper} if name == recommended else {}
                for label, y in ({what: p.y} | edges).items():
                    if y is not None:
                        values = np.full(rows, np.nan)
                        values[max(rows - len(y), 0) :] = y[-rows:, i]
                        table[f"{column}, {name}, {label}"] = values
    return pd.DataFrame(table, copy=False)


def write_csv(path: Path, table: pd.DataFrame) -> None:
    """Write a table as CSV, with equal line ends on all systems."""
    with replacing(path) as new:
        table.to_csv(new, index=False, lineterminator="\n", compression=None)


class Checked(NamedTuple):
    """A check of a model, the model, and its responses to steps."""

    check: ModelCheck
    model: Forecaster
    responses: Sequence[Responses]


def save_check(checked: Mapping[str, Checked], facts: Facts, folder: Path, used: Usage) -> None:
    """Write results.json, with `facts` first, and the page of checks of models by their folders."""
    every, pages = {name: _check_facts(*each) for name, each in checked.items()}, _page().pages
    first, *others = checked.values()
    if others:
        shown = pages.of_checks({name: each.check for name, each in checked.items()}, used)
    else:
        shown = pages.of_check(*first, used)
    facts = facts | ({"models": every} if others else _check_facts(*first))
    with staged(folder) as new:
        _page().write(shown, new / PAGE)
        write_facts(new, facts | {"environment": environment()})


def _check_facts(check: ModelCheck, model: Forecaster, responses: Sequence[Responses]) -> Facts:
    """Return what results.json says of a check of a model."""
    facts = check.as_json() | {"kind": model.in_words()}
    if responses and of_stable_plant(model):
        first = responses[0]
        facts["static_gain"] = {
            column: dict(zip(first.inputs, map(_or_none, row), strict=True))
            for column, row in zip(first.columns, first.gains, strict=True)
        }
    return facts


def _or_none(gain: float) -> float | None:
    """Return a number for JSON: None of an integrator, and of what has not settled."""
    return float(gain) if math.isfinite(gain) else None


def save_inspection(found: Inspection, facts: Facts, folder: Path, used: Usage) -> None:
    """Write results.json, with `facts` first, and the page of an inspection, over earlier ones."""
    page = _page()
    with staged(folder) as new:
        page.write(page.pages.of_inspection(found, used), new / PAGE)
        write_facts(new, facts | found.as_json())


def _test_facts(comparison: Comparison) -> Iterator[dict[str, Any]]:
    for i, test in enumerate(comparison.tests, 1):
        facts = {"name": test.name, "samples": len(test), "start": as_json(test.start)}
        yield facts | {"columns": list(test.columns), "predictions": TEST_PREDICTIONS.format(i)}


def _interval(comparison: Comparison, name: str) -> dict[str, Any]:
    """Return a forecast's interval, and its coverage of the measured samples."""
    interval = asdict(comparison.require_trial().intervals[name])
    covered = {"covers": comparison.covers(name)} if comparison.steps_of_interval(name) else {}
    return interval | covered


def _errors(comparison: Comparison, fit: Fit) -> dict[str, Any]:
    """Return the errors of a fit over all channels, by protocol."""
    errors = comparison.errors(fit)
    facts: dict[str, Any] = {"total_rmse": errors.total}
    facts |= {} if fit.forecast is None else {"forecast_rmse": errors.forecast}
    return facts | ({"test_rmse": [*errors.tests]} if fit.tests else {})


def _method(comparison: Comparison, name: str) -> dict[str, Any]:
    fits: Sequence[Fit] = comparison.fits[name]
    first, errors = fits[0], [_errors(comparison, fit) for fit in fits]
    facts: dict[str, Any] = {
        "seeds": [fit.seed for fit in fits],
        **{key: [of_fit[key] for of_fit in errors] for key in errors[0]},
        "seconds": [fit.report.seconds for fit in fits],
    }
    for error in ("total_rmse", "forecast_rmse"):
        if error not in facts:
            continue
        values = facts[error]
        spread = statistics.stdev(values) if len(values) > 1 else None
        facts[f"{error}_mean"], facts[f"{error}_std"] = statistics.mean(values), spread
    if (left := comparison.leaves(name)) is not None:
        facts["leaves_training_range_after"] = left
    if first.description:
        facts["description"] = first.description
    if first.report.parameters:
        facts["parameters"] = first.report.parameters
    if first.report.losses:
        of_fits = [fit.report.losses for fit in fits]
        facts["final_loss"] = [{k: v[-1] for k, v in losses.items()} for losses in of_fits]
    return facts
