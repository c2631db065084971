"""Define the named records: public measurements and simulated systems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from splitband.records.public import double_torsion, drill_string
from splitband.records.record import Record
from splitband.runtime.arrays import Array

STEP = 0.1
"""Sampling time of the overhead crane, s. It and its parameters are fictitious."""
GRAVITY = 9.81
"""Acceleration of gravity, m/s^2."""
DRIVE_LAG = 0.4
"""Time constant of the trolley's drive, s. Fictitious."""
DAMPING, DRAG = 0.2, 0.05
"""Damping of the swing: linear in 1/s, and quadratic per radian. Fictitious."""
FASTEST_TROLLEY, FASTEST_HOIST = 2.0, 0.5
"""Highest speeds of the trolley and of the hoist, m/s. Fictitious."""


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

    Paper, supplement, Sec. C.2; it lacks omega and the initial states (reproduction/REPORT.md).

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

    def solved(rate: Any, state: list[float], rtol: float, atol: float) -> Array:
        ends = (time[0], time[-1])
        run = scipy.integrate.solve_ivp(rate, ends, state, t_eval=time, rtol=rtol, atol=atol)
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


def overhead_crane(samples: int = 4000, noise: float = 0.02, seed: int = 0) -> Record:
    """Return the position of a crane's load, its operator's inputs, and a simulator without swing.

    A trolley follows a commanded speed, and the load hangs from it on a rope whose length changes
    during the motion. The swing is nonlinear and depends on that length. The simulator integrates
    the commanded speed, as if the load were fixed below an ideal trolley: it is accurate at low
    frequencies and omits the swing.

    Parameters
    ----------
    samples : Number of samples, one every 0.1 s.
    noise : Standard deviation of the noise on `y`, in m; `y_true` has none.
    seed : Seed of the operator's commands and of the noise.
    """
    random = np.random.default_rng(seed)
    speed, rope = _operated(samples, random)
    ideal = scipy.integrate.cumulative_trapezoid(speed, dx=STEP, initial=0)
    load = _swinging(speed, rope)
    return Record(
        load + random.normal(0.0, noise, samples),
        STEP,
        u=np.column_stack([speed, rope]),
        y_true=load,
        y_sim=ideal,
        name="overhead-crane",
        columns=("load [m]",),
        inputs=("speed [m/s]", "rope [m]"),
    )


def _operated(samples: int, random: np.random.Generator) -> tuple[Array, Array]:
    """Return commanded speed and rope length; every 5 to 15 s the operator chooses a new target."""
    speed, rope = np.zeros(samples), np.zeros(samples)
    position, length = 0.0, 4.0
    place, height, left = 0.0, length, 0
    for n in range(samples):
        if left == 0:
            place, height = random.uniform(-8.0, 8.0), random.uniform(2.0, 8.0)
            left = int(random.integers(50, 150))
        left -= 1
        wanted = np.clip(0.8 * (place - position), -FASTEST_TROLLEY, FASTEST_TROLLEY)
        speed[n], rope[n] = np.round(4 * wanted) / 4, length
        position += STEP * speed[n]
        length += STEP * np.clip(height - length, -FASTEST_HOIST, FASTEST_HOIST)
    return speed, rope


def _swinging(speed: Array, rope: Array) -> Array:
    """Simulate the load: a pendulum of varying length below a trolley that follows `speed`."""
    times = STEP * np.arange(len(speed))
    known = np.column_stack([speed, rope, np.gradient(rope, STEP)])

    def crane(t: float, state: Array) -> list[float]:
        _, velocity, angle, rate = state
        # Inputs are interpolated linearly between samples.
        n = min(int(t / STEP), len(known) - 2)
        share = t / STEP - n
        commanded, length, hoisting = (1 - share) * known[n] + share * known[n + 1]
        acceleration = (commanded - velocity) / DRIVE_LAG
        torque = -GRAVITY * np.sin(angle) - acceleration * np.cos(angle)
        swing = (torque - 2 * hoisting * rate) / length
        return [velocity, acceleration, rate, swing - DAMPING * rate - DRAG * rate * abs(rate)]

    solved = scipy.integrate.solve_ivp(
        crane, (0.0, times[-1]), [0.0] * 4, t_eval=times, max_step=STEP, rtol=1e-6, atol=1e-8
    )
    position, _, angle, _ = solved.y
    return np.asarray(position + rope * np.sin(angle))


@dataclass(frozen=True)
class NamedRecord:
    """Describe a named record.

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
