"""Results as JSON: every number with what is needed to make it again."""

from __future__ import annotations

import math
import platform
import statistics
import subprocess
from collections.abc import Sequence
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from splitband.data import Record
from splitband.data.timing import as_json
from splitband.evaluation.budget import Phase
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.protocols import Run
from splitband.evaluation.saved_settings import SavedSettings
from splitband.filters.spectrum import periodogram
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import time_header
from splitband.report import pictures, tested
from splitband.report.table import columns, tried
from splitband.runtime.deadlines import now
from splitband.runtime.files import replacing
from splitband.runtime.outputs import staged, write_facts

if TYPE_CHECKING:
    from splitband.report.page.usage import Usage

FOUND = "recommended.json"
"""File with the settings of the recommended network, for `--settings`."""
MODEL = "model"
"""Folder with the recommended method as it was trained, for `simulate`."""


def save(
    comparison: Comparison,
    folder: Path,
    facts: dict[str, Any] | None = None,
    usage: Usage | None = None,
) -> None:
    """Write all files of a comparison in place of an earlier result; on an error none of them.

    They are predictions.csv and one for each test record, the pictures, the page, the trained
    model, recommended.json where a network is recommended, and results.json. `facts` go into the
    last one before the others; `usage` is for the page.
    """
    with staged(folder) as new:
        _write(comparison, new, facts or {}, usage)


def _write(
    comparison: Comparison, folder: Path, facts: dict[str, Any], usage: Usage | None
) -> None:
    record, setup = comparison.record, comparison.setup
    began = now()
    with replacing(folder / "predictions.csv") as temporary:
        predictions(comparison).to_csv(temporary, index=False)
    pictures.save(pictures.rollouts(comparison), folder / "rollouts.png")
    pictures.save(pictures.errors(comparison), folder / "error.png")
    training_spectrum = periodogram(record[: setup.train].y, record.sampling_rate)
    spectrum = pictures.spectrum(record, training_spectrum, setup.bands.cutoff, setup.bands.choice)
    pictures.save(spectrum, folder / "spectrum.png")
    if any(runs[0].from_start.components for runs in comparison.runs.values()):
        pictures.save(pictures.components(comparison), folder / "components.png")
    # It imports this module, and a library that takes its time, so that it is imported only here.
    page = import_module("splitband.report.page")
    page.of_comparison(comparison, folder / page.NAME, usage)
    if comparison.tests:
        tested.save_predictions(comparison, folder)
    save_found(comparison.forecaster(), record, folder)
    comparison.model.save(folder / MODEL)
    comparison.time.phases["writing"] = Phase(now() - began)
    write_facts(folder, facts | results(comparison) | {"time": comparison.time.as_json()})


def found_in(forecaster: Forecaster, folder: Path) -> Path | None:
    """Return the file that says how a recommended network is trained; None for what is none."""
    return None if SavedSettings.of_forecaster(forecaster) is None else folder / FOUND


def save_found(forecaster: Forecaster, record: Record, folder: Path) -> None:
    """Write how a recommended network is trained, for --settings; nothing for what is none."""
    saved = SavedSettings.of_forecaster(forecaster)
    if saved is not None:
        saved.for_record(record).save(folder / FOUND)


def results(comparison: Comparison) -> dict[str, Any]:
    """Return what `compare` writes to results.json.

    `table` has the errors of each channel, of the mean of the seeds, as they are shown. Those of
    `methods` are of all channels together, the root of the sum of their squares.
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
                "mean_of_seeds": _mean(comparison, name),
            }
            for name, of_method in comparison.runs.items()
        }
        | {name: {"failed": reason} for name, reason in trial.failed.items()},
        "environment": environment(),
    }


def predictions(comparison: Comparison) -> pd.DataFrame:
    """What `compare` writes to predictions.csv: the record and the predictions.

    One column for each channel, method and protocol, empty before a prediction begins; of several
    seeds their mean. The forecast of the recommended method has its interval beside it.
    """
    record = comparison.record
    table: dict[str, Any] = {time_header(record.columns): record.stamps}
    for i, column in enumerate(record.columns):
        table[column] = record.seen[:, i]
        for name, mean in comparison.means.items():
            sides = {"from start": mean.from_start.y}
            forecast = comparison.predictions.get(name)
            sides |= {} if forecast is None else {"forecast": forecast.y}
            if name == comparison.recommended and forecast is not None:
                assert forecast.lower is not None
                assert forecast.upper is not None
                sides |= {"lower": forecast.lower, "upper": forecast.upper}
            for protocol, predicted in sides.items():
                values = np.full(len(record), np.nan)
                values[len(record) - len(predicted) :] = predicted[:, i]
                table[f"{column}, {name}, {protocol}"] = values
    return pd.DataFrame(table)


def save_forecast(result: Forecast, folder: Path, usage: Usage | None = None) -> None:
    """Write all files of a forecast in place of an earlier result; on an error none of them.

    They are forecast.csv, its picture, the page, recommended.json where a network was fitted, and
    results.json. `usage` is for the page.
    """
    page = import_module("splitband.report.page")
    with staged(folder) as new:
        with replacing(new / "forecast.csv") as temporary:
            result.prediction.to_frame().to_csv(temporary, index=False)
        pictures.save(pictures.forecast(result), new / "forecast.png")
        page.of_forecast(result, new / page.NAME, usage)
        save_found(result.forecaster, result.record, new)
        result.model.save(new / MODEL)
        facts = forecast_facts(result) | {"time": result.time.as_json()}
        write_facts(new, facts)


def forecast_facts(result: Forecast) -> dict[str, Any]:
    """What `forecast` writes to results.json."""
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


def environment() -> dict[str, Any]:
    """Versions, machine and, in a checkout, the commit."""
    packages = ("splitband", "torch", "numpy", "scipy", "numba")
    return {
        "versions": {"python": platform.python_version()} | {p: version(p) for p in packages},
        "machine": f"{platform.system()} {platform.machine()}",
        "commit": _commit(),
    }


def _test_facts(comparison: Comparison) -> list[dict[str, Any]]:
    return [
        {"name": test.name, "samples": len(test), "start": as_json(test.start)}
        | tested.facts(comparison, i)
        for i, test in enumerate(comparison.tests)
    ]


def _interval(comparison: Comparison, name: str) -> dict[str, Any]:
    """The forecast's interval, and how many of the measured samples it really holds."""
    interval = comparison.require_trial().intervals[name]
    ahead = len(comparison.means[name].ahead)
    if not ahead:
        return asdict(interval)
    mean = interval.half_widths(ahead).mean(axis=0)
    return asdict(interval) | {
        "covers": comparison.covers(name),
        "mean_half_width": mean.tolist(),
    }


def _mean(comparison: Comparison, name: str) -> dict[str, Any]:
    """Return the errors of the mean over seeds, which is what is handed out."""
    mean = comparison.means[name]
    facts: dict[str, Any] = {"total_rmse": mean.total_rmse}
    facts |= {} if mean.forecast is None else {"forecast_rmse": mean.forecast_rmse}
    return facts | ({"test_rmse": [*mean.errors.tests]} if mean.tests else {})


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


def _commit() -> str | None:
    """The commit of the checkout that the package runs from, if it runs from one."""
    folder = Path(__file__).resolve().parent
    package = folder.parent
    if not (package.parents[1] / ".git").exists():
        return None
    try:
        described = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=folder, capture_output=True, text=True, timeout=10, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()
