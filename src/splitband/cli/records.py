"""Read the records, inputs and simulators that options name, and align them in time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splitband.cli import printing
from splitband.cli.options import (
    FileOptions,
    RecordOptions,
    SimulatorOptions,
    names,
    periods,
)
from splitband.comparison.methods import BASES
from splitband.data import Record, aligned, read, resampled
from splitband.data.alignment import reach
from splitband.data.named import RECORDS
from splitband.data.preparation import seconds
from splitband.data.reading import ColumnError
from splitband.data.signals import described, row_ranges, same_names
from splitband.data.timing import near_sampling, same_sampling
from splitband.forecasters.base import Forecaster
from splitband.forecasters.loading import load
from splitband.forecasters.prediction import continued
from splitband.forecasters.simulation import description_of, simulations
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.base import Recorded, matched
from splitband.simulators.open_simulator import is_fitted, open_simulator, read_beside, simulated
from splitband.simulators.parameters import Adjustable


def load_record(name: str, reading: RecordOptions, like: Forecaster | None = None) -> Record:
    """Return a named record, or read a file, and print its channels and inputs.

    Columns and inputs default to those of the model of --like. Raises ValueError if the record's
    differ from these.
    """
    trained = None if like is None else like.require_fitted().record
    if name in RECORDS:
        for option, usual in vars(RecordOptions()).items():
            if option != "gaps" and (value := getattr(reading, option)) != usual:
                raise InputError(
                    f"--{option.replace('_', '-')} is for files; {name} is a named record, got "
                    f"{value}"
                )
        record = RECORDS[name].make()
    else:
        columns, inputs = (
            None if given is None else names(given) for given in (reading.columns, reading.inputs)
        )
        if trained is not None and inputs is None:
            inputs = [each for each in trained.inputs if each not in (columns or ())]
        if trained is not None and columns is None:
            columns = [each for each in trained.columns if each not in (inputs or ())]
        record = _read(
            name, f"RECORD must be a file or one of {', '.join(RECORDS)}", reading, trained,
            columns=columns or None, inputs=inputs, sampling_time=reading.sampling_time,
            unwrap=periods(reading.unwrap or []),
        )  # fmt: skip
        if reading.clip_outliers:
            record = record.clip_outliers(columns=names(reading.clip_outliers))
        if record.measured is not None:
            missing = ~record.complete
            printing.console.print(
                f"{name}: {missing.sum()} of {len(missing)} samples have missing values "
                f"and are masked: {row_ranges(missing)}"
            )
    announce(record, name)
    if trained is not None:
        pairs = ((record.columns, trained.columns), (record.inputs, trained.inputs))
        if not all(same_names(sorted(a), sorted(b)) for a, b in pairs):
            raise InputError(
                f"--like must name a model of such a record: it is for "
                f"{described(trained.columns, trained.inputs)}, the record has "
                f"{described(record.columns, record.inputs)}"
            )
    return record


def announce(record: Record, name: str) -> None:
    """Print what a record holds, on one line."""
    printing.console.print(
        f"{name}: {described(record.columns, record.inputs)}; {len(record)} samples every "
        f"{record.sampling_time:.7g} s"
    )


def _check_file(path: str | Path, rule: str) -> None:
    if not os.path.exists(path):
        raise FileNotFoundError(f"{rule}, got {path}")
    if os.path.isdir(path):
        raise IsADirectoryError(f"{rule}, got the folder {path}")


def _layout(files: FileOptions) -> dict[str, Any]:
    """Return the arguments of `read` that say how a file is laid out."""
    own = FileOptions.__annotations__.keys() - {"time_column", "gaps"}
    return {name: getattr(files, name) for name in own} | {"missing": names(files.missing or "")}


def _read(
    path: str | Path, rule: str, files: FileOptions, model: Record | None, **options: Any
) -> Record:
    """Read a file as these options say; the error for a missing column names those of a model."""
    _check_file(path, rule)
    options |= {"time_column": files.time_column, "gaps": files.gaps, **_layout(files)}
    try:
        return read(path, **options)
    except ColumnError as error:
        if model is None:
            raise
        needed = described(model.columns, model.inputs)
        raise ColumnError(f"{error}; the model is for {needed}") from None


def _beside(
    path: str | Path, option: str, sampling_time: float, files: FileOptions, **options: Any
) -> Record:
    """Read a file that accompanies a record; see `read_beside`."""
    _check_file(path, f"{option} must be a file")
    return read_beside(path, sampling_time, files.time_column, **_layout(files), **options)


def _sampled_like(record: Record, sampling_time: float, what: str) -> Record:
    """Resample a record to a sampling time that differs from its own by 1 % at most.

    Return it unchanged if they differ by more, or if both grids end within half a sample.
    """
    if not near_sampling(record.sampling_time, sampling_time) or same_sampling(
        record.sampling_time, sampling_time, len(record)
    ):
        return record
    printing.console.print(
        f"{what}: sampled every {record.sampling_time:.7g} s, interpolated to every "
        f"{sampling_time:.7g} s"
    )
    return resampled(record, sampling_time)


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
    found = []
    how = {"columns": record.columns, "inputs": record.inputs, "gaps": reading.gaps}
    for i, file in enumerate(files):
        more = _beside(file, option, record.sampling_time, reading, **how)
        announce(more, file)
        more = _sampled_like(more.prepared_as(record), record.sampling_time, file)
        more = replace(more, name=file if option == "--more" else Path(file).stem)
        if simulators:
            own = replace(options, simulator=simulators[i])
            beside = simulator_of(own, more, reading.time_column)
            _check_run_as_it_is(f"{option}-simulator", simulators[i], beside)
            more = simulated(more, beside, longer=True)
        found.append(more)
    return found


def history_of(file: Path, option: str, model: Forecaster, files: FileOptions) -> Record:
    """Read the measured history that an option names, at the training record's sampling time."""
    record = model.require_fitted().record
    step = record.sampling_time
    try:
        past = _read(
            file, f"{option} must be a file", files, record, columns=record.columns,
            inputs=record.inputs, fallback_sampling_time=step,
        )  # fmt: skip
    except ColumnError as error:
        raise ColumnError(
            f"{error}; a simulation begins with {model.warmup or 'some'} measured samples of every "
            "output, from which the state of the model is estimated"
        ) from None
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
    return replace(_sampled_like(past, step, str(file)), columns=record.columns)


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
    option, ahead = f"--future-inputs {file}", known.grid.after(steps)
    if files.time_column == "":  # no time stamp counts, those of a saved record included
        ahead = replace(ahead, start=None)
    if str(file) in RECORDS:
        named = RECORDS[str(file)].make()
        assert named.u is not None
        coming = replace(named, y=named.u, y_sim=None, y_true=None, columns=named.inputs)
        coming = coming if named.start is not None else coming[since:]
    else:
        coming = _beside(file, "--future-inputs", ahead.step, files, columns=inputs)
        if (coming.start is None) != (ahead.start is None):
            lacks = "the planned inputs" if coming.start is None else "these samples"
            raise InputError(
                f"{option} and the samples before it must both have time stamps, or neither: "
                f"{lacks} have none, so that the first planned row may belong to the first of "
                "these samples or follow the last; with --time-column '' no stamps count, and it "
                "follows the last"
            )
    # Linear interpolation, as inputs may jump.
    u = aligned(option, coming.y, coming.grid, ahead, smooth=False)
    if u.note:
        printing.console.print(f"{file}: {u.note}")
    if (more := reach(coming.grid, ahead)) > steps:  # for a simulator whose output is late
        ahead = replace(ahead, samples=more)
        u = aligned(option, coming.y, coming.grid, ahead, smooth=False)
    assert known.u is not None
    whole = continued(option, known.u, u.values, steps)
    for step in known.prepared:
        whole = step.transform("u", whole, seconds(known)[0] + ahead.step * np.arange(len(whole)))
    return whole[len(known) :]


