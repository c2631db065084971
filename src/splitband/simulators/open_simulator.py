"""Open a simulator by a path or a name, and run it beside a record."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitband.records import Grid, Record, read
from splitband.records.alignment import log
from splitband.records.columns import ColumnError
from splitband.records.preparation import check_level, going_on, in_turn
from splitband.records.signals import row_ranges
from splitband.records.timing import in_words
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.base import (
    Hold,
    Recorded,
    Simulator,
    SimulatorTimeoutError,
    Start,
    as_known,
    check_start,
    matched,
    origin,
    run,
)
from splitband.simulators.calibration import samples_needed
from splitband.simulators.functions import UserCode
from splitband.simulators.isolation import Isolated, adjustable_from, named_in
from splitband.simulators.named import SIMULATORS
from splitband.simulators.parameters import Adjustable, Parameters
from splitband.simulators.unknown import Unknown
from splitband.simulators.user_code import check_open, count_arguments, outline


def open_simulator(  # noqa: PLR0913
    name: str,
    record: Record,
    *,
    columns: Sequence[str] = (),
    inputs: Sequence[str] | None = None,
    start: Start | str | None = None,
    hold: Hold | None = None,
    step: float | None = None,
    parameters: str | Mapping[str, Any] | None = None,
    timeout: float | None = None,
    time_column: str | None = None,
    unknown: Sequence[Unknown] | None = None,
) -> Any:
    """Return the simulator for a text, as `--simulator` does.

    Parameters
    ----------
    name : A file of an exported trajectory, an .fmu, FILE.py:FUNCTION, FILE.py:RHS with
        `parameters`, or the name of a public record with a simulator.
    record : The record of the simulation.
    columns : Columns or outputs of the record's channels; by default those of equal names.
    inputs : Variables of an FMU for the record's inputs; by default those of equal names.
    start : Simulator time in s at the record's first sample, or "record" for its time stamp.
    hold : Course of inputs between samples, "zoh" or "linear", see `Ode` and `Fmu`; None for that
        of an `Ode` in the file.
    step : Communication step of an FMU in s, see `Fmu`.
    parameters : Numbers and ranges, as in `Ode` or as the text "k=0.1:10,c=0.05".
    timeout : Time limit of a run in s; None for no limit.
    time_column : Time column of an exported trajectory, if it has one.
    unknown : Unknown terms of a differential equation, see `Ode`.

    Returns
    -------
    Simulator
        One with parameters to fit runs in this process, any other function or FMU in its own.

    Raises
    ------
    FileNotFoundError
        For a missing file.
    ValueError
        For an option of another kind of simulator, and an unusable file.
    """
    file, _, function = name.partition(".py:")
    file += ".py" if function else ""
    fmu, exists = file.lower().endswith(".fmu"), Path(file).is_file()
    own, equation = "an .fmu" if fmu else "FILE.py:FUNCTION" if function else "", "FILE.py:FUNCTION"
    for option, value, kinds in (
        ("inputs (--simulator-inputs)", inputs, ("an .fmu",)),
        ("step (--simulator-step)", step, ("an .fmu",)),
        ("start (--simulator-start)", start, ("an .fmu", equation)),
        ("hold (--simulator-hold)", hold, ("an .fmu", equation)),
        ("parameters", parameters, ("an .fmu", equation)),
        ("unknown (--unknown)", unknown, (equation,)),
    ):
        if value is not None and own not in kinds:
            raise InputError(
                f"{option} must be left out but for a simulator that is {' or '.join(kinds)}, got "
                f"{name or 'none'}"
            )
    if timeout is not None and not math.isfinite(timeout):
        raise InputError(
            f"timeout (--simulator-timeout) must be a number of seconds, got {timeout:g}"
        )
    try:
        begin: Start | None = check_start(start)
    except InputError as error:
        raise InputError(f"{error} (--simulator-start)") from None
    if parameters is None and function and exists and outline(file, function) is None:
        # An `Ode` in the file may have ranges to fit.
        parameters = {} if isinstance(named_in(file, function), UserCode) else None
    if parameters is None and unknown is not None:
        parameters = {}
    if parameters is None and name in SIMULATORS:
        return SIMULATORS[name]()
    if name.endswith(".py"):
        raise InputError(f"simulator needs a function of the file: {name}:FUNCTION, got {name}")
    if not exists:
        raise FileNotFoundError(
            f"simulator must be a file, FILE.py:FUNCTION or one of {', '.join(SIMULATORS)}, "
            f"got {name}"
        )
    if parameters is not None:
        ranges = Parameters.read(parameters).given if isinstance(parameters, str) else parameters
        how = columns, inputs, begin, hold, step, unknown
        return adjustable_from(file, function, ranges, *how)
    if not (fmu or function):
        return _exported(name, record, columns, time_column)
    driven = bool(function) and _takes_inputs(file, function, record)
    outputs, names = () if function else tuple(columns), None if inputs is None else tuple(inputs)
    rest = driven, begin if function else begin or 0.0, hold, step
    made = Isolated(file, function or None, outputs, timeout, names, *rest)
    # For an FMU, `matched` sets `driven`.
    return made.matched(record.columns, record.inputs)


def is_fitted(simulator: Any) -> bool:
    """Return whether a simulator has parameters to fit or, like an `Ode`, needs inputs."""
    return isinstance(simulator, Adjustable) and simulator.adjustable


def check_runs_as_it_is(option: str, value: str | None, simulator: Any) -> None:
    """Raise ValueError for the name of a baseline, and for parameters or terms to fit."""
    fitted = isinstance(simulator, Adjustable) and (
        simulator.known.free or any(term.free for term in simulator.terms)
    )
    if isinstance(simulator, str) or fitted:
        why = "is a baseline" if isinstance(simulator, str) else "has something to fit"
        raise InputError(
            f"{option} must be a file or FILE.py:FUNCTION that is run as it is, got {value}, "
            f"which {why}"
        )


def _takes_inputs(file: str, name: str, record: Record) -> bool:
    """Return whether a function of a file takes time and inputs.

    Raises ValueError for a differential equation, which needs initial states, and for a function of
    time alone that may be meant to take the inputs of the record.
    """
    function = outline(file, name) or named_in(file, name)
    count = count_arguments(function) if callable(function) else 1
    if count >= 3:
        raise InputError(
            f"parameters must say where the states of {file}:{name} begin, a function of "
            f"(t, x, u, p): x0_1=0,x0_2=-1:1, or set the p of (time, u, p); got {count} arguments"
        )
    if count < 2 and record.u is not None and callable(function):
        check_open(function, f"{file}:{name}", record.inputs)
    return count > 1


def _exported(
    file: str, record: Record, columns: Sequence[str], time_column: str | None
) -> Recorded:
    how: dict[str, Any] = {"columns": columns or None, "gaps": "mask"}
    exported = read_beside(file, record.sampling_time, time_column, **how)
    y = exported.y_with_gaps
    if not columns and set(record.columns) <= set(exported.columns):
        y = y[:, [exported.columns.index(name) for name in record.columns]]
    if y.shape[1] != record.ny:
        raise InputError(
            f"{file} must have the record's columns {', '.join(record.columns)}, or columns "
            f"(--simulator-columns) must choose {record.ny} of {', '.join(exported.columns)}"
        )
    missing = np.asarray(np.isnan(y).any(axis=1))
    if missing.any():
        raise InputError(
            f"{file} must have a value at each time, got {missing.sum()} samples without one: "
            f"{row_ranges(missing)}"
        )
    name = f"simulator {file}: the exported trajectory"
    return Recorded(y, exported.sampling_time, exported.start, name)


def read_beside(
    path: str | Path, sampling_time: float, time_column: str | None, **options: Any
) -> Record:
    """Read a file beside a record, with the record's sampling time and time column as defaults.

    The file may have a time column with another usual name.
    """
    options |= {"fallback_sampling_time": sampling_time}
    try:
        return read(path, time_column=time_column, **options)
    except ColumnError:
        if not time_column:
            raise
        return read(path, **options)


def simulated(
    record: Record,
    simulator: Simulator,
    ahead: int = 0,
    longer: bool = False,
    u: Array | None = None,
) -> Record:
    """Return the record with the output of a simulator.

    Parameters
    ----------
    record : The record of the simulation.
    simulator : As for `simulators.run`.
    ahead : Further samples of the output beyond the record.
    longer : Ask for more samples, for a calibration, if the simulator can run longer.
    u : Inputs of the simulator, by default the record's.

    Raises
    ------
    ValueError
        As `simulators.run`, and for a detrended record.
    """
    least = len(record) + ahead
    samples = samples_needed(least, len(record)) if longer else least
    grid, u = Grid(record.start, record.sampling_time, samples), record.u if u is None else u
    known = as_known(simulator)
    check_level(record, known.name)
    samples = min(samples, max(least, known.reach(grid)))
    if not known.own_times:
        known = matched(known, record.columns, record.inputs)
        u = u if known.driven else None
        if u is not None:
            samples = min(samples, len(u))
        begin = origin(known, record.start)
        if record.start:
            facts = known.name, begin, in_words(record.start)
            log.info("%s runs from %g s on, at the record's first sample, %s", *facts)

    def output(samples: int) -> Any:
        if not isinstance(known, Recorded):
            return run(known, samples, grid.step, record.ny, None, grid.start, u)
        resampled = known.on(replace(grid, samples=samples))
        if resampled.note:
            log.info("%s: %s", known.name, resampled.note)
        return resampled.values

    try:
        y_sim = output(samples)
    except InputError as error:
        if samples == least or isinstance(error.__cause__, SimulatorTimeoutError):
            raise
        y_sim = output(least)
    if periods := record.reading.periods:
        y_sim = np.array(y_sim)
        for i, name in enumerate(record.columns):
            if name in periods:
                whole = going_on(y_sim[:, i], periods[name])
                y_sim[:, i] = in_turn(whole, record.y[0, i], periods[name])
    return replace(record, y_sim=y_sim, simulator=known.description())


def trajectory(record: Record, simulator: Simulator, steps: int = 0) -> Record:
    """Run a simulator beside a record; return its output, with equal channels and time stamps.

    The output continues for `steps` samples after the record and, for a calibration of delay and
    clock, further if possible. Written to a file, it can replace the simulator.

    Raises
    ------
    ValueError
        As `simulators.run`, and for `steps` of a simulator driven by the record's inputs.
    """
    if steps and matched(simulator, record.columns, record.inputs).driven:
        raise InputError(
            "steps (--steps) must be left out for a simulator that the record's inputs drive, as "
            f"they end with it; got {steps}"
        )
    whole = simulated(record, simulator, steps, longer=True)
    assert whole.y_sim is not None
    return Record(whole.y_sim, record.sampling_time, start=record.start, columns=record.columns)
