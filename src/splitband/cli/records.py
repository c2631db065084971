"""Read the records, inputs and simulators that options name."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitband.cli import printing
from splitband.cli.options import (
    FileOptions,
    RecordOptions,
    SimulatorOptions,
    joined,
    names,
    periods,
)
from splitband.comparison.methods import BASES
from splitband.forecasters.base import Forecaster
from splitband.forecasters.loading import give_simulator
from splitband.forecasters.prediction import inputs_after
from splitband.forecasters.simulation import description_of, simulations
from splitband.records import Record, read
from splitband.records.alignment import sampled_like
from splitband.records.columns import ColumnError
from splitband.records.named import RECORDS
from splitband.records.signals import described, row_ranges, same_names
from splitband.records.timing import near_sampling
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators import Simulator
from splitband.simulators.open_simulator import (
    check_runs_as_it_is,
    is_fitted,
    open_simulator,
    read_beside,
    simulated,
)
from splitband.simulators.unknown import Unknown


def load_record(name: str, reading: RecordOptions) -> Record:
    """Return a named record, or read a file with a single run; see `load_records`."""
    record, *others = load_records(name, reading)
    if others:
        raise InputError(f"--runs must be left out here, where one record is asked for, got {name}")
    return record


def load_records(
    name: str,
    reading: RecordOptions,
    like: Forecaster | None = None,
    reader: Callable[..., Any] = read,
) -> list[Record]:
    """Return a named record, or read a file, and print channels and inputs of each of its runs.

    With a `reader` of its own nothing is printed.

    Columns and inputs default to those of the model of --like, and the file is read and prepared
    like its training record. Raises ValueError if the record's columns or inputs differ from these.
    """
    trained = None if like is None else like.require_fitted().record
    if name in RECORDS:
        for option, usual in vars(RecordOptions()).items():
            if option != "gaps" and (value := vars(reading)[option]) != usual:
                raise InputError(
                    f"--{option.replace('_', '-')} is for files; {name} is a named record, got "
                    f"{value}"
                )
        found = [RECORDS[name].make()]
    else:
        columns: Any = None if reading.columns is None else names(reading.columns)
        inputs: Any = None if reading.inputs is None else names(reading.inputs)
        if trained is not None and inputs is None:
            inputs = [each for each in trained.inputs if each not in (columns or ())]
        if trained is not None and columns is None:
            columns = [each for each in trained.columns if each not in (inputs or ())]
        rule = f"RECORD must be a file or one of {', '.join(RECORDS)}"
        how: dict[str, Any] = {"sampling_time": reading.sampling_time, "runs": reading.runs}
        how |= {"unwrap": periods(reading.unwrap)} if reading.unwrap else {}
        how |= {"join": joined(reading.join or [])}
        how |= {"clip_outliers": names(reading.clip_outliers or ""), "reader": reader}
        found = _read(name, rule, reading, trained, columns=columns or None, inputs=inputs, **how)
        found = [found[0].detrend(), *found[1:]] if reading.detrend else found
        for record in found:
            if record.measured is not None and reader is read:
                missing = ~record.complete
                printing.console.print(
                    f"{_named(name, record, found)}: {missing.sum()} of {len(missing)} samples "
                    "are masked, as an output is missing, or an input there or just before: "
                    f"{row_ranges(missing)}"
                )
    found = [record.like(trained or found[0]) for record in found]
    for record in found if reader is read else ():
        announce(record, _named(name, record, found))
    record = found[0]
    if trained is not None:
        pairs = ((record.columns, trained.columns), (record.inputs, trained.inputs))
        if not all(same_names(sorted(a), sorted(b)) for a, b in pairs):
            raise InputError(
                f"--like must name a model of such a record: it is for "
                f"{described(trained.columns, trained.inputs)}, the record has "
                f"{described(record.columns, record.inputs)}"
            )
    return found


def _named(file: str, record: Record, runs: Sequence[Record]) -> str:
    """Return the name of a file, with its run where it has several."""
    return file if len(runs) == 1 else f"{file}, {record.name}"


def announce(record: Record, name: str) -> None:
    """Print what a record holds, on one line."""
    printing.console.print(
        f"{name}: {described(*record.labels)}; {len(record)} samples every "
        f"{record.sampling_time:.7g} s"
    )


def _check_file(path: str | Path, rule: str) -> None:
    if not os.path.exists(path):
        raise FileNotFoundError(f"{rule}, got {path}")
    if os.path.isdir(path):
        raise IsADirectoryError(f"{rule}, got the folder {path}")


def _layout(files: FileOptions, model: Record | None = None) -> dict[str, Any]:
    """Return the arguments of `read` that say how a file is laid out, by default as a model's."""
    own = FileOptions.__annotations__.keys() - {"time_column", "gaps"}
    found = {name: vars(files)[name] for name in own}
    listed = {name: names(found[name]) for name in ("hold", "long") if found[name] is not None}
    found |= {"long": (), "missing": names(files.missing or ""), **listed}
    return found | {"reading": None if model is None else model.reading}


