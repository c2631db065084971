"""The systems of the paper that are simulated, and named records for the command line."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from splitband.data import Trajectory, double_torsion, drill_string
from splitband.simulators import Ode, Recorded, Simulator, run

Array = npt.NDArray[np.float64]


def double_mass_spring(
    samples: int = 1000, noise_variance: float = 0.1, seed: int = 0
) -> Trajectory:
    """System (i): two superposed cosines and an offset (paper, supplement, Sec. C.1).

    Parameters
    ----------
    samples : At 0.1 s.
    noise_variance : Of the Gaussian noise on `y`; `y_true` is without.
    seed : Of the noise.
    """
    t = 0.1 * np.arange(samples)
    x = 1.28 * np.cos(2 * np.pi * 0.115 * t - 7.7) + 0.677 * np.cos(2 * np.pi * 0.57 * t) - 0.009
    noise = np.random.default_rng(seed).normal(0.0, np.sqrt(noise_variance), samples)
    return Trajectory(x + noise, 0.1, y_true=x, name="double-mass-spring", columns=("x",))


def van_der_pol(samples: int = 2000, simulator_rtol: float = 1e-10) -> Trajectory:
    """System (v): a Van der Pol oscillator driven by a sinusoid, and its unforced simulator.

    Paper, supplement, Sec. C.2; omega and the initial states are not in it (docs/deviations.md).

    Parameters
    ----------
    samples : At 0.05 s.
    simulator_rtol : Relative tolerance of the simulator's solver. SciPy's default, 1e-3, moves the
        simulator's error from 0.405 to the paper's 0.418.
    """
    a, b, omega = 5.0, 80.0, 7.0

    def forced(_: float, s: Array) -> Array:
        x, y, u, v = s
        return np.array([y, -x + a * (1 - x**2) * y + b * u, v, -(omega**2) * u])

    truth = Ode(forced, [-2.0, 1.0, 0.31, 0.0], rtol=1e-10, atol=1e-13)
    simulator = van_der_pol_simulator(simulator_rtol)
    dt = 0.05
    return Trajectory(
        run(truth, samples, dt),
        dt,
        y_sim=run(simulator, samples, dt),
        name="van-der-pol",
        columns=("x",),
    )


def van_der_pol_simulator(rtol: float = 1e-10) -> Simulator:
    """The simulator of system (v): no force, and a damping of 3.81 instead of 5."""
    a = 3.81

    def unforced(_: float, s: Array) -> Array:
        x, y = s
        return np.array([y, -x + a * (1 - x**2) * y])

    return Ode(unforced, [-2.0, 1.0], rtol=rtol, atol=1e-3 * rtol)


def drill_string_simulator() -> Simulator:
    """The simulator of system (vi): an exported trajectory, normalised like the record."""
    record = drill_string()
    assert record.y_sim is not None
    return Recorded(record.y_sim, record.sampling_time)


RECORDS = {
    "double-mass-spring": double_mass_spring,
    "double-torsion": double_torsion,
    "van-der-pol": van_der_pol,
    "drill-string": drill_string,
}
"""Named records; those of the hybrid systems bring their simulator's output as `y_sim`."""

SIMULATORS: dict[str, Callable[[], Simulator]] = {
    "van-der-pol": van_der_pol_simulator,
    "drill-string": drill_string_simulator,
}
"""Named simulators, on the time grid of their record."""
