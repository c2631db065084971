"""Run and calibrate black-box simulators: recorded, function, ODE, FMU, isolated."""

from splitband.simulators.base import (
    Recorded,
    Simulator,
    SimulatorError,
    SimulatorTimeoutError,
    run,
)
from splitband.simulators.fmu import Fmu
from splitband.simulators.functions import Function, Ode
from splitband.simulators.identification import Effort, identify
from splitband.simulators.parameters import Estimate
from splitband.simulators.unknown import Unknown

__all__ = [
    "Effort",
    "Estimate",
    "Fmu",
    "Function",
    "Ode",
    "Recorded",
    "Simulator",
    "SimulatorError",
    "SimulatorTimeoutError",
    "Unknown",
    "identify",
    "run",
]
