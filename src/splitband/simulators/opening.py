"""Open a simulator whose parameters are fitted: a function of a Python file, or an FMU.

Where none are, `cli.simulators` opens it.
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
from splitband.simulators.sources import count_arguments, digest, source_files


def opened(
    file: str, name: str, given: Mapping[str, Any], outputs: Sequence[str] = ()
) -> Adjustable:
    """Return a simulator with these parameters.

    Raises ValueError for a file that cannot be run, has no such name, or names something else.

    Parameters
    ----------
    file : An .fmu, or a Python file, which is run.
    name : Of the file's function `rhs(t, x, u, p)` of four arguments, which is the right-hand side
        of an `Ode` whose first states are measured, of its function of the time, as `Function`
        takes it, or of an `Ode` or a `Function` in it.
    given : The parameters, in place of those that the simulator has by itself.
    outputs : Of an FMU.
    """
    if not name:
        return Fmu(file, outputs or None, dict(given))
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
    return simulator.opened_by(partial(opened, str(Path(file).resolve()), name))


@lru_cache(maxsize=16)
def _defined(file: str, name: str, contents: str) -> Any:
    """Return what a name of a file stands for; the same function is compiled once in a process."""
    return named_in(file, name)


def _initial(given: Mapping[str, Any]) -> list[float]:
    """Return as many states as the parameters name."""
    told = Parameters(dict(given)).middle()
    numbers = [int(n[len(INITIAL) :]) for n in told if n[len(INITIAL) :].isdigit()
               and n.startswith(INITIAL)]  # fmt: skip
    if not numbers:
        raise ValueError(
            "parameters must say how many states the differential equation has, and where they "
            f"begin: {INITIAL}1=0,{INITIAL}2=-1:1"
        )
    return [told.get(f"{INITIAL}{i + 1}", 0.0) for i in range(max(numbers))]
