"""Define options that say which simulators there are, and how they are run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from splitband.cli.options.groups import panel
from splitband.simulators.named import SIMULATORS

_simulator = panel("Simulator")

_SIMULATOR = (
    "A simulator: an exported trajectory, an .fmu, FILE.py:FUNCTION of time in s, "
    f"or one of {', '.join(SIMULATORS)}."
)
PATIENCE = 600.0
"""Seconds after which a simulator is given up, by default. By eye."""
Calibrate = Annotated[
    bool, _simulator("Fit its gain, offset, delay and clock first.", None, True, "--calibrate")
]


@dataclass(frozen=True)
class SimulatorOptions:
    """Say which simulator stands beside the record, and how it is run."""

    simulator: Annotated[
        str | None, _simulator(_SIMULATOR, "FILE|NAME", "a named record's own")
    ] = None
    simulator_columns: Annotated[
        str | None,
        _simulator("Its columns or outputs that match --columns.", "NAMES", "of the same names"),
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
            "... and are measured in this order, FILE.py:FUNCTION of (time, u, p), or an sb.Ode of "
            "a file, which may have its ranges itself.",
            "k=0.1:10,c=0.05",
            False,
        ),
    ] = None


@dataclass(frozen=True)
class SimulatorOrBaseOptions(SimulatorOptions):
    """Say the same where what is fitted to the record may stand in a simulator's place, too."""

    simulator: Annotated[
        str | None,
        _simulator(
            f"{_SIMULATOR} Or linear, periodic, harmonic: a fitted model.",
            "FILE|NAME",
            "a named record's own",
        ),
    ] = None


def parts_of(simulator: str) -> tuple[str, str]:
    """Return the file of a simulator, and the function of FILE.py:FUNCTION or an empty text."""
    file, _, function = simulator.partition(".py:")
    return file + (".py" if function else ""), function
