"""Run the simulator that --simulator names, whose output becomes the record's `y_sim`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from splitband.cli import showing
from splitband.cli.options.records import FileOptions, RecordOptions
from splitband.cli.options.simulators import SimulatorOptions, parts_of
from splitband.cli.options.values import names
from splitband.cli.records import announce, read_companion, sampled_like
from splitband.data import Grid, Record
from splitband.data.timing import in_words
from splitband.forecasters import saving as forecasters
from splitband.forecasters.base import Forecaster
from splitband.forecasters.names import BASES
from splitband.runtime.errors import InputError
from splitband.simulators import Recorded, Simulator, SimulatorTimeoutError, run
from splitband.simulators.base import check_start, is_driven, matched, origin
from splitband.simulators.calibration import samples_needed
from splitband.simulators.code import check_open, count_arguments, outline
from splitband.simulators.isolation import Isolated, named_in, opened
from splitband.simulators.named import SIMULATORS
from splitband.simulators.parameters import Adjustable, Parameters

AnyOptions = TypeVar("AnyOptions", bound=SimulatorOptions)


def with_simulator(
    record: Record,
    options: SimulatorOptions,
    reading: RecordOptions,
    ahead: int = 0,
    beyond: bool = False,
) -> Record:
    """Return the record with the output of the simulator that the options name.

    The output has to reach `ahead` samples beyond the record. `beyond` asks for more samples, for
    calibration, if the simulator can run that long. `reading` says how the record was read.
    """
    simulator = options.simulator
    if options.parameters is not None:  # it is run when its parameters are fitted
        return record
    if simulator is None and (beyond or ahead) and record.y_sim is not None:
        simulator = record.name  # run a named record's own simulator for longer
    if simulator is None or simulator in BASES:
        return record
    options = replace(options, simulator=simulator)
    opened = opened_simulator(options, record, reading.time_column)
    least = len(record) + ahead
    samples = samples_needed(least, len(record)) if beyond else least
    grid = Grid(record.start, record.sampling_time, samples)
    u = None
    if isinstance(opened, Recorded):
        samples = min(samples, max(least, opened.reach(grid)))
    else:
        opened = matched(opened, record.columns, record.inputs)
        if is_driven(opened) and record.u is not None:
            u = record.u if record.u_beyond is None else np.vstack([record.u, record.u_beyond])
            samples = min(samples, len(u))
        begin = origin(opened, record.start)
        if record.start:
            showing.console.print(
                f"{simulator} runs from {begin:g} s on, at the record's first sample, "
                f"{in_words(record.start)}"
            )
    try:
        y_sim = _simulated(opened, options, replace(grid, samples=samples), record.ny, u)
    except InputError as error:
        if samples == least or isinstance(error.__cause__, SimulatorTimeoutError):
            raise
        y_sim = _simulated(opened, options, replace(grid, samples=least), record.ny, u)
    rest = y_sim[len(record) :]
    return replace(record, y_sim=y_sim[: len(record)], beyond=rest if len(rest) else None)


def _simulated(
    opened: Simulator,
    options: SimulatorOptions,
    grid: Grid,
    ny: int,
    u: npt.NDArray[np.float64] | None,
) -> npt.NDArray[np.float64]:
    """Return the simulator's output at the times of the grid, `(samples, ny)`."""
    if isinstance(opened, Recorded):
        on_grid = opened.on(grid)
        if on_grid.note:
            showing.console.print(f"{options.simulator}: {on_grid.note}")
        return on_grid.values
    cache, name = options.simulator_cache, options.simulator
    return run(opened, grid.samples, grid.step, ny, cache, name, grid.start, u)


def load_further(
    option: str,
    files: Sequence[str] | None,
    simulators: Sequence[str] | None,
    record: Record,
    reading: RecordOptions,
    options: SimulatorOptions,
    needed: bool = False,
    beyond: bool = True,
) -> list[Record]:
    """Return the records of --more or --test (`option`), with the columns of `record`.

    If there are `simulators`, or they are `needed`, each record has its own; `beyond` asks for an
    output that is longer than the record.
    """
    files, simulators = files or [], simulators or []
    if (simulators or needed) and len(simulators) != len(files):
        raise InputError(
            f"{option}-simulator must be given once for each {option}, got {len(simulators)} for "
            f"{len(files)}"
        )
    found = []
    for i, file in enumerate(files):
        more = read_companion(
            file,
            option,
            record.sampling_time,
            reading,
            columns=record.columns,
            inputs=record.inputs,
            gaps=reading.gaps,
        )
        announce(more, file)
        more = sampled_like(more, record.sampling_time, file)
        more = replace(more, name=file if option == "--more" else Path(file).stem)
        if simulators:
            own = replace(options, simulator=simulators[i])
            more = with_simulator(more, own, reading, beyond=beyond)
        found.append(more)
    return found