def simulator_of(options: SimulatorOptions, record: Record, time_column: str | None = None) -> Any:
    """Return the simulator that the options name, or the name of a baseline; None without any."""
    name, inputs = options.simulator, options.simulator_inputs
    of_runs = ("inputs", "hold", "start", "step")
    given = [f"--simulator-{of}" for of in of_runs if vars(options)[f"simulator_{of}"] is not None]
    if (name is None or name in BASES) and given:
        option = given[0]
        raise InputError(
            f"--simulator must be given where {option} is, as an .fmu or FILE.py:FUNCTION, got "
            f"{name or 'none'}"
        )
    if options.parameters is None and (name is None or name in BASES):
        return name
    how = {option.removeprefix("simulator_"): value for option, value in vars(options).items()}
    how["columns"] = names(options.simulator_columns or "")
    if inputs is not None:
        how["inputs"] = names(inputs, blank=True) if inputs.strip() else []
    return open_simulator(how.pop("simulator") or "", record, time_column=time_column, **how)


def runnable(options: SimulatorOptions, record: Record, time_column: str | None = None) -> Any:
    """Return the simulator that the options name, which must have nothing to fit."""
    found = simulator_of(options, record, time_column)
    _check_run_as_it_is("--simulator", options.simulator, found)
    return found


