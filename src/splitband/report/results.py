"""Write the files of results; results.json has all numbers and what is needed to reproduce them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd

from splitband.data import Record
from splitband.data.timing import as_json
from splitband.evaluation.budget import Phase
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.protocols import Run
from splitband.evaluation.saved_settings import SavedSettings
from splitband.forecasters.base import Forecaster
from splitband.forecasters.checking import ModelCheck
from splitband.forecasters.prediction import time_header
from splitband.forecasters.responses import Responses
from splitband.report.environment import environment
from splitband.report.page.parts import Usage
from splitband.report.table import columns, tried
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import now
from splitband.runtime.files import replacing
from splitband.runtime.outputs import TEST_PREDICTIONS, staged, write_facts

FOUND = "recommended.json"
"""File with the settings of the recommended network, for `--settings`."""
MODEL_FOLDER = "model"
"""Folder with the recommended method as it was trained, for `simulate`."""


def save(
    comparison: Comparison,
    folder: Path,
    facts: dict[str, Any] | None = None,
    usage: Usage | None = None,
) -> None:
    """Write all files of a comparison in place of an earlier result; on an error none of them.

    They are predictions.csv and one for each test record, rollouts.png, the page, the trained
    model, recommended.json if a network is recommended, and results.json, in which `facts` come
    first. `usage` is shown on the page.
    """
    with staged(folder) as new:
        began = now()
        tables = {"predictions.csv": predictions(comparison)}
        for i in range(len(comparison.tests)):
            tables[TEST_PREDICTIONS.format(i + 1)] = predictions_of_test(comparison, i)
        for name, table in tables.items():
            with replacing(new / name) as temporary:
                table.to_csv(temporary, index=False)
        pictures, page = _drawing()
        pictures.save(pictures.rollouts(comparison), new / "rollouts.png")
        page.of_comparison(comparison, new / page.NAME, usage)
        save_settings(comparison.forecaster(), comparison.record, new)
        comparison.model.save(new / MODEL_FOLDER)
        comparison.time.phases["writing"] = Phase(now() - began)
        found = results(comparison) | {"time": comparison.time.as_json()}
        write_facts(new, (facts or {}) | found)


def _drawing() -> tuple[ModuleType, ModuleType]:
    """Import the modules that draw pictures and pages, only here: their libraries load slowly."""
    pictures, page = "splitband.report.pictures", "splitband.report.page.document"
    return import_module(pictures), import_module(page)


def settings_path(forecaster: Forecaster, folder: Path) -> Path | None:
    """Return the file with the settings of a recommended network; None for another method."""
    return None if SavedSettings.of_forecaster(forecaster) is None else folder / FOUND


def save_settings(forecaster: Forecaster, record: Record, folder: Path) -> None:
    """Write the settings of a recommended network, for --settings; nothing for another method."""
    saved = SavedSettings.of_forecaster(forecaster)
    if saved is not None:
        saved.for_record(record).save(folder / FOUND)


def results(comparison: Comparison) -> dict[str, Any]:
    """Return what `compare` writes to results.json.

    `table` has the errors of the median over seeds, by channel, as they are shown. Errors in
    `methods` are over all channels: the root of the sum of their squares.
    """
    record, trial = comparison.record, comparison.require_trial()
    return {
        "inputs_beyond_training": [asdict(each) for each in comparison.inputs_beyond_training],
        "record": {
            "name": record.name,
            "samples": len(record),
            "sampling_time": record.sampling_time,
            "start": as_json(record.start),
            "columns": list(record.columns),
            "units": list(record.units),
            "inputs": record.nu,
            "gaps": 0 if record.measured is None else int((~record.complete).sum()),
            "truth": "measured" if record.y_true is None else "noise-free",
        },
        **({"tests": _test_facts(comparison)} if comparison.tests else {}),
        "settings": comparison.setup.as_json(),
        "residual_tests": [asdict(test) for test in comparison.residual_tests()],
        "recommended": trial.recommended,
        # Without seconds, which are below, so that the same comparison has the same table.
        "table": [c.as_json() for c in columns(comparison) if c.unit != "seconds"],
        "search": [asdict(attempt) for attempt in comparison.attempts],
        "methods": {
            name: _method(of_method)
            | {
                "score": trial.worth(name),
                "held_out_rmse": math.hypot(*trial.errors[name]),
                "interval": _interval(comparison, name),
                "median_of_seeds": _median(comparison, name),
            }
            for name, of_method in comparison.runs.items()
        }
        | {name: {"failed": reason} for name, reason in trial.failed.items()},
        "environment": environment(),
    }


def predictions(comparison: Comparison) -> pd.DataFrame:
    """Return the record and the predictions, a row for each sample.

    There is a column for each channel, and one for each channel, method and protocol: the median
    over seeds, empty before the prediction begins. The interval of the recommended method's
    forecast has columns, too.
    """
    sides: dict[str, Array] = {}
    for name, run in comparison.medians.items():
        sides[f"{name}, from start"] = run.from_start.y
        forecast = comparison.predictions.get(name)
        sides |= {} if forecast is None else {f"{name}, forecast": forecast.y}
        if name == comparison.recommended and forecast is not None:
            assert forecast.lower is not None
            assert forecast.upper is not None
            sides |= {f"{name}, lower": forecast.lower, f"{name}, upper": forecast.upper}
    return _beside(comparison.record, sides)


def predictions_of_test(comparison: Comparison, number: int) -> pd.DataFrame:
    """Return a test record and its simulations, as `predictions` does."""
    medians = {name: run for name, run in comparison.medians.items() if run.tests}
    sides = {f"{name}, from start": run.tests[number].y for name, run in medians.items()}
    return _beside(comparison.tests[number], sides)


def _beside(record: Record, predicted: Mapping[str, Array]) -> pd.DataFrame:
    """Return a table of a record and of predictions of its last samples, by name."""
    table: dict[str, Any] = {time_header(record.columns): record.stamps}
    for i, column in enumerate(record.columns):
        table[column] = record.seen[:, i]
        for name, y in predicted.items():
            values = np.full(len(record), np.nan)
            values[len(record) - len(y) :] = y[:, i]
            table[f"{column}, {name}"] = values
    return pd.DataFrame(table)


def save_check(
    check: ModelCheck, folder: Path, kind: str, responses: Responses | None, usage: Usage
) -> None:
    """Write results.json and the page of a check of a model in place of an earlier result.

    `kind` describes the model in words.
    """
    _, page = _drawing()
    facts = check.as_json() | {"kind": kind, "command": usage.asked}
    if responses is not None:
        facts["static_gain"] = {
            column: dict(zip(responses.inputs, map(float, row), strict=True))
            for column, row in zip(responses.columns, responses.y[-1], strict=True)
        }
    with staged(folder) as new:
        page.of_check(check, new / page.NAME, kind, responses, usage)
        write_facts(new, facts | {"environment": environment()})


def save_forecast(result: Forecast, folder: Path, usage: Usage | None = None) -> None:
    """Write all files of a forecast in place of an earlier result; on an error none of them.

    They are forecast.csv, its picture, the page, the trained model, recommended.json if it is a
    network, and results.json. `usage` is shown on the page.
    """
    pictures, page = _drawing()
    with staged(folder) as new:
        with replacing(new / "forecast.csv") as temporary:
            result.prediction.to_frame().to_csv(temporary, index=False)
        drawn = pictures.prediction(result.prediction, result.record, result.method)
        pictures.save(drawn, new / "forecast.png")
        page.of_forecast(result, new / page.NAME, usage)
        save_settings(result.forecaster, result.record, new)
        result.model.save(new / MODEL_FOLDER)
        facts = forecast_facts(result) | {"time": result.time.as_json()}
        write_facts(new, facts)


def forecast_facts(result: Forecast) -> dict[str, Any]:
    """Return what `forecast` writes to results.json."""
    record, trial = result.record, result.trial
    return {
        "record": record.name,
        "samples": len(record),
        "gaps": int((~record.complete).sum()),
        "more": [other.name for other in result.plan.others],
        "leaves_training_range_after": result.leaves,
        "inputs_beyond_training": [asdict(each) for each in result.inputs_beyond_training],
        "steps": len(result.prediction),
        "method": result.method,
        "description": result.description,
        "table": [c.as_json() for c in tried(trial, record, [*trial.errors])],
        "held_out_rmse": {name: math.hypot(*each) for name, each in trial.errors.items()},
        "failed": dict(trial.failed),
        "interval": asdict(trial.intervals[result.method]),
        "seeds": [*result.seeds],
        "environment": environment(),
    }


def _test_facts(comparison: Comparison) -> list[dict[str, Any]]:
    return [
        {
            "name": test.name, "samples": len(test), "start": as_json(test.start),
            "columns": list(test.columns), "predictions": TEST_PREDICTIONS.format(i + 1),
        }
        for i, test in enumerate(comparison.tests)
    ]  # fmt: skip


def _interval(comparison: Comparison, name: str) -> dict[str, Any]:
    """Return a forecast's interval, and the share of the measured samples that it covers."""
    interval = comparison.require_trial().intervals[name]
    ahead = len(comparison.medians[name].ahead)
    if not ahead:
        return asdict(interval)
    mean = interval.half_widths(ahead).mean(axis=0)
    return asdict(interval) | {
        "covers": comparison.covers(name),
        "mean_half_width": mean.tolist(),
    }