def _read(
    path: str | Path,
    rule: str,
    files: FileOptions,
    model: Record | None,
    reader: Callable[..., Any] = read,
    **options: Any,
) -> list[Record]:
    """Read the runs of a file as these options say, and otherwise as a model's record was read.

    The error for a missing column names those of the model.
    """
    _check_file(path, rule)
    printing.console.print(f"reading {path}")
    options = _layout(files, model) | {"time_column": files.time_column} | options
    options["gaps"] = files.gaps
    options |= {} if model is None else {"fallback_sampling_time": _step_of(model)}
    try:
        found = reader(path, **options)
    except ColumnError as error:
        if model is None:
            raise
        needed = described(model.columns, model.inputs)
        raise ColumnError(f"{error}; the model is for {needed}") from None
    return found if isinstance(found, list) else [found]


def _beside(
    path: str | Path, option: str, record: Record, files: FileOptions, **options: Any
) -> Any:
    """Read what accompanies a record, not yet prepared like it; see `read_beside`."""
    _check_file(path, f"{option} must be a file")
    step, options = _step_of(record), options | _layout(files, record)
    return read_beside(path, step, files.time_column, **options)


def _step_of(record: Record) -> float:
    """Return the sampling time in s at which a record was measured."""
    return record.reading.step or record.sampling_time


def load_further(
    option: str,
    files: Sequence[str] | None,
    simulators: Sequence[str] | None,
    record: Record,
    reading: RecordOptions,
    options: SimulatorOptions,
) -> list[Record]:
    """Return the records of --more or --test (`option`), with the columns of `record`.

    If there are `simulators`, each record has its own, which is run as the `options` say.
    """
    files, simulators = files or [], simulators or []
    if simulators and len(simulators) != len(files):
        raise InputError(
            f"{option}-simulator must be given once for each {option}, got {len(simulators)} for "
            f"{len(files)}"
        )
    if simulators and reading.runs is not None:
        raise InputError(
            f"{option}-simulator must be left out with --runs, got {', '.join(simulators)}"
        )
    found = []
    how: dict[str, Any] = {"columns": record.columns, "inputs": record.inputs}
    how |= {"gaps": reading.gaps, "runs": reading.runs}
    of_files = [(file, _beside(file, option, record, reading, **how)) for file in files]
    for i, (file, read_of) in enumerate(of_files):
        for each in read_of if isinstance(read_of, list) else [read_of]:
            several = reading.runs is not None
            named = f"{file}, {each.name}" if several else file
            more = each.like(record)
            announce(more, named)
            more = sampled_like(more, record.sampling_time, named)
            called = each.name if several else file if option == "--more" else Path(file).stem
            more = replace(more, name=called)
            if simulators:
                own = replace(options, simulator=simulators[i])
                beside = simulator_of(own, more, reading.time_column)
                check_runs_as_it_is(f"{option}-simulator", simulators[i], beside)
                more = simulated(more, beside, longer=True)
            found.append(more)
    return found


def history_of(file: Path, option: str, model: Forecaster, files: FileOptions) -> Record:
    """Read the measured history that an option names, prepared like the training record."""
    record = model.require_fitted().record
    step = record.sampling_time
    try:
        own: dict[str, Any] = {"columns": record.columns, "inputs": record.inputs}
        rule = f"{option} must be a file"
        past = _read(file, rule, files, record, **own)[0]
    except ColumnError as error:
        raise ColumnError(
            f"{error}; {option} must have all of these, as measured outputs set the initial state "
            "of the model"
        ) from None
    past = replace(past, columns=record.columns).like(record)
    announce(past, str(file))
    if not near_sampling(past.sampling_time, step):
        raise InputError(
            f"{option} must be sampled like the training record, every {step:g} s, got every "
            f"{past.sampling_time:g} s in {file}"
        )
    if past.start is None and record.start is not None:
        printing.console.print(
            f"{file}: no time stamps, the training record has some: taken to begin together; "
            "--time-column names the column"
        )
    return sampled_like(past, step, str(file))