def simulator_ahead(
    name: str, options: SimulatorOptions, record: Record, steps: int, u: Array | None,
    time_column: str | None,
) -> Array | None:  # fmt: skip
    """Return the simulator's output after a record of this name, `(steps or more, ny)`.

    `u` are the inputs after it. None for a record without a simulator that is run as it is.
    """
    if record.y_sim is None:
        return None
    simulator = simulator_of(options, record, time_column)
    if simulator is None or isinstance(simulator, str) or is_fitted(simulator):
        simulator = open_simulator(name, record)  # a named record's own
    driving = u if u is None or record.u is None else np.concatenate([record.u, u])
    found = simulated(record, simulator, steps, longer=True, u=driving).y_sim
    return None if found is None else found[len(record) :]


def _check_run_as_it_is(option: str, given: str | None, simulator: Any) -> None:
    """Raise InputError for a baseline, and for parameters that would have to be fitted."""
    if isinstance(simulator, str) or (isinstance(simulator, Adjustable) and simulator.known.free):
        why = "is a baseline" if isinstance(simulator, str) else "has parameters to fit"
        raise InputError(
            f"{option} must be a file or FILE.py:FUNCTION that is run as it is, got {given}, "
            f"which {why}"
        )


def with_simulator(
    model: Forecaster, folder: Path, options: SimulatorOptions, past: Record, steps: int,
    time_column: str | None,
) -> Forecaster:  # fmt: skip
    """Return the saved model with the simulator that the options name."""
    if options.simulator is None:
        if "simulator" in model.needs or model.parameters:
            raise InputError(f"--simulator must be given for {model.name}, which runs one")
        return model
    used, runs = model.parameters.get("used"), ".py:" in options.simulator
    runs |= options.simulator.lower().endswith(".fmu")
    for saved in filter(None, map(description_of, simulations(model)) if runs else ()):
        hold = options.simulator_hold or saved.hold  # what is not given is as it was
        start = options.simulator_start or (str(saved.start) if saved.start else None)
        step = options.simulator_step or saved.step
        options = replace(options, simulator_hold=hold, simulator_start=start, simulator_step=step)
    if used is not None:
        if not runs:
            raise InputError(
                f"--simulator must be the FILE.py:FUNCTION or .fmu that {model.name} was fitted "
                f"with, got {options.simulator}"
            )
        own = ",".join(f"{name}={value!r}" for name, value in used.items())
        options = replace(options, parameters=options.parameters or own)
    found = simulator_of(options, past, time_column)
    if used is None:
        _check_run_as_it_is("--simulator", options.simulator, found)
        found = matched(found, past.columns, past.inputs)
    if isinstance(found, Recorded):
        if found.start is None:  # it is taken to begin with the history
            found = replace(found, start=past.start)
        if note := found.note(past.grid.after(steps)):
            printing.console.print(f"{options.simulator}: {note}")
    with printing.warnings_as_lines():
        return load(folder, found)
