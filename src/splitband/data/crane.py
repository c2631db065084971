"""Simulate an overhead crane with a swinging load, as a first example record."""

from __future__ import annotations

import numpy as np
import scipy

from splitband.data.record import Record
from splitband.runtime.arrays import Array

STEP = 0.1
"""Sampling time, s. The crane and its parameters are fictitious."""
GRAVITY = 9.81
"""Acceleration of gravity, m/s^2."""
DRIVE_LAG = 0.4
"""Time constant of the trolley's drive, s. By eye."""
DAMPING, DRAG = 0.2, 0.05
"""Damping of the swing: linear in 1/s, and quadratic per radian. By eye."""
FASTEST_TROLLEY, FASTEST_HOIST = 2.0, 0.5
"""Highest speeds of the trolley and of the hoist, m/s. By eye."""


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
