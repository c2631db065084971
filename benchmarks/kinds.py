"""Records of many kinds, drawn from seeds, with known inputs and without.

Constants of the package are chosen on the seeds in `DEVELOPMENT`, and judged by those in
`REPORTED`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.records import Record

Array = npt.NDArray[Any]
SAMPLES, TRAINING = 2000, 1200
"""Of a record with inputs: all of them, and those to train on."""
DEVELOPMENT, REPORTED = range(100, 1000), range(1000, 2000)
"""Seeds by which constants are chosen, and others by which they are judged."""


def _solved(slope: Callable[[float, Array], Any], begin: Array, times: Array) -> Array:
    found = scipy.integrate.solve_ivp(
        slope, (0, times[-1]), begin, t_eval=times, rtol=1e-8, atol=1e-9
    )
    return np.asarray(found.y.T)


def lorenz(rng: np.random.Generator) -> Array:
    """The chaotic system's first coordinate."""

    def slope(t: float, s: Array) -> list[float]:
        return [10 * (s[1] - s[0]), s[0] * (28 - s[2]) - s[1], s[0] * s[1] - 8 / 3 * s[2]]

    begin = 5 * rng.normal(size=3) + [0, 0, 25]
    return _solved(slope, begin, np.linspace(20, 60, SAMPLES))[:, :1]


def duffing(rng: np.random.Generator) -> Array:
    """A driven oscillator with two wells."""

    def slope(t: float, s: Array) -> list[float]:
        return [s[1], -0.1 * s[1] + s[0] - s[0] ** 3 + 0.25 * np.cos(t)]

    y = _solved(slope, rng.normal(size=2), np.linspace(0, 200, SAMPLES))[:, :1]
    return y + 0.01 * rng.normal(size=y.shape)


def driven_van_der_pol(rng: np.random.Generator) -> Array:
    """A self-excited oscillator, driven at another frequency; two channels."""

    def slope(t: float, s: Array) -> list[float]:
        return [s[1], 2 * (1 - s[0] ** 2) * s[1] - s[0] + 0.5 * np.cos(2.3 * t)]

    y = _solved(slope, rng.normal(size=2), np.linspace(30, 150, SAMPLES))
    return y + 0.02 * rng.normal(size=y.shape)


def mackey_glass(rng: np.random.Generator) -> Array:
    """The delayed feedback, chaotic at a delay of 17."""
    x = list(1.2 + 0.1 * rng.normal(size=18))
    for _ in range(3 * SAMPLES):
        x.append(0.9 * x[-1] + 0.2 * x[-18] / (1 + x[-18] ** 10))
    return np.array(x[-2 * SAMPLES :: 2])[:, None]


def of_time(signal: Callable[[Array, np.random.Generator], Array], noise: float) -> Any:
    """A function of the sample's index, and noise."""

    def record(rng: np.random.Generator) -> Array:
        y = signal(np.arange(SAMPLES), rng)
        return (y + noise * rng.normal(size=SAMPLES))[:, None]

    return record


def _sine(n: Array, period: float, phase: float = 0.0) -> Array:
    return np.asarray(np.sin(2 * np.pi * n / period + phase))


def _tones(n: Array, rng: np.random.Generator) -> Array:
    phase = 2 * np.pi * np.outer(n, rng.uniform(0.003, 0.06, 5)) + rng.uniform(0, 6, 5)
    return np.asarray(np.sin(phase) @ rng.uniform(0.2, 1, 5))


def _wandering(n: Array, rng: np.random.Generator) -> Array:
    phase = np.cumsum(2 * np.pi / 50 * (1 + 0.1 * rng.normal(size=len(n))))
    return np.asarray(np.sin(phase) + 0.3 * np.sin(2 * phase))


def _drawn(
    signal: Callable[[Array, float, float], Array], low: float, high: float, noise: float
) -> Any:
    """A function of the sample's index, of a scale between `low` and `high` and of a phase."""
    return of_time(
        lambda n, rng: signal(n, rng.uniform(low, high), rng.uniform(0, 2 * np.pi)), noise
    )


def _autoregressive(n: Array, rng: np.random.Generator) -> Array:
    return np.asarray(scipy.signal.lfilter([1], [1, -0.99], rng.normal(size=2 * len(n)))[len(n) :])


def _resonance(n: Array, rng: np.random.Generator) -> Array:
    a = [1, -2 * 0.99 * np.cos(0.2), 0.99**2]
    return np.asarray(scipy.signal.lfilter([1], a, rng.normal(size=2 * len(n)))[len(n) :])


