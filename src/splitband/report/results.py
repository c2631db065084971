"""Results as JSON: every number with what is needed to make it again."""

from __future__ import annotations

import platform
import statistics
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.data import Trajectory
from splitband.data.timing import as_json, stamps_at
from splitband.evaluation.comparison import Run, by_channel, ensemble
from splitband.evaluation.intervals import Interval
from splitband.evaluation.selection import Trial
from splitband.forecasters.methods import Setup


def results(
    record: Trajectory,
    setup: Setup,
    runs: Mapping[str, Sequence[Run]],
    trial: Trial,
) -> dict[str, Any]:
    """What `compare` writes to results.json."""
    return {
        "record": {
            "name": record.name,
            "samples": len(record),
            "sampling_time": record.sampling_time,
            "start": as_json(record.start),
            "columns": list(record.columns),
            "inputs": record.nu,
            "gaps": 0 if record.measured is None else int((~record.complete).sum()),
            "truth": "measured" if record.y_true is None else "noise-free",
        },
        "settings": asdict(setup),
        "recommended": trial.recommended,
        "methods": {
            name: _method(of_method)
            | {
                "held_out_rmse": trial.errors[name],
                "change": trial.change(name),
                "interval": _interval(trial.intervals[name], record, setup, of_method),
                "mean_of_seeds": _mean(record, setup, of_method),
                "by_channel": _by_channel(record, setup, of_method),
            }
            for name, of_method in runs.items()
        }
        | {name: {"failed": reason} for name, reason in trial.failed.items()},
        "environment": environment(),
    }


def predictions(
    record: Trajectory, setup: Setup, runs: Mapping[str, Sequence[Run]], trial: Trial
) -> pd.DataFrame:
    """What `compare` writes to predictions.csv: the record and the predictions.

    One column for each channel, method and protocol, empty before a prediction begins; of several
    seeds their mean. The forecast of the recommended method has its interval beside it.
    """
    table: dict[str, Any] = {time_header(record.columns): record.stamps}
    for i, column in enumerate(record.columns):
        table[column] = record.seen[:, i]
        for name, of_method in runs.items():
            mean = ensemble(of_method, record, setup)
            sides = {"from start": mean.from_start, "forecast": mean.forecast}
            if name == trial.recommended:
                half = trial.intervals[name].half_widths(len(mean.forecast))
                sides |= {"lower": mean.forecast - half, "upper": mean.forecast + half}
            for protocol, predicted in sides.items():
                values = np.full(len(record), np.nan)
                values[len(record) - len(predicted) :] = predicted[:, i]
                table[f"{column}, {name}, {protocol}"] = values
    return pd.DataFrame(table)


def forecast(record: Trajectory, runs: Sequence[Run], interval: Interval) -> pd.DataFrame:
    """What `forecast` writes: the samples after the record's last, and their interval.

    A column of time stamps, see `time_ahead`, and three for each channel; of several seeds the
    mean.
    """
    mean = np.mean([run.forecast for run in runs], axis=0)
    half = interval.half_widths(len(mean))
    table: dict[str, Any] = {time_header(record.columns): time_ahead(record, len(mean))}
    for i, column in enumerate(record.columns):
        table |= {
            column: mean[:, i],
            f"{column}, lower": (mean - half)[:, i],
            f"{column}, upper": (mean + half)[:, i],
        }
    return pd.DataFrame(table)


def time_ahead(record: Trajectory, steps: int) -> npt.NDArray[np.float64] | pd.DatetimeIndex:
    """The time stamps of the samples after a record; without any, seconds after its last sample."""
    rows = np.arange(steps)
    if record.start is None:
        return stamps_at(0.0, record.sampling_time, 1 + rows)
    return stamps_at(record.start, record.sampling_time, len(record) + rows)


def time_header(columns: Sequence[str]) -> str:
    """The name of the time column beside `columns`."""
    return "time (s)" if "time" in columns else "time"


def environment() -> dict[str, Any]:
    """Versions, machine and, in a checkout, the commit."""
    packages = ("splitband", "torch", "numpy", "scipy", "numba")
    return {
        "versions": {"python": platform.python_version()} | {p: version(p) for p in packages},
        "machine": f"{platform.system()} {platform.machine()}",
        "commit": _commit(),
    }


def _interval(
    interval: Interval, record: Trajectory, setup: Setup, runs: Sequence[Run]
) -> dict[str, Any]:
    """The forecast's interval, and how many of the measured samples it really holds."""
    forecast = ensemble(runs, record, setup).forecast
    covers = interval.coverage(record.seen[setup.train :] - forecast)
    mean = interval.half_widths(len(forecast)).mean(axis=0)
    return asdict(interval) | {"covers": covers, "mean_half_width": mean.tolist()}


def _mean(record: Trajectory, setup: Setup, runs: Sequence[Run]) -> dict[str, float] | None:
    """The errors of the mean over seeds, where there are several."""
    if len(runs) < 2:
        return None
    mean = ensemble(runs, record, setup)
    return {"total_rmse": mean.total_rmse, "forecast_rmse": mean.forecast_rmse}


def _by_channel(record: Trajectory, setup: Setup, runs: Sequence[Run]) -> dict[str, list[float]]:
    """The errors of the mean over seeds, each channel by itself."""
    mean = ensemble(runs, record, setup)
    return {
        "total_rmse": by_channel(record, mean.from_start),
        "forecast_rmse": by_channel(record, mean.forecast),
    }


def _method(runs: Sequence[Run]) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "seeds": [r.seed for r in runs],
        "total_rmse": [r.total_rmse for r in runs],
        "forecast_rmse": [r.forecast_rmse for r in runs],
        "seconds": [r.seconds for r in runs],
    }
    for name in ("total_rmse", "forecast_rmse"):
        values = facts[name]
        spread = statistics.stdev(values) if len(values) > 1 else None
        facts[f"{name}_mean"], facts[f"{name}_std"] = statistics.mean(values), spread
    if any(r.leaves is not None for r in runs):
        facts["leaves_training_range_after"] = [r.leaves for r in runs]
    if runs[0].description:
        facts["description"] = runs[0].description
    if runs[0].losses:
        facts["final_loss"] = [{k: v[-1] for k, v in r.losses.items()} for r in runs]
    return facts


def _commit() -> str | None:
    """The commit of the checkout that the package runs from, if it runs from one."""
    folder = Path(__file__).resolve().parent
    if not (folder.parents[1] / ".git").exists():
        return None
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=folder, capture_output=True, text=True, timeout=10, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return None
    return found.stdout.strip()
