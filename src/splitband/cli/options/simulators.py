"""Define the options that name simulators and say how they are run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from splitband.cli.options.groups import panel
from splitband.simulators.named import SIMULATORS

_simulator = panel("Simulator")

_SIMULATOR = (
    "A simulator: an exported trajectory, an .fmu, FILE.py:FUNCTION of time in s or of (time, u), "
    f"or one of {', '.join(SIMULATORS)}. It is driven by the record's inputs."
)
PATIENCE = 600.0
"""Default time limit of a simulator, in s. Bounds the time."""
Calibrate = Annotated[
    bool, _simulator("Fit its gain, offset, delay and clock first.", None, True, "--calibrate")
]


@dataclass(frozen=True)
class SimulatorOptions:
    """Name the simulator of the record, and say how it is run."""

    simulator: Annotated[
        str | None, _simulator(_SIMULATOR, "FILE|NAME", "a named record's own")
    ] = None
    simulator_columns: Annotated[
        str | None,
        _simulator("Its columns or outputs that match --columns.", "NAMES", "of the same names"),
    ] = None
    simulator_inputs: Annotated[
        str | None,
        _simulator(
            "Variables of an FMU that take --inputs, in their order, none for one that it does not "
            'take (a,,c); the others keep their start values, with "" all of them.',
            "NAMES",
            "of the same names",
        ),
    ] = None
    simulator_start: Annotated[
        str | None,
        _simulator(
            "Its time in s at the record's first sample, or `record` for its time stamp there.",
            "SECONDS|record",
            "0",
        ),
    ] = None
    simulator_timeout: Annotated[
        float, _simulator("Give up on a simulator after this time.", "SECONDS", min=0.0)
    ] = PATIENCE
    simulator_cache: Annotated[
        Path | None,
        _simulator("Keep the output of a slow simulator here.", "DIR", "not kept"),
    ] = None
    simulator_reads: Annotated[
        list[str] | None,
        _simulator("A file it reads: the cache is renewed with it.", "FILE", False),
    ] = None
    parameters: Annotated[
        str | None,
        _simulator(
            "Fit the simulator's parameters in these ranges, or set them. The simulator is an "
            "FMU, FILE.py:RHS with a function of (t, x, u, p), whose states begin at x0_1, x0_2, "
            "... and of which the first ones are measured, FILE.py:FUNCTION of (time, u, p), or an "
            "sb.Ode of a file, which may have its ranges itself.",
            "k=0.1:10,c=0.05",
            False,
        ),
    ] = None


@dataclass(frozen=True)
class SimulatorOrBaseOptions(SimulatorOptions):
    """Name a simulator, or a model that is fitted to the record in its place."""

    simulator: Annotated[
        str | None,
        _simulator(
            f"{_SIMULATOR} Or linear, periodic, harmonic: a fitted model.",
            "FILE|NAME",
            "a named record's own",
        ),
    ] = None


def parts_of(simulator: str) -> tuple[str, str]:
    """Return the file of a simulator, and FUNCTION for FILE.py:FUNCTION, else an empty text."""
    file, _, function = simulator.partition(".py:")
    return file + (".py" if function else ""), function
