"""The `--simulator` option: a file or a name becomes the record's simulated trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.cli import showing
from splitband.cli.naming import names
from splitband.cli.options.records import FurtherRecords, RecordOptions, TestRecords
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.records import read_beside
from splitband.data import Grid, Record
from splitband.data.alignment import NEAR
from splitband.data.timing import Stamp, in_words, seconds_between, stamp_after
from splitband.forecasters.names import BASES, CALIBRATED, HYBRIDS
from splitband.simulators import Recorded, Simulator, SimulatorTimeoutError, run
from splitband.simulators.calibration import Calibration, samples_needed
from splitband.simulators.isolation import Isolated
from splitband.simulators.named import SIMULATORS


@dataclass(frozen=True)
class Trained:
    """What a saved model says of its training record and simulator.

    Attributes
    ----------
    start : Time stamp of the first sample.
    calibration : Of the simulator.
    """

    start: Stamp | None
    calibration: Calibration


LONGEST = 10**8
"""Samples from the training record to a history, over which a simulator is run."""


def with_simulator(
    record: Record,
    options: SimulatorOptions,
    reading: RecordOptions,
    ahead: int = 0,
    beyond: bool = False,
) -> Record:
    """The record with the trajectory of the simulator that the options name.

    It has to reach `ahead` samples beyond the record. `beyond` asks for more, for its calibration;
    one that cannot say more is taken as it is. `reading` says how the record was read.
    """
    simulator, timeout = options.simulator, options.simulator_timeout
    if not math.isfinite(timeout):
        raise ValueError(f"--simulator-timeout must be a number of seconds, got {timeout:g}")
    if simulator is None and (beyond or ahead) and record.y_sim is not None:
        simulator = record.name  # run a named record's own simulator for longer
    if simulator is None or simulator in BASES:
        return record
    opened = opened_simulator(replace(options, simulator=simulator), record, reading.time_column)
    least = len(record) + ahead
    samples = samples_needed(least, len(record)) if beyond else least
    grid = Grid(record.start, record.sampling_time, samples)
    if isinstance(opened, Recorded):
        with _named(simulator):
            samples = min(samples, max(least, opened.reach(grid)))
    elif grid.start:
        showing.console.print(f"{simulator} is run on {_times(grid)}")
    try:
        y_sim = simulated(opened, options, replace(grid, samples=samples), record.ny)
    except ValueError as error:
        if samples == least or isinstance(error.__cause__, SimulatorTimeoutError):
            raise
        y_sim = simulated(opened, options, replace(grid, samples=least), record.ny)
    rest = y_sim[len(record) :]
    return replace(record, y_sim=y_sim[: len(record)], beyond=rest if len(rest) else None)


def refuse_bases(options: SimulatorOptions, command: str) -> None:
    """Raise ValueError for what is fitted to a record, where only a simulator is of use."""
    if options.simulator in BASES:
        raise ValueError(
            f"--simulator must be a simulator for {command}; got {options.simulator}, which is "
            "fitted to the record: for compare, fit and forecast"
        )


def simulated(
    opened: Simulator, options: SimulatorOptions, grid: Grid, ny: int
) -> npt.NDArray[np.float64]:
    """The simulator's trajectory at the times of the grid, `(samples, ny)`."""
    name, timeout, cache = (
        options.simulator or "",
        options.simulator_timeout,
        options.simulator_cache,
    )
    if isinstance(opened, Recorded):
        with _named(name):
            on_grid = opened.on(grid)
        if on_grid.note:
            showing.console.print(f"{name}: {on_grid.note}")
        return on_grid.values
    within = None if isinstance(opened, Isolated) else timeout
    return run(opened, grid.samples, grid.step, ny, within, cache, name, grid.start)


