"""Open a simulator whose parameters are fitted: a function of a Python file, or an FMU.

`cli.simulators` opens simulators without fitted parameters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

from splitband.simulators.fmu import Fmu
from splitband.simulators.function import Function, UserCode
from splitband.simulators.isolation import named_in
from splitband.simulators.ode import Ode
from splitband.simulators.parameters import INITIAL, Parameters
from splitband.simulators.shooting import Adjustable
from splitband.simulators.sources import digest, source_files
from splitband.simulators.starting import Start, count_arguments


def opened(
    file: str,
    name: str,
    given: Mapping[str, Any],
    outputs: Sequence[str] = (),
    inputs: Sequence[str] | None = None,
    start: Start | None = None,
) -> Adjustable:
    """Return a simulator with these parameters.

    Raises ValueError for a file that cannot be run, or whose `name` is missing or of another type.

    Parameters
    ----------
    file : An .fmu, or a Python file, which is run.
    name : Name in the Python file; empty for an FMU. It stands for an `Ode`, a `Function`, a
        function of time as `Function` takes it, or a function `rhs(t, x, u, p)` of four arguments:
        the right-hand side of an `Ode` whose first state is measured.
    given : Parameters, which override those of an `Ode` or a `Function` in the file.
    outputs, inputs : Variables of an FMU.
    start : Of the simulator; None for its own.
    """
    if not name:
        return Fmu(file, outputs or None, dict(given), inputs, start or 0.0)
    contents = digest(source_files(file))
    found, key = _defined(file, name, contents), f"{contents} {name}"
    if isinstance(found, UserCode):
        parameters = {**(found.parameters or {}), **given}
        simulator: Any = replace(found, parameters=parameters, key=key)  # type: ignore[type-var]
    elif not callable(found):
        raise ValueError(f"{file} must define a function, an Ode or a Function {name}")
    elif count_arguments(found) == 4:
        simulator = Ode(found, _initial(given), parameters=dict(given), key=key)
    else:
        simulator = Function(found, key, dict(given))
    if start is not None:
        simulator = replace(simulator, start=start)
    how = partial(opened, str(Path(file).resolve()), name, start=start)
    return simulator.opened_by(how)


@lru_cache(maxsize=16)
def _defined(file: str, name: str, contents: str) -> Any:
    """Return the object of that name; cached, so that a function is compiled once per process."""
    return named_in(file, name)


def _initial(given: Mapping[str, Any]) -> list[float]:
    """Return the initial states named by the parameters; states between them begin at 0."""
    told = Parameters(dict(given)).middle()
    numbers = [int(n[len(INITIAL) :]) for n in told if n[len(INITIAL) :].isdigit()
               and n.startswith(INITIAL)]  # fmt: skip
    if not numbers:
        raise ValueError(
            "parameters must say how many states the differential equation has, and where they "
            f"begin: {INITIAL}1=0,{INITIAL}2=-1:1"
        )
    return [told.get(f"{INITIAL}{i + 1}", 0.0) for i in range(max(numbers))]
