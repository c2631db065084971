"""Runs of the paper's experiments, each a JSON file that is made once."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from reproduction.jobs import Job
from reproduction.settings import Setup
from splitband.comparison.backtest import BacktestSpec, Fit, backtest, first_origin
from splitband.comparison.methods import QUICK, named
from splitband.forecasters.held_out import Origin, after, beginning
from splitband.forecasters.network import Network
from splitband.forecasters.prediction import Prediction
from splitband.metrics import rmse
from splitband.models import SplitModel
from splitband.models.base import Signals
from splitband.records import Record
from splitband.report.environment import environment
from splitband.runtime.files import write_text
from splitband.runtime.workers import run_jobs

Array = npt.NDArray[np.float64]
FORMAT = 1
FEWEST_SEEDS = 3
"""A row of a table is made of as many runs at least, unless fewer are asked for."""

_LOSSES = 100  # kept of a curve
_WAITED = 1.25  # wall seconds per processor second above which a run shared its core


def write_json_lines(path: Path, value: dict[str, Any]) -> None:
    """Write `value` as a JSON object with a line for each key: compact, and easy to diff."""
    lines = [f"{json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in value.items()]
    write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")


def complete(
    jobs: Iterable[Job],
    folder: Path,
    executor: Executor | None = None,
    done: Callable[[Job], None] = lambda job: None,
) -> int:
    """Run the jobs that have no file in `folder` yet; return how many there were.

    The file of each is written as soon as it is done, so that one stopped in between is all that is
    lost. Without an executor they run in this process. `done` is called with each.
    """
    todo = missing(jobs, folder)
    for (job, _), future in run_jobs(_work, [(job, job.record) for job in todo], executor):
        (folder / job.path).parent.mkdir(parents=True, exist_ok=True)
        write_json_lines(folder / job.path, future.result())
        done(job)
    return len(todo)


def missing(jobs: Iterable[Job], folder: Path) -> list[Job]:
    """Those without a file in `folder`, each once."""
    return [job for job in dict.fromkeys(jobs) if not (folder / job.path).exists()]


def finished(jobs: Sequence[Job], folder: Path, fewest: int = FEWEST_SEEDS) -> list[Job]:
    """The jobs of a row that its table can be made of.

    Those that have a file, if they are `fewest` at least, or all; otherwise, of jobs that leave the
    epochs to the paper, the same with the most epochs short of that. Where there is nothing to
    show, all of them.
    """
    shorter = _shorter(jobs[0], folder) if jobs[0].epochs is None else []
    for epochs in (jobs[0].epochs, *shorter):
        asked = [replace(job, epochs=epochs) for job in jobs]
        there = [job for job in asked if (folder / job.path).exists()]
        if len(there) >= min(fewest, len(jobs)):
            return there
    return [*jobs]


def _shorter(job: Job, folder: Path) -> list[int]:
    """The numbers of epochs below the paper's that a job's method was run for, descending."""
    names = [path.name for path in (folder / job.path).parent.glob("*.json")]
    found = {int(match[1]) for name in names if (match := re.search(r"epochs(\d+)-", name))}
    return sorted((epochs for epochs in found if epochs < job.full_epochs), reverse=True)


def load(job: Job, folder: Path) -> dict[str, Any]:
    """The finished run of a job; it holds `diverged` in place of results where there are none.

    Raises
    ------
    FileNotFoundError
        Where it has not been run.
    ValueError
        For a file that is damaged, or of another job, other settings or another record.
    """
    path = folder / job.path
    if not path.is_file():
        raise FileNotFoundError(f"{path} is missing: run it first, without --no-run")
    try:
        facts: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is not JSON: {error}; delete it to run it again") from None
    record = job.record
    for name, value in _identity(job, record, job.setup(record)).items():
        if not _same(facts.get(name) if isinstance(facts, dict) else None, value):
            raise ValueError(
                f"{path} is a run of another {name} than {job}; delete it to run it again"
            )
    return facts


@dataclass(frozen=True, eq=False)
class Drawn(Fit):
    """A loaded run, with the signals before its model's filters, which a figure draws."""

    unfiltered: Mapping[str, Array] = field(default_factory=dict)