@contextmanager
def _named(simulator: str) -> Iterator[None]:
    """Errors name the simulator."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"simulator {simulator}: {error}") from None


def simulated_again(
    opened: Simulator,
    options: SimulatorOptions,
    past: Record,
    warm: int,
    steps: int,
    trained: Trained,
) -> npt.NDArray[np.float64]:
    """A saved model's calibrated simulator, from row `warm` of a history to `steps` samples after.

    What keeps a state is run from the first time stamp of the training record on, where the time
    of the calibration begins, too.
    """
    name, origin, calibration = options.simulator, trained.start, trained.calibration
    begin, start = _since_training(past, origin, calibration)
    step, count = past.sampling_time, len(past) - warm + steps
    places = calibration.places(count, step, begin + warm)
    if not isinstance(opened, Recorded):
        first = min(begin, 0.0)
        _check_length(begin)
        if begin:
            showing.console.print(
                f"the history begins {begin * step:+.7g} s after the training record: {name} is "
                f"run from {'the latter' if begin > 0 else 'the former'} on"
            )
    elif opened.start is None or start is None:
        first = begin  # it is taken to begin with the history
    else:
        # Begin a whole number of steps from the history's samples, to interpolate just once.
        first = begin + math.floor(places[0] - begin + 1e-6)
    samples = math.ceil(places[-1] - first - 1e-6) + 1
    if start is not None:
        start = stamp_after(start, first * step)
    grid = Grid(start, step, samples)
    if isinstance(opened, Recorded):
        least = math.ceil(begin + warm + count - first - 1e-6)
        grid = replace(grid, samples=min(samples, max(least, opened.reach(grid))))
    y_sim = simulated(opened, options, grid, past.ny)
    held = calibration.held(steps, step, begin + warm, count, first + grid.samples)
    if held:
        showing.warn(held)
    return calibration.apply(y_sim, count, step, begin + warm, first)


def _since_training(
    past: Record, origin: Stamp | None, calibration: Calibration
) -> tuple[float, Stamp | None]:
    """How many samples after the training record a history begins, and when that record began."""
    if origin is None or past.start is None:
        if past.start is None and origin is not None:
            showing.console.print(
                "the history has no time stamps: it is taken to begin where the training record "
                f"did, at {in_words(origin)}"
            )
        elif past.start is not None and not calibration.stays:
            showing.console.print(
                "the model does not know when its training record began: its calibration "
                f"({calibration}) counts from the beginning of the history"
            )
        return 0.0, origin if past.start is None else past.start
    begin = seconds_between(origin, past.start) / past.sampling_time
    begin = round(begin) if abs(begin - round(begin)) < NEAR else begin
    if begin < 0 and not calibration.stays:
        raise ValueError(
            f"--history must not begin before the training record, at {in_words(origin)}, from "
            f"which the time of the simulator's calibration ({calibration}) counts: it begins at "
            f"{in_words(past.start)}"
        )
    return begin, origin


def _check_length(begin: float) -> None:
    if begin > LONGEST:
        raise ValueError(
            f"--history must begin within {LONGEST} samples of the training record, as the "
            f"simulator is run from there, got {begin:.0f}; without time stamps (--time-column '') "
            "both are taken to begin together"
        )


def each_with_simulator(
    records: Sequence[Record],
    methods: Sequence[str],
    further: FurtherRecords,
    options: SimulatorOptions,
    reading: RecordOptions,
) -> list[Record]:
    """The records of --more, with their simulators where a method is a hybrid model."""
    simulators = further.more_simulator or []
    hybrid = any(method in HYBRIDS for method in methods)
    if (hybrid or simulators) and len(simulators) != len(records):
        raise ValueError(
            f"--more-simulator must be given once for each --more, got {len(simulators)} for "
            f"{len(records)}"
        )
    if not simulators:
        return [*records]
    beyond = not hybrid or any(CALIBRATED in method for method in methods)
    return [
        with_simulator(record, replace(options, simulator=simulator), reading, beyond=beyond)
        for record, simulator in zip(records, simulators, strict=True)
    ]


def tests_with_simulator(
    tests: Sequence[Record],
    testing: TestRecords,
    options: SimulatorOptions,
    reading: RecordOptions,
) -> list[Record]:
    """The records of --test, each with its simulator where there is one."""
    simulators = testing.test_simulator or []
    if simulators and len(simulators) != len(tests):
        raise ValueError(
            f"--test-simulator must be given once for each --test, got {len(simulators)} for "
            f"{len(tests)}"
        )
    if not simulators:
        return [*tests]
    return [
        with_simulator(test, replace(options, simulator=simulator), reading, beyond=True)
        for test, simulator in zip(tests, simulators, strict=True)
    ]


def opened_simulator(
    options: SimulatorOptions, record: Record, time_column: str | None = None
) -> Simulator:
    """What --simulator names; of a file with the columns that --simulator-columns chooses."""
    text, timeout = options.simulator or "", options.simulator_timeout
    columns = names(options.simulator_columns or "")
    file, function = parts_of(text)
    if text in SIMULATORS:
        return SIMULATORS[text]()
    if text.endswith(".py"):
        raise ValueError(f"--simulator needs a function of the file, {text}:FUNCTION, got {text}")
    if not Path(file).is_file():
        raise FileNotFoundError(
            f"--simulator must be a file, FILE.py:FUNCTION or one of {', '.join(SIMULATORS)}, "
            f"got {text}"
        )
    reads = tuple(options.simulator_reads or ())
    for each in reads:
        if not Path(each).is_file():
            raise FileNotFoundError(f"--simulator-reads must be a file, got {each}")
    if function:
        return Isolated(file, function, timeout=timeout, reads=reads)
    if text.lower().endswith(".fmu"):
        return Isolated(file, outputs=tuple(columns), timeout=timeout, reads=reads)
    return _exported(text, record, columns, time_column)


def parts_of(simulator: str) -> tuple[str, str]:
    """The file of a simulator, and the function of FILE.py:FUNCTION or an empty text."""
    file, _, function = simulator.partition(".py:")
    return file + (".py" if function else ""), function


def _times(grid: Grid) -> str:
    """What a function or an FMU is called with, for its user."""
    if isinstance(grid.start, pd.Timestamp):
        return f"seconds since the record's first sample, {in_words(grid.start)}"
    return f"the record's time stamps, {grid}"


def _exported(path: str, record: Record, columns: list[str], time_column: str | None) -> Simulator:
    exported = read_beside(path, record.sampling_time, time_column, columns=columns or None)
    if not columns and set(record.columns) <= set(exported.columns):
        chosen = [exported.columns.index(name) for name in record.columns]
        return Recorded(exported.y[:, chosen], exported.sampling_time, exported.start)
    if exported.ny != record.ny:
        raise ValueError(
            f"--simulator-columns must choose {record.ny} column(s), as many as the record has, "
            f"out of {', '.join(exported.columns)} in {path}"
        )
    return Recorded.of(exported)
