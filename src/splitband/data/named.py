"""Define the named records: public measurements and simulated systems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from splitband.data.crane import overhead_crane
from splitband.data.public import double_torsion, drill_string
from splitband.data.record import Record
from splitband.runtime.arrays import Array


def double_mass_spring(samples: int = 1000, noise_variance: float = 0.1, seed: int = 0) -> Record:
    """Return the paper's system (i): two superposed cosines and an offset (supplement, Sec. C.1).

    Parameters
    ----------
    samples : Number of samples, one every 0.1 s.
    noise_variance : Variance of the Gaussian noise on `y`; `y_true` has none.
    seed : Seed of the noise.
    """
    t = 0.1 * np.arange(samples)
    x = 1.28 * np.cos(2 * np.pi * 0.115 * t - 7.7) + 0.677 * np.cos(2 * np.pi * 0.57 * t) - 0.009
    noise = np.random.default_rng(seed).normal(0.0, np.sqrt(noise_variance), samples)
    return Record(x + noise, 0.1, y_true=x, name="double-mass-spring", columns=("x",))


def van_der_pol(samples: int = 2000, simulator_rtol: float = 1e-10) -> Record:
    """Return the paper's system (v), a driven Van der Pol oscillator, with an unforced simulator.

    Paper, supplement, Sec. C.2; omega and the initial states are not in it (docs/deviations.md).

    Parameters
    ----------
    samples : Number of samples, one every 0.05 s.
    simulator_rtol : Relative tolerance of the simulator's solver. SciPy's default, 1e-3, moves the
        simulator's error from 0.405 to the paper's 0.418.
    """
    a, b, omega = 5.0, 80.0, 7.0

    def forced(_: float, s: Array) -> Array:
        x, y, u, v = s
        return np.array([y, -x + a * (1 - x**2) * y + b * u, v, -(omega**2) * u])

    dt = 0.05
    time = np.arange(samples) * dt

    def solved(derivative: Callable[[float, Array], Array], state: list[float], rtol: float,
               atol: float) -> Array:  # fmt: skip
        ends = (time[0], time[-1])
        run = scipy.integrate.solve_ivp(derivative, ends, state, t_eval=time, rtol=rtol, atol=atol)
        return np.asarray(run.y[0])

    return Record(
        solved(forced, [-2.0, 1.0, 0.31, 0.0], 1e-10, 1e-13),
        dt,
        y_sim=solved(unforced_van_der_pol, UNFORCED_START, simulator_rtol, 1e-3 * simulator_rtol),
        name="van-der-pol",
        columns=("x",),
    )


UNFORCED_START = [-2.0, 1.0]
"""Initial state of the simulator of (v)."""


def unforced_van_der_pol(_: float, state: Array) -> Array:
    """Return the state derivative of the simulator of (v): no force, damping 3.81 instead of 5."""
    x, y = state
    return np.array([y, -x + 3.81 * (1 - x**2) * y])


@dataclass(frozen=True)
class NamedRecord:
    """Describe a named record.

    Attributes
    ----------
    make : Returns the record, with the simulator's output as `y_sim` if there is one.
    train : Default number of training samples, as in the paper; None for three quarters.
    """

    make: Callable[[], Record]
    train: int | None = None


RECORDS = {
    "double-mass-spring": NamedRecord(double_mass_spring, 250),
    "double-torsion": NamedRecord(double_torsion, 600),
    "van-der-pol": NamedRecord(van_der_pol, 600),
    "drill-string": NamedRecord(drill_string, 2000),
    "overhead-crane": NamedRecord(overhead_crane),
}