def as_fit(facts: dict[str, Any], record: Record) -> Drawn:
    """A loaded run with the predictions that its file holds, of its job's record."""

    def prediction(values: Array, parts: dict[str, Array]) -> Prediction:
        grid = record[: len(record) - len(values)].grid.after(len(values))
        return Prediction(values, grid, record.columns, parts)

    parts = {name: _array(values) for name, values in facts["components"].items()}
    said, train = _array(facts["from_start"]), facts["settings"]["train"]
    forecasts = {
        Origin(train, len(record) - len(said)): prediction(said, parts),
        Origin(train, train): prediction(_array(facts["forecast"]), {}),
    }
    return Drawn(
        facts["job"]["method"],
        facts["job"]["seed"],
        forecasts=forecasts,
        unfiltered={name: _array(values) for name, values in facts["unfiltered"].items()},
        seconds=facts["seconds"],
    )


def whole_rmse(facts: dict[str, Any], job: Job) -> float:
    """The RMSE along the full trajectory, warm-up included, which the paper's Sec. 5 speaks of.

    What warms up on measured samples has no error there; a simulator has its own.
    """
    record = job.record
    if job.method in QUICK and "simulator" in (simulator := named(job.method)).needs:
        train = facts["settings"]["train"]
        simulator.fit(beginning(record, train))
        y_sim = simulator.on(record).y_sim
        assert y_sim is not None
        return rmse(record.truth, y_sim)
    counted = 1 - facts["settings"]["settings"]["warmup"] / len(record)
    return float(facts["total_rmse"] * counted**0.5)


def parts_rmse(facts: dict[str, Any], job: Job) -> dict[str, float]:
    """The total RMSE that each component of a prediction has without the others."""
    parts = {name: _array(values) for name, values in facts.get("components", {}).items()}
    truth = job.record.truth
    return {name: rmse(truth[-len(values) :], values) for name, values in parts.items()}


