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

from benchmarks import inputs
from splitband.data import Record

Array = npt.NDArray[Any]
SAMPLES = 2000
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


def drawn(kind: str, seed: int, samples: int) -> Record:
    """The first `samples` of one of the `KINDS`."""
    return Record(KINDS[kind](np.random.default_rng(seed))[:samples], 0.1, name=kind)


def driven(make: Callable[[np.random.Generator], Record], seed: int) -> Record:
    """One of the systems with known inputs, in another draw than `benchmarks.inputs` has."""
    return make(np.random.default_rng(seed))


WITH_INPUTS = {f"{make.__name__.replace('_', ' ')}, driven": make for make in inputs.RECORDS}
