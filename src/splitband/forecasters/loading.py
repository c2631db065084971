"""Load what was saved, with the simulator that it was fitted with."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitband.data import Record
from splitband.data.alignment import log
from splitband.data.preparation import check_level
from splitband.forecasters import (  # noqa: F401  what can be loaded is defined there
    baselines,
    ensemble,
    grey_box,
    hybrid,
    linear,
    simulation,
)
from splitband.forecasters.base import Forecaster
from splitband.forecasters.saving import FILE, read
from splitband.forecasters.simulation import description_of, simulations
from splitband.runtime.errors import InputError
from splitband.runtime.outputs import MODEL_FOLDER
from splitband.simulators import Simulator
from splitband.simulators.base import KnownSimulator, Recorded, as_known, matched
from splitband.simulators.open_simulator import check_runs_as_it_is, open_simulator


def load(folder: str | Path, simulator: Simulator | None = None) -> Forecaster:
    """Read what `Forecaster.save` wrote.

    Parameters
    ----------
    folder : Of the forecaster, or of the result of a comparison or a forecast, which holds one.
    simulator : The one that it was fitted with, such as `sb.Fmu("rig.fmu")`, or a replacement. A
        forecaster that needs one loads without it, but cannot predict.

    Raises
    ------
    FileNotFoundError
        When a file is missing.
    ValueError
        When a file is damaged, of another format, or needs a class of your own whose module has
        not been imported; for a folder that holds two forecasters; for a simulator that the
        forecaster does not need, or whose `start` or `hold` is not that of the saved one.

    Warns
    -----
    UserWarning
        When the simulator differs from the one that the forecaster was saved with.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> model = sb.Periodic().fit(record)
    >>> model.save("model")
    >>> bool(np.allclose(sb.load("model").predict(20).y, model.predict(20).y))
    True
    """
    loaded = read(_of_result(Path(folder)))
    if simulator is not None:
        _give(loaded, as_known(simulator))
    return loaded


def give_simulator(
    forecaster: Forecaster, name: str, past: Record, steps: int = 0, **how: Any
) -> None:
    """Open the simulator that a text stands for, and set it as that of a loaded forecaster.

    `how` holds arguments of `open_simulator`; what is not given of them is as it was saved. Output
    that was exported without time stamps begins with `past`, after which `steps` are predicted.

    Raises ValueError as `open_simulator` and `load`, and for parameters that are not fitted.
    """
    used, runs = forecaster.parameters.get("used"), ".py:" in name or name[-4:].lower() == ".fmu"
    for saved in filter(None, map(description_of, simulations(forecaster)) if runs else ()):
        own = {"hold": saved.hold, "start": saved.start or None, "step": saved.step}
        how |= {option: value for option, value in own.items() if how.get(option) is None}
    if used is not None:
        if not runs:
            raise InputError(
                f"simulator must be the FILE.py:FUNCTION or .fmu that {forecaster.name} was fitted "
                f"with, got {name}"
            )
        how["parameters"] = how.get("parameters") or used
    found = open_simulator(name, past, **how)
    if used is None:
        check_runs_as_it_is("simulator", name, found)
        found = matched(found, past.columns, past.inputs)
    if isinstance(found, Recorded):
        found = replace(found, start=past.start) if found.start is None else found
        if note := found.note(past.grid.after(steps)):
            log.info("%s: %s", name, note)
    _give(forecaster, found)


def _of_result(folder: Path) -> Path:
    """Return the folder of the forecaster that a folder holds, itself or as the result of a run."""
    inner = folder / MODEL_FOLDER
    if not (inner / FILE).is_file():
        return folder
    if (folder / FILE).is_file():
        raise InputError(
            f"folder must hold one model, got two: {folder / FILE}, of `fit`, and {inner / FILE}, "
            f"of `compare` or `forecast`; name {inner}, or remove it to have the other one"
        )
    return inner


def _give(forecaster: Forecaster, simulator: KnownSimulator) -> None:
    """Set the simulator of a forecaster, with a warning if it differs from the saved one.

    Raises ValueError if it begins at another time, and for one that was run beside a record that
    was then detrended.
    """
    given = [*simulations(forecaster)]
    if not given:
        raise InputError(f"simulator must be left out for {forecaster.name}, which asks for none")
    differences = []
    for each in given:
        other = simulator
        if each.simulator is None and each.fitted is not None:  # it was run beside the record
            record = each.fitted.record
            check_level(record, each.name)
            other = matched(simulator, record.columns, record.inputs)
        if (saved := description_of(each)) is not None:
            differences.append(saved.difference(other))
    for said in filter(None, dict.fromkeys(differences)):
        warnings.warn(said, stacklevel=3)
    for each in given:
        each.simulator = simulator
