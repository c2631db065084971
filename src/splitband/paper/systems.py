"""The systems of the paper that are simulated, and named records for the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.data import Trajectory, double_torsion, drill_string
from splitband.data.crane import overhead_crane
from splitband.forecasters.base import Forecaster
from splitband.forecasters.known import Known
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


class MassSpringOracle(Forecaster):
    """What can be known of system (i): least squares on the true form, from the true values.

    Two cosines and an offset. No learned model has to be better than this.
    """

    name = "oracle"

    def learn(self, records: Sequence[Trajectory], **_: Any) -> None:
        """See `Forecaster`."""
        self.step, y = records[0].sampling_time, records[0].y
        time = self._time(0, len(y))

        def coefficients(frequencies: Array) -> Array:
            return np.asarray(np.linalg.lstsq(self._basis(time, frequencies), y, rcond=None)[0])

        def residual(frequencies: Array) -> Array:
            fitted = self._basis(time, frequencies) @ coefficients(frequencies)
            return np.asarray(fitted - y).ravel()

        found = scipy.optimize.least_squares(residual, [0.115, 0.57], x_scale=[1e-3, 1e-3]).x
        self.frequencies, self.coefficients = found, coefficients(found)

    @property
    def anchored(self) -> bool:
        """See `Forecaster`."""
        return True

    def extrapolate(self, known: Known) -> Array:
        """See `Forecaster`."""
        time = self._time((known.begin or 0.0) + len(known.y), known.steps)
        return np.asarray(self._basis(time, self.frequencies) @ self.coefficients)

    def describe(self) -> str:
        """See `Forecaster`."""
        found = " and ".join(f"{f:.4g} Hz" for f in self.frequencies)
        return f"two cosines and an offset, {found}"

    def _time(self, begin: float, samples: int) -> Array:
        """In s since the training record began."""
        return np.asarray(self.step * (begin + np.arange(samples)))

    @staticmethod
    def _basis(time: Array, frequencies: Array) -> Array:
        phases = 2 * np.pi * np.outer(time, frequencies)
        return np.column_stack([np.cos(phases), np.sin(phases), np.ones_like(time)])


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


TORSION_DRIVES = {"ii": (0.625, 24.0), "iii": (0.9, 40.0), "iv": (1.8, 150.0)}
"""Frequency in Hz and amplitude in 1/s^2 of the simulated pendulum's excitations, by row."""


def double_torsion_pendulum(row: str, samples: int = 2000, seed: int = 0) -> Trajectory:
    """A double-torsion pendulum in place of the paper's unpublished records (ii) to (iv).

    Two discs of inertia 1: a spring to the frame and a sinusoidal torque on the first, a spring
    between them, and stick-slip (Stribeck) friction on the second, whose angle is measured.
    Equations and parameters are ours; the first excitation has the period of the public record.

    Parameters
    ----------
    row : Which excitation, out of `TORSION_DRIVES`.
    samples : At 0.01 s, after 5 s of settling; normalised.
    seed : Of the noise on `y`, standard deviation 0.01; `y_true` is without.
    """
    frequency, amplitude = TORSION_DRIVES[row]
    to_frame, between = (2 * np.pi * 0.6) ** 2, (2 * np.pi * 2.2) ** 2
    static, kinetic, stribeck = 16.0, 6.0, 0.5

    def discs(t: float, s: Array) -> Array:
        angle_1, speed_1, angle_2, speed_2 = s
        twist = between * (angle_1 - angle_2)
        level = kinetic + (static - kinetic) * np.exp(-((speed_2 / stribeck) ** 2))
        torque = amplitude * np.sin(2 * np.pi * frequency * t)
        return np.array(
            [
                speed_1,
                torque - to_frame * angle_1 - 0.3 * speed_1 - twist,
                speed_2,
                twist - 0.2 * speed_2 - level * np.tanh(speed_2 / 0.05),
            ]
        )

    dt, settling = 0.01, 500
    angle = run(Ode(discs, [0.3, 0, 0.1, 0], lambda s: s[:, 2]), settling + samples, dt)[settling:]
    y = (angle - angle.mean(axis=0)) / angle.std(axis=0)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, y.shape)
    name = f"double-torsion-pendulum-{row}"
    return Trajectory(y + noise, dt, y_true=y, name=name, columns=("phi2",))


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
    "overhead-crane": overhead_crane,
}
"""Named records; those of the hybrid systems bring their simulator's output as `y_sim`."""

SIMULATORS: dict[str, Callable[[], Simulator]] = {
    "van-der-pol": van_der_pol_simulator,
    "drill-string": drill_string_simulator,
}
"""Named simulators, on the time grid of their record."""