def final_losses(facts: dict[str, Any]) -> dict[str, float]:
    """The training loss at the end, by network: the median over the last tenth of the epochs."""
    return {
        name: float(np.median(losses[-max(1, len(losses) // 10) :]))
        for name, losses in facts["losses"].items()
    }


def training_seconds(facts: dict[str, Any]) -> float | None:
    """How long a run's training took, or would have taken on a core of its own.

    Of one that waited for its core it is the time that the processor worked on it. None for an
    older one that was interrupted and resumed, of which the time before is not known. Older files
    do not say whether they waited (`load_known`).
    """
    if "resumed" in facts:
        return None
    waited = load_known(facts) and facts["seconds"] > _WAITED * facts["cpu_seconds"]
    return float(facts["cpu_seconds" if waited else "seconds"])


def load_known(facts: dict[str, Any]) -> bool:
    """Whether a run's file says how long the processor worked on it."""
    return "cpu_seconds" in facts


def unversioned(facts: dict[str, Any]) -> bool:
    """Whether a run's file does not say of which commit it is, without changes on top of it."""
    commit = facts["environment"].get("commit")
    return not commit or "dirty" in commit


def _work(sent: tuple[Job, Record]) -> dict[str, Any]:
    job, record = sent
    setup = job.setup(record)
    began = time.process_time()
    try:
        done, sliced = run(job, record, setup)
        facts = _results(job, done, record) | {
            "seconds": round(done.report.seconds, 3),  # of the fit
            "cpu_seconds": round(time.process_time() - began, 3),  # of the whole job
        }
        facts |= {} if sliced is None else {"sliced_rmse": sliced}
    except FloatingPointError as error:
        facts = {"diverged": str(error)}
    return _identity(job, record, setup) | facts | {"environment": environment()}


def run(job: Job, record: Record, setup: Setup) -> tuple[Fit, float | None]:
    """One method on a system, under both protocols; of a split model also `sliced_rmse`."""
    forecaster = job.forecaster(setup)
    forecaster.check(record[: setup.train])
    first = first_origin(record, setup.train, setup.settings.warmup)
    forecast = Origin(setup.train, setup.train)
    spec = BacktestSpec(record, [first, forecast])
    done = backtest(forecaster, spec, job.seed)
    sliced = None
    if job.splits:
        assert isinstance(done.fitted, Network)
        model = done.fitted.model
        assert isinstance(model, SplitModel)
        sliced = sliced_rmse(model, record, setup.train, setup.settings.warmup)
    return done, sliced


def sliced_rmse(model: SplitModel, record: Record, train: int, warmup: int) -> float:
    """Return the total RMSE from a warm-up that is cut from the filtered training record.

    The free run of Eq. 11, prediction, filters the first `warmup` samples alone.
    """
    bands = np.concatenate(model.pair.split(record[:train].y), axis=1)[:warmup]
    known = Signals(torch.from_numpy(bands)[None].float())
    with torch.no_grad():
        parts = model.components_of(known, len(record) - warmup).values()
    return rmse(record.truth[warmup:], sum(part[0].double().numpy() for part in parts))


def _results(job: Job, done: Fit, record: Record) -> dict[str, Any]:
    """What came out; predictions at the paper's values only, components of the first seed only."""
    total, ahead = (rmse(record.truth[-len(y) :], y) for y in (done.from_start.y, done.ahead))
    if not np.isfinite(total + ahead):
        raise FloatingPointError("the prediction is not finite")
    varied = job.cutoff is not None or job.downsampling is not None or job.draw
    drawn = job.seed == 0 and not varied
    return {
        "total_rmse": total,
        "forecast_rmse": ahead,
        "description": done.description,
        "losses": {name: _few(values) for name, values in done.report.losses.items()},
        "from_start": [] if varied else _rounded(done.from_start.y),
        "forecast": [] if varied else _rounded(done.ahead),
        "components": _parts(done.from_start.components) if drawn else {},
        "unfiltered": _parts(_unfiltered(done, record)) if drawn else {},
    }


def _unfiltered(done: Fit, record: Record) -> dict[str, Array]:
    """The signals before the filters of a model, for its prediction from the start."""
    model, origin = done.fitted, next(iter(done.forecasts))
    return model.unfiltered(**after(record, origin.at)) if isinstance(model, Network) else {}


def _identity(job: Job, record: Record, setup: Setup) -> dict[str, Any]:
    """What must agree for a file to be this job's."""
    return {
        "format": FORMAT,
        "job": asdict(job),
        # The paper chose the filter pair, so that there is no choice of ours to keep.
        "settings": {k: v for k, v in setup.as_json().items() if k != "choice"},
        "record": {
            "name": record.name,
            "samples": len(record),
            "mean": float(record.y.mean()),
            "std": float(record.y.std()),
        },
    }


_UNNAMED = {"l2": 0.0, "linear_start": True, "own_warmup": False, "max_samples": 100_000}
"""Settings that are younger than some of the files, at the values that change nothing there."""


def _same(found: Any, expected: Any) -> bool:
    """Equal, numbers to the rounding that another machine's record may differ by."""
    if isinstance(expected, dict):
        return isinstance(found, dict) and all(
            _same(found.get(k, _UNNAMED.get(k)), v) for k, v in expected.items()
        )
    if isinstance(expected, float):
        return isinstance(found, int | float) and bool(
            np.isclose(found, expected, rtol=1e-6, atol=1e-9)
        )
    if isinstance(expected, list | tuple):
        same_length = isinstance(found, list) and len(found) == len(expected)
        return same_length and all(_same(f, e) for f, e in zip(found, expected, strict=True))
    return bool(found == expected)


def _few(losses: Sequence[float]) -> list[float]:
    """At most `_LOSSES` of a curve's values, the last among them."""
    step = -(-len(losses) // _LOSSES)
    return [float(f"{value:.4g}") for value in losses[::-1][::step][::-1]]


def _parts(parts: Mapping[str, Array]) -> dict[str, list[list[float]]]:
    return {name: _rounded(values) for name, values in parts.items()}


def _rounded(values: Array) -> list[list[float]]:
    """By channel, `(ny, time)`, in few characters."""
    return [[round(float(v), 3) for v in channel] for channel in values.T]


def _array(channels: list[list[float]]) -> Array:
    return np.array(channels, float).T
