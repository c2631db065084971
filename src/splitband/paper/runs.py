"""Runs of the paper's experiments, each a JSON file that is made once."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.comparison import Run, RunProgress, run, run_baseline
from splitband.data import Trajectory, double_torsion, drill_string, read
from splitband.files import CHECKPOINTS, write_json_lines
from splitband.methods import FIXED, METHODS, Setup
from splitband.paper.settings import HYBRID, LEARNING_BASED, Hybrid, LearningBased, in_hz
from splitband.processes import over
from splitband.reporting import environment
from splitband.systems import (
    double_mass_spring,
    double_mass_spring_oracle,
    double_torsion_pendulum,
    van_der_pol,
)

Array = npt.NDArray[np.float64]
FORMAT = 1
ORACLE = "oracle"
"""Method on system (i): least squares on the true form."""

_LOSSES = 100  # kept of a curve


_once = lru_cache(maxsize=64)
"""For records that are simulated: a table asks for them again with every run."""


@dataclass(frozen=True)
class System:
    """A record under the settings of one of the paper's columns.

    Attributes
    ----------
    title : For tables.
    column : The paper's settings.
    record : Makes the record; the argument is the noise draw, of which only simulated ones have
        several.
    """

    title: str
    column: LearningBased | Hybrid
    record: Callable[[int], Trajectory]


def _torsion(row: str, _: int) -> Trajectory:
    """The record of a row where SPLITBAND_DATA_DIR has it, otherwise the one that is public."""
    folder = os.environ.get("SPLITBAND_DATA_DIR")
    own = Path(folder or ".") / f"double_torsion_{row}.csv"
    if folder is None or not own.is_file():
        return double_torsion()
    y = read(own, sampling_time=0.01).y[:2000]
    return Trajectory((y - y.mean(axis=0)) / y.std(axis=0), 0.01, name=own.stem, columns=("phi2",))


SYSTEMS = {
    "i": System(
        "double mass-spring",
        LEARNING_BASED["i"],
        _once(lambda draw: double_mass_spring(seed=draw)),
    ),
    **{
        row: System("double-torsion record", LEARNING_BASED[row], partial(_torsion, row))
        for row in ("ii", "iii", "iv")
    },
    **{
        f"{row}-simulated": System(
            "simulated pendulum",
            LEARNING_BASED[row],
            _once(partial(double_torsion_pendulum, row, 2000)),
        )
        for row in ("ii", "iii", "iv")
    },
    "v": System("Van der Pol", HYBRID["v"], _once(lambda draw: van_der_pol())),
    "vi": System("drill string", HYBRID["vi"], lambda draw: drill_string()),
}
"""By the paper's numbers; it has one record for each of (ii) to (iv), of which one is public."""


@dataclass(frozen=True)
class Job:
    """One method on one system with one seed; None is the paper's value.

    Attributes
    ----------
    draw : Of the noise.
    cutoff : w, in the unit of the paper's tables.
    downsampling : k.
    epochs : The paper's training steps.
    """

    system: str
    method: str
    seed: int = 0
    draw: int = 0
    cutoff: float | None = None
    downsampling: int | None = None
    epochs: int | None = None

    def __post_init__(self) -> None:
        """Drop what is the paper's own value, so that equal runs are equal jobs."""
        if self.system not in SYSTEMS:
            raise ValueError(f"systems must be out of {', '.join(SYSTEMS)}, got {self.system}")
        if self.method not in (*METHODS, ORACLE):
            raise ValueError(f"methods must be out of {', '.join(METHODS)}, got {self.method}")
        column = SYSTEMS[self.system].column
        own = {"cutoff": column.cutoff, "downsampling": getattr(column, "downsampling", None)}
        own["epochs"] = column_epochs(column, self.method)
        for name, value in own.items():
            if getattr(self, name) == value or self.method in (*FIXED, ORACLE):
                object.__setattr__(self, name, None)

    @property
    def path(self) -> Path:
        """Of its file in a folder of results."""
        marks = {
            "draw": self.draw or None,
            "w": self.cutoff,
            "k": self.downsampling,
            "epochs": self.epochs,
        }
        parts = [f"{name}{value:g}" for name, value in marks.items() if value is not None]
        return Path(self.system, self.method, "-".join([*parts, f"seed{self.seed}"]) + ".json")

    @property
    def record(self) -> Trajectory:
        """What it learns from and is measured on."""
        return SYSTEMS[self.system].record(self.draw)

    def setup(self, record: Trajectory) -> Setup:
        """The paper's settings with what this job changes."""
        setup = SYSTEMS[self.system].column.setup(record.sampling_rate)
        setup = setup.only_for(self.method)
        if self.epochs is not None:
            setup = replace(setup, settings=replace(setup.settings, epochs=self.epochs))
        if self.cutoff is not None:
            setup = replace(setup, cutoff=in_hz(self.cutoff, record.sampling_rate))
        if self.downsampling is not None:
            setup = replace(setup, downsampling=self.downsampling)
        return setup