KINDS: dict[str, Callable[[np.random.Generator], Array]] = {
    "Lorenz": lorenz,
    "Duffing": duffing,
    "driven van der Pol": driven_van_der_pol,
    "Mackey-Glass": mackey_glass,
    "resonance driven by noise": of_time(_resonance, 0.0),
    "random walk": of_time(lambda n, rng: np.cumsum(rng.normal(size=len(n))), 0.0),
    "trend": of_time(lambda n, _: n / 500 + _sine(n, 123.4) + 0.3 * _sine(n, 30), 0.1),
    "square wave": of_time(lambda n, _: np.sign(_sine(n, 87.3)), 0.1),
    "five tones": of_time(_tones, 0.1),
    "decay": of_time(lambda n, _: np.exp(-n / 600) * _sine(n, 61) + 0.5 * np.exp(-n / 300), 0.02),
    "beating": of_time(lambda n, _: (1 + 0.5 * _sine(n, 400)) * _sine(n, 37), 0.05),
    "wandering phase": of_time(_wandering, 0.0),
    "white noise": of_time(lambda n, _: 0.0 * n, 1.0),
    "sine": _drawn(_sine, 15, 90, 0.2),
    "slow sine": _drawn(_sine, 600, 1000, 0.05),
    "AR(0.99)": of_time(_autoregressive, 0.0),
    "ramp": _drawn(lambda n, scale, _: n / scale, 50, 200, 0.1),
    "trend and season": _drawn(
        lambda n, scale, phase: n / scale + _sine(n, scale / 5, phase), 100, 400, 0.1
    ),
    "cooling": _drawn(lambda n, scale, _: 6 * np.exp(-n / scale), 150, 500, 0.1),
}


def two_masses(rng: np.random.Generator) -> Record:
    """Springs and dampers, linear, driven by coloured noise; both positions, 2 % noise."""
    a = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-900, 400, -2, 0.5], [400, -600, 0.5, -1.5]])
    b = np.array([[0.0], [0], [1], [0]])
    step = 0.01
    u = scipy.signal.lfilter([6.0], [1, -0.8], rng.standard_normal(SAMPLES))
    t = step * np.arange(SAMPLES)
    y = scipy.signal.lsim((a, b, np.eye(2, 4), np.zeros((2, 1))), u, t, interp=False)[1]
    return Record(_noisy(y, 0.02, rng), step, u=u, y_true=y, name="two masses")