def opened_simulator(
    options: SimulatorOptions, record: Record, time_column: str | None = None
) -> Simulator:
    """Return the simulator that --simulator names, with the columns of --simulator-columns."""
    text, timeout = options.simulator or "", options.simulator_timeout
    if not math.isfinite(timeout):
        raise InputError(f"--simulator-timeout must be a number of seconds, got {timeout:g}")
    columns = names(options.simulator_columns or "")
    file, function = parts_of(text)
    _check_used(options, file, function)
    if text in SIMULATORS:
        return SIMULATORS[text]()
    if text.endswith(".py"):
        raise InputError(f"--simulator needs a function of the file, {text}:FUNCTION, got {text}")
    if not Path(file).is_file():
        raise FileNotFoundError(
            f"--simulator must be a file, FILE.py:FUNCTION or one of {', '.join(SIMULATORS)}, "
            f"got {text}"
        )
    reads = tuple(options.simulator_reads or ())
    for each in reads:
        if not Path(each).is_file():
            raise FileNotFoundError(f"--simulator-reads must be a file, got {each}")
    cache = None if options.simulator_cache is None else str(options.simulator_cache)
    if function or text.lower().endswith(".fmu"):
        outputs = () if function else tuple(columns)
        driven = bool(function) and _takes_inputs(file, function, record)
        start = _start_of(options)
        start = start if function else start or 0.0
        return Isolated(file, function or None, outputs, timeout, reads, cache,
                        _inputs_of(options), driven, start)  # fmt: skip
    files = FileOptions(time_column)  # the layout is that of the record
    exported = read_companion(
        text, "--simulator", record.sampling_time, files, columns=columns or None
    )
    y = exported.y
    if not columns and set(record.columns) <= set(exported.columns):
        y = y[:, [exported.columns.index(name) for name in record.columns]]
    if y.shape[1] != record.ny:
        raise InputError(
            f"--simulator-columns must choose {record.ny} column(s), as many as the record has, "
            f"out of {', '.join(exported.columns)} in {text}"
        )
    name = f"simulator {text}: the exported trajectory"
    return Recorded(y, exported.sampling_time, exported.start, name)


def opened_with_simulator(
    forecaster: Forecaster,
    folder: Path,
    options: SimulatorOptions,
    past: Record,
    steps: int,
    time_column: str | None,
) -> Forecaster:
    """Return the forecaster with the simulator that the options name."""
    if options.simulator is None:
        if "simulator" in forecaster.needs or forecaster.parameters:
            raise InputError(f"--simulator must be given for {forecaster.name}, which runs one")
        return forecaster
    if used := forecaster.parameters.get("used"):
        own = ",".join(f"{name}={value!r}" for name, value in used.items())
        found: Any = adjustable(replace(options, parameters=options.parameters or own))
    else:
        found = matched(opened_simulator(options, past, time_column), past.columns, past.inputs)
    if isinstance(found, Recorded):
        if found.start is None:  # it is taken to begin with the history
            found = replace(found, start=past.start)
        if note := found.note(past.grid.after(steps)):
            showing.console.print(f"{options.simulator}: {note}")
    with showing.warnings_as_lines():
        return forecasters.load(folder, found)


def _check_used(options: SimulatorOptions, file: str, function: str) -> None:
    """Raise ValueError for options that a simulator of this kind does not use."""
    fmu = file.lower().endswith(".fmu")
    if options.simulator_inputs is not None and not fmu:
        raise InputError(f"--simulator-inputs is for an .fmu, got --simulator {options.simulator}")
    if options.simulator_start is not None and not (fmu or function):
        raise InputError(
            f"--simulator-start is for an .fmu or a function, got --simulator {options.simulator}"
        )


def _inputs_of(options: SimulatorOptions) -> tuple[str, ...] | None:
    """Return the names of --simulator-inputs; None without them."""
    given = options.simulator_inputs
    return None if given is None else tuple(names(given, blank=True)) if given.strip() else ()


def _start_of(options: SimulatorOptions) -> Any:
    """Return --simulator-start as a simulator takes it; None without it."""
    try:
        return check_start(options.simulator_start)
    except ValueError:
        raise InputError(
            f"--simulator-start must be a number of seconds or record, got "
            f"{options.simulator_start}"
        ) from None


def _takes_inputs(file: str, name: str, record: Record) -> bool:
    """Return whether a function of a file is one of time and inputs.

    Raises ValueError for a differential equation, whose states have to be named, and for a function
    of time alone that may be meant to take the inputs of the record.
    """
    function = outline(file, name) or named_in(file, name)
    count = count_arguments(function) if callable(function) else 1
    if count >= 3:
        raise InputError(
            f"--parameters must say where the states of {file}:{name} begin, a function of "
            f"(t, x, u, p): x0_1=0,x0_2=-1:1, or set the p of (time, u, p); got {count} arguments"
        )
    if count < 2 and record.u is not None and callable(function):
        check_open(function, f"{file}:{name}", record.inputs)
    return count > 1


def with_own_parameters(options: AnyOptions) -> AnyOptions:
    """Set --parameters if FILE.py:NAME is an `sb.Ode` with parameters to fit, or with inputs."""
    file, name = parts_of(options.simulator or "")
    known = options.parameters is not None or outline(file, name) is not None
    if known or not name or not Path(file).is_file():
        return options
    fitted = getattr(named_in(file, name), "adjustable", False)
    return replace(options, parameters="") if fitted else options


def adjustable(options: SimulatorOptions) -> Adjustable | None:
    """Return the simulator whose parameters are fitted; None without --parameters."""
    if options.parameters is None:
        return None
    file, function = parts_of(options.simulator or "")
    _check_used(options, file, function)
    if not function and not file.lower().endswith(".fmu"):
        raise InputError(
            "--parameters is for a --simulator that can be run again, FILE.py:FUNCTION or an .fmu, "
            f"got {options.simulator or 'none'}"
        )
    if not Path(file).is_file():
        raise FileNotFoundError(f"--simulator must be a file, got {file}")
    given = Parameters.read(options.parameters).given
    columns = names(options.simulator_columns or "")
    return opened(file, function, given, columns, _inputs_of(options), _start_of(options))
