"""Records in place of unpublished ones, and what can be known of system (i) at best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import ForecastContext
from splitband.records import Record
from splitband.records.named import van_der_pol
from splitband.simulators import Ode, run

Array = npt.NDArray[np.float64]

_STEP = 0.01
"""Sampling time of the simulated pendulum in s."""


class MassSpringOracle(Forecaster):
    """What can be known of system (i): least squares on the true form, from the true values.

    Two cosines and an offset. No learned model has to be better than this.
    """

    name = "oracle"

    def learn(self, records: Sequence[Record], **_: Any) -> None:
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

    def extrapolate(self, known: ForecastContext) -> Array:
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


TORSION_DRIVES = {"ii": (0.625, 24.0), "iii": (0.9, 40.0), "iv": (1.8, 150.0)}
"""Frequency in Hz and amplitude in 1/s^2 of the simulated pendulum's excitations, by row."""


def double_torsion_pendulum(row: str, samples: int = 2000, seed: int = 0) -> Record:
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
    y = _angle(row, samples)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, y.shape)
    name = f"double-torsion-pendulum-{row}"
    return Record(y + noise, _STEP, y_true=y, name=name, columns=("phi2",))


@cache
def _angle(row: str, samples: int) -> Array:
    """Return the normalised angle of the second disc without noise, `(samples, 1)`."""
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

    settling = 500
    pendulum = Ode(discs, [0.3, 0, 0.1, 0], lambda s: s[:, 2])
    angle = run(pendulum, settling + samples, _STEP)[settling:]
    return np.asarray((angle - angle.mean(axis=0)) / angle.std(axis=0))


def noisy_van_der_pol(seed: int = 0) -> Record:
    """Return system (v) with Gaussian noise of deviation 0.1 on `y`; `y_true` is without.

    Sec. 5.1 says that simulated systems are corrupted with noise, and gives no level for (v).
    """
    record = van_der_pol()
    noise = np.random.default_rng(seed).normal(0.0, 0.1, record.y.shape)
    return replace(record, y=record.y + noise, y_true=record.y, name="van-der-pol-noisy")