def tanks(rng: np.random.Generator) -> Record:
    """Two in a row, emptied by their own weight (the root of the level), a pump that steps."""
    step, fine = 4.0, 20
    u = np.repeat(rng.uniform(1, 5, SAMPLES // 20), 20)
    levels, found = np.array([3.0, 3.0]), []
    for pump in u:
        for _ in range(fine):
            out = 0.12 * np.sqrt(levels)
            rate = np.array([0.06 * pump - out[0], out[0] - out[1]])
            levels = np.clip(levels + step / fine * rate, 0, 10)
        found.append(levels[1])
    y = np.array(found)
    return Record(_noisy(y, 0.02, rng), step, u=u, y_true=y, name="tanks")


def duffing_spring(rng: np.random.Generator) -> Record:
    """A spring that hardens to twice its stiffness, 25 tones as the force, 1 % noise."""
    step, frequency, phase = 0.02, rng.uniform(0.2, 6, 25), rng.uniform(0, 2 * np.pi, 25)

    def force(t: float) -> float:
        return float(8 * np.sin(2 * np.pi * frequency * t + phase).sum())

    def slope(t: float, s: Array) -> list[float]:
        return [s[1], force(t) - 0.8 * s[1] - 158 * s[0] - 2000 * s[0] ** 3]

    t = step * np.arange(SAMPLES)
    solved = scipy.integrate.solve_ivp(slope, (0, t[-1]), [0, 0], t_eval=t, rtol=1e-8, atol=1e-10)
    y, u = solved.y[0], np.array([force(at) for at in t])
    return Record(_noisy(y, 0.01, rng), step, u=u, y_true=y, name="Duffing")


def tanks_and_cycle(rng: np.random.Generator) -> Record:
    """The two tanks, whose level also follows a cycle of 600 s that the pump knows nothing of."""
    record = tanks(rng)
    phase = 2 * np.pi * np.arange(SAMPLES) / 150 + rng.uniform(0, 2 * np.pi)
    cycle = np.exp(np.sin(phase)) + 0.3 * np.cos(2 * phase)
    y = record.truth + (record.y.std() * (cycle - cycle.mean()))[:, None]
    return Record(
        _noisy(y, 0.02, rng), record.sampling_time, u=record.u, y_true=y, name="tanks and cycle"
    )


def _noisy(y: Array, share: float, rng: np.random.Generator) -> Array:
    return np.asarray(y + share * y.std(axis=0) * rng.standard_normal(y.shape))


WITH_INPUTS: dict[str, Callable[[np.random.Generator], Record]] = {
    "two masses, driven": two_masses,
    "tanks, driven": tanks,
    "duffing, driven": duffing_spring,
}


def drawn(kind: str, seed: int, samples: int) -> Record:
    """The first `samples` of a record of one of the `KINDS`, or of those `WITH_INPUTS`."""
    rng = np.random.default_rng(seed)
    if kind in WITH_INPUTS:
        return WITH_INPUTS[kind](rng)[:samples]
    return Record(KINDS[kind](rng)[:samples], 0.1, name=kind)


def held_levels(rng: np.random.Generator, samples: int, inputs: int) -> Array:
    """Random levels, each input changing at its own pace."""
    held = rng.integers(15, 40, inputs)
    levels = [np.repeat(rng.uniform(0, 2, samples // h + 1), h)[:samples] for h in held]
    return np.stack(levels, axis=1)


def one_tank(rng: np.random.Generator, samples: int) -> Record:
    """A tank with one pump, emptied by its own weight: nonlinear, of first order; 2 % noise."""
    u, levels, level = held_levels(rng, samples, 1), [], 3.0
    for (pump,) in u:
        for _ in range(5):
            level = max(level + 0.4 * (0.12 * pump + 0.1 - 0.2 * np.sqrt(level)), 0.0)
        levels.append(level)
    return Record(_noisy(np.array(levels), 0.02, rng), 0.1, u=u, name="tank")


def five_inputs(rng: np.random.Generator) -> Record:
    """4,000 samples of three coupled states that saturate, two of them measured; 2 % noise."""
    u, drive = held_levels(rng, 4000, 5), rng.normal(size=(5, 3)) / 5
    states, state = [], np.zeros(3)
    for row in u:
        coupled = np.array([state[1], state[2] - state[0], state[0] - 0.4 * state[2]])
        state = 0.9 * state + 0.1 * np.tanh(coupled + row @ drive)
        states.append(state[:2])
    return Record(_noisy(np.array(states), 0.02, rng), 0.1, u=u, name="five inputs")


def four_channels(rng: np.random.Generator, samples: int) -> Record:
    """Two inputs that switch, two outputs through four linear channels of order 2; 2 % noise."""
    u = np.sign(held_levels(rng, samples, 2) - 1)
    poles = rng.uniform(0.8, 0.97, (4, 1)) * np.exp(1j * rng.uniform(0.05, 0.5, (4, 1)) * [1, -1])
    parts = [
        scipy.signal.lfilter([0, 1 - abs(each[0])], np.poly(each).real, u[:, i % 2])
        for i, each in enumerate(poles)
    ]
    y = np.stack([parts[0] + parts[1], parts[2] + parts[3]], axis=1)
    return Record(_noisy(y, 0.02, rng), 0.1, u=u, name="four channels")


def two_tones(rng: np.random.Generator, samples: int) -> Record:
    """A slow oscillation with a faster one on it that is no sinusoid; 2 % noise."""
    n = np.arange(samples)
    return Record(_noisy(_sine(n, 41) + 0.3 * _sine(n, 7.3) ** 3, 0.02, rng), 0.1, name="two tones")


def pendulum_with_friction(rng: np.random.Generator) -> Record:
    """1,500 samples of a pendulum with dry friction, driven by a torque; 1 % noise."""
    u, angle, speed, found = 4 * held_levels(rng, 1500, 1) - 4, 0.0, 0.0, []
    for (torque,) in u:
        found.append(angle)
        for _ in range(20):
            friction = 0.3 * speed + 0.4 * np.tanh(speed / 0.02)
            speed += 0.0025 * (torque - 10 * np.sin(angle) - friction)
            angle += 0.0025 * speed
    return Record(_noisy(np.array(found), 0.01, rng), 0.05, u=u, name="pendulum")
