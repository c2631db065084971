"""Run and calibrate black-box simulators: recorded, function, ODE, FMU, isolated."""

from splitband.simulators.base import Simulator, SimulatorError, SimulatorTimeoutError, run
from splitband.simulators.estimate import Estimate
from splitband.simulators.fmu import Fmu
from splitband.simulators.function import Function
from splitband.simulators.identification import Effort, identify
from splitband.simulators.ode import Ode
from splitband.simulators.recorded import Recorded

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
    "identify",
    "run",
]