def column_epochs(column: LearningBased | Hybrid, method: str) -> int:
    """The paper's epochs for a method."""
    if isinstance(column, LearningBased):
        return column.epochs
    return column.rnn_epochs if method.endswith("rnn") else column.gru_epochs


def complete(
    jobs: Iterable[Job],
    folder: Path,
    processes: int = 1,
    progress: Callable[[RunProgress], None] | None = None,
) -> int:
    """Run the jobs that have no file in `folder` yet; return how many there were.

    Each writes its file as soon as it is done, so that one stopped in between is all that is lost.
    """
    todo = missing(jobs, folder)
    for _ in over(partial(_work, folder, progress is None), todo, processes, progress):
        pass
    return len(todo)


def missing(jobs: Iterable[Job], folder: Path) -> list[Job]:
    """Those without a file in `folder`, each once."""
    return [job for job in dict.fromkeys(jobs) if not (folder / job.path).exists()]


def finished(jobs: Sequence[Job], folder: Path) -> list[Job]:
    """The jobs of a row, or where some are missing all of them with the most epochs that were run.

    That is for jobs that leave the epochs to the paper.
    """
    if jobs[0].epochs is not None or not missing(jobs, folder):
        return [*jobs]
    names = [path.name for path in (folder / jobs[0].path).parent.glob("*.json")]
    run = {int(found[1]) for name in names if (found := re.search(r"epochs(\d+)-", name))}
    for epochs in sorted(run, reverse=True):
        shorter = [replace(job, epochs=epochs) for job in jobs]
        if not missing(shorter, folder):
            return shorter
    return [*jobs]


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


def as_run(facts: dict[str, Any]) -> Run:
    """A loaded run with the predictions that its file holds."""
    return Run(
        facts["job"]["method"],
        facts["job"]["seed"],
        facts["total_rmse"],
        facts["forecast_rmse"],
        facts["seconds"],
        _array(facts["from_start"]),
        _array(facts["forecast"]),
        components={name: _array(values) for name, values in facts["components"].items()},
        description=facts["description"],
        losses=facts["losses"],
        unfiltered={name: _array(values) for name, values in facts["unfiltered"].items()},
    )


def _work(folder: Path, silent: bool, job: Job, report: Callable[[RunProgress], None]) -> None:
    record = job.record
    setup = job.setup(record)
    path = folder / job.path
    checkpoints = path.parent / f"{path.stem}-{CHECKPOINTS}"
    checkpoints.mkdir(parents=True, exist_ok=True)
    try:
        if job.method == ORACLE:
            done = run_baseline(ORACLE, double_mass_spring_oracle, record, setup)
        else:
            watch = None if silent else report
            done = run(job.method, record, setup, job.seed, watch, checkpoints=checkpoints)
        facts = _results(job, done)
    except FloatingPointError as error:
        facts = {"diverged": str(error)}
    write_json_lines(path, _identity(job, record, setup) | facts | {"environment": environment()})
    shutil.rmtree(checkpoints)


def _results(job: Job, done: Run) -> dict[str, Any]:
    """What came out; predictions at the paper's values only, components of the first seed only."""
    if not np.isfinite(done.total_rmse + done.forecast_rmse):
        raise FloatingPointError("the prediction is not finite")
    varied = job.cutoff is not None or job.downsampling is not None or job.draw
    drawn = job.seed == 0 and not varied
    return {
        "total_rmse": done.total_rmse,
        "forecast_rmse": done.forecast_rmse,
        "seconds": round(done.seconds, 3),
        "description": done.description,
        "losses": {name: _few(values) for name, values in done.losses.items()},
        "from_start": [] if varied else _rounded(done.from_start),
        "forecast": [] if varied else _rounded(done.forecast),
        **{
            name: {k: _rounded(v) for k, v in getattr(done, name).items()} if drawn else {}
            for name in ("components", "unfiltered")
        },
    }


def _identity(job: Job, record: Trajectory, setup: Setup) -> dict[str, Any]:
    """What must agree for a file to be this job's."""
    return {
        "format": FORMAT,
        "job": asdict(job),
        # The paper chose the filter pair, so that there is no choice of ours to keep.
        "settings": {k: v for k, v in asdict(setup).items() if k != "choice"},
        "record": {
            "name": record.name,
            "samples": len(record),
            "mean": float(record.y.mean()),
            "std": float(record.y.std()),
        },
    }


def _same(found: Any, expected: Any) -> bool:
    """Equal, numbers to the rounding that another machine's record may differ by."""
    if isinstance(expected, dict):
        return isinstance(found, dict) and all(_same(found.get(k), v) for k, v in expected.items())
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


def _rounded(values: Array) -> list[list[float]]:
    """By channel, `(ny, time)`, in few characters."""
    return [[round(float(v), 3) for v in channel] for channel in values.T]


def _array(channels: list[list[float]]) -> Array:
    return np.array(channels, float).T