def _median(comparison: Comparison, name: str) -> dict[str, Any]:
    """Return the errors of the median over seeds, which is the method's prediction."""
    run = comparison.medians[name]
    facts: dict[str, Any] = {"total_rmse": run.total_rmse}
    facts |= {} if run.forecast is None else {"forecast_rmse": run.forecast_rmse}
    return facts | ({"test_rmse": [*run.errors.tests]} if run.tests else {})


def _method(runs: Sequence[Run]) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "seeds": [r.seed for r in runs],
        "total_rmse": [r.total_rmse for r in runs],
        **({} if runs[0].forecast is None else {"forecast_rmse": [r.forecast_rmse for r in runs]}),
        **({"test_rmse": [[*r.errors.tests] for r in runs]} if runs[0].tests else {}),
        "seconds": [r.fit.seconds for r in runs],
    }
    for name in ("total_rmse", "forecast_rmse"):
        if name not in facts:
            continue
        values = facts[name]
        spread = statistics.stdev(values) if len(values) > 1 else None
        facts[f"{name}_mean"], facts[f"{name}_std"] = statistics.mean(values), spread
    if any(r.leaves is not None for r in runs):
        facts["leaves_training_range_after"] = [r.leaves for r in runs]
    if runs[0].description:
        facts["description"] = runs[0].description
    if runs[0].fit.parameters:
        facts["parameters"] = runs[0].fit.parameters
    if runs[0].fit.losses:
        facts["final_loss"] = [{k: v[-1] for k, v in r.fit.losses.items()} for r in runs]
    return facts