def inputs_ahead(
    file: Path | None, known: Record, steps: int, files: FileOptions, since: int = 0
) -> Array | None:
    """Return the known inputs after a record, `(steps or more, nu)`; None without inputs.

    From a named record without time stamps, they are taken from its sample `since` on. Raises
    ValueError for a file whose first row may lie at the beginning of the record or at its end.
    """
    inputs = known.inputs
    if file is None:
        if inputs:
            raise InputError(
                f"this record has known inputs ({', '.join(inputs)}): give their future values "
                "with --future-inputs FILE"
            )
        return None
    if not inputs:
        raise InputError("this record has no known inputs: leave out --future-inputs")
    if str(file) in RECORDS:
        named = RECORDS[str(file)].make()
        assert named.u is not None
        coming = replace(named, y=named.u, y_sim=None, y_true=None, columns=named.inputs)
        if named.start is None:
            coming = replace(coming[since:], start=known.grid.after(steps).start)
    else:
        if known.reading.hold is None and files.hold is None:
            files = replace(files, hold=",".join(f'"{each}"' for each in inputs))
        coming = _beside(file, "--future-inputs", known, files, columns=(), inputs=inputs)
    return inputs_after(known, coming, steps, f"--future-inputs {file}", files.time_column != "")


def simulator_of(options: SimulatorOptions, record: Record, time_column: str | None = None) -> Any:
    """Return the simulator that the options name, or the name of a baseline; None without any."""
    name = options.simulator
    of_runs = ("inputs", "hold", "start", "step")
    given = [f"--simulator-{of}" for of in of_runs if vars(options)[f"simulator_{of}"] is not None]
    if (name is None or name in BASES) and given:
        option = given[0]
        raise InputError(
            f"--simulator must be given where {option} is, as an .fmu or FILE.py:FUNCTION, got "
            f"{name or 'none'}"
        )
    fitted = options.parameters is not None or options.unknown is not None or options.unknown_odd
    if not fitted and (name is None or name in BASES):
        return name
    printing.console.print(f"opening the simulator {name}")
    return open_simulator(name or "", record, **_how(options, time_column))


def _how(options: SimulatorOptions, time_column: str | None) -> dict[str, Any]:
    """Return the arguments of `open_simulator` that say how a simulator is opened."""
    how = {option.removeprefix("simulator_"): value for option, value in vars(options).items()}
    del how["simulator"]
    odd = how.pop("unknown_odd")
    if options.unknown is not None:
        how["unknown"] = [Unknown(names(of), odd=odd) for of in options.unknown]
    elif odd:
        raise InputError("--unknown must say of what the unknown terms are functions, such as x2")
    if (inputs := options.simulator_inputs) is not None:
        how["inputs"] = names(inputs, blank=True) if inputs.strip() else []
    return how | {"columns": names(options.simulator_columns or ""), "time_column": time_column}


def elsewhere(
    asked: Sequence[str], record: Record, reading: RecordOptions
) -> dict[str, list[Simulator]]:
    """Return the simulations of --also, by the name of their first file."""
    found = dict[str, list[Simulator]]()
    for files in (names(text) or [text] for text in asked):
        if files[0] in found:
            raise InputError(f"--also must name a file once, got {files[0]} again")
        for file in files:
            _check_file(file, "--also must be a file")
        try:
            runs = [open_simulator(file, record, time_column=reading.time_column) for file in files]
        except InputError as error:
            raise InputError(f"--also: {error}") from None
        found[files[0]] = runs
    return found


def runnable(options: SimulatorOptions, record: Record, time_column: str | None = None) -> Any:
    """Return the simulator that the options name, which must have nothing to fit."""
    found = simulator_of(options, record, time_column)
    check_runs_as_it_is("--simulator", options.simulator, found)
    return found


def simulator_ahead(
    options: SimulatorOptions, record: Record, steps: int, u: Array | None, files: FileOptions
) -> Array | None:
    """Return the simulator's output after a record, `(steps or more, ny)`.

    `u` are the inputs after it. None for a record without a simulator that is run as it is.
    """
    if record.y_sim is None:
        return None
    simulator = simulator_of(options, record, files.time_column)
    if simulator is None or isinstance(simulator, str) or is_fitted(simulator):
        simulator = open_simulator(record.name, record)  # a named record's own
    driving = u if u is None or record.u is None else np.concatenate([record.u, u])
    found = simulated(record, simulator, steps, longer=True, u=driving).y_sim
    return None if found is None else found[len(record) :]


def with_simulator(
    model: Forecaster, options: SimulatorOptions, past: Record, files: FileOptions, steps: int = 0
) -> None:
    """Give a saved model the simulator that the options name."""
    if (name := options.simulator) is not None:
        with printing.warnings_as_lines():
            give_simulator(model, name, past, steps, **_how(options, files.time_column))
    elif "simulator" in model.needs or model.parameters:
        said = next(filter(None, map(description_of, simulations(model))), "")
        raise InputError(
            f"--simulator must be given for {model.name}, which runs a simulator {said}".rstrip()
            + ": --simulator FILE.py:NAME, an FMU, or a file with its output"
        )
