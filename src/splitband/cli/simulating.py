"""The `--simulator` option: a file or a name becomes the record's simulated trajectory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from splitband.calibration import samples_needed
from splitband.cli.given import names
from splitband.data import Trajectory, read
from splitband.isolation import Isolated
from splitband.methods import CALIBRATED, HYBRIDS
from splitband.simulators import Recorded, Simulator, SimulatorTimeoutError, run
from splitband.systems import SIMULATORS


def with_simulator(
    record: Trajectory,
    simulator: str | None,
    columns: str | None,
    timeout: float,
    cache: Path | None,
    ahead: int = 0,
    beyond: bool = False,
) -> Trajectory:
    """The record with the trajectory of the simulator that the options name.

    It has to reach `ahead` samples beyond the record. `beyond` asks for more, for its calibration;
    one that cannot say more is taken as it is.
    """
    if not math.isfinite(timeout):
        raise ValueError(f"--simulator-timeout must be a number of seconds, got {timeout:g}")
    if simulator is None and (beyond or ahead) and record.y_sim is not None:
        simulator = record.name  # a named record's own, for longer
    if simulator is None:
        return record
    least = len(record) + ahead
    samples = samples_needed(least, len(record)) if beyond else least
    try:
        y_sim = simulated(record, samples, simulator, columns, timeout, cache, least)
    except ValueError as error:
        if not beyond or isinstance(error.__cause__, SimulatorTimeoutError):
            raise
        y_sim = simulated(record, least, simulator, columns, timeout, cache)
    rest = y_sim[len(record) :]
    return replace(record, y_sim=y_sim[: len(record)], beyond=rest if len(rest) else None)


def simulated(
    record: Trajectory,
    samples: int,
    simulator: str,
    columns: str | None,
    timeout: float,
    cache: Path | None,
    least: int | None = None,
) -> npt.NDArray[np.float64]:
    """The simulator's trajectory `(samples, ny)` from the record's first sample on.

    With `least`, an exported trajectory of at least so many is taken as far as it goes.
    """
    opened = _open(simulator, record, names(columns or ""), timeout)
    if least is not None and isinstance(opened, Recorded):
        samples = min(samples, max(least, len(np.asarray(opened.y))))
    within = None if isinstance(opened, Isolated) else timeout
    return run(opened, samples, record.sampling_time, record.ny, within, cache, name=simulator)


def each_with_simulator(
    records: Sequence[Trajectory],
    methods: Sequence[str],
    simulators: Sequence[str] | None,
    columns: str | None,
    timeout: float,
    cache: Path | None,
) -> list[Trajectory]:
    """The records of --more, with their simulators where a method is a hybrid model."""
    simulators, hybrid = simulators or [], any(method in HYBRIDS for method in methods)
    if (hybrid or simulators) and len(simulators) != len(records):
        raise ValueError(
            f"--more-simulator must be given once for each --more, got {len(simulators)} for "
            f"{len(records)}"
        )
    if not hybrid:
        return [*records]
    beyond = any(CALIBRATED in method for method in methods)
    return [
        with_simulator(record, simulator, columns, timeout, cache, beyond=beyond)
        for record, simulator in zip(records, simulators, strict=True)
    ]


def _open(text: str, record: Trajectory, columns: list[str], timeout: float) -> Simulator:
    file, _, function = text.partition(".py:")
    file += ".py" if function else ""
    if text in SIMULATORS:
        return SIMULATORS[text]()
    if text.endswith(".py"):
        raise ValueError(f"--simulator needs a function of the file, {text}:FUNCTION, got {text}")
    if not Path(file).is_file():
        raise FileNotFoundError(
            f"--simulator must be a file, FILE.py:FUNCTION or one of {', '.join(SIMULATORS)}, "
            f"got {text}"
        )
    if function:
        return Isolated(file, function, timeout=timeout)
    if text.lower().endswith(".fmu"):
        return Isolated(file, outputs=tuple(columns), timeout=timeout)
    return _exported(text, record, columns)


def _exported(path: str, record: Trajectory, columns: list[str]) -> Simulator:
    found = read(path, columns=columns or None, fallback_sampling_time=record.sampling_time)
    if not columns and set(record.columns) <= set(found.columns):
        chosen = [found.columns.index(name) for name in record.columns]
        return Recorded(found.y[:, chosen], found.sampling_time)
    if found.ny != record.ny:
        raise ValueError(
            f"--simulator-columns must choose {record.ny} column(s), as many as the record has, "
            f"out of {', '.join(found.columns)} in {path}"
        )
    return Recorded(found.y, found.sampling_time)
