"""Driven nonlinear systems, drawn from seeds: a training record and a test record of each.

Constants of the package are chosen on the seeds in `kinds.DEVELOPMENT`, and judged by those in
`kinds.REPORTED`. Parameters differ by up to 30 % from seed to seed. The input is held from one
sample to the next; the test record is another draw of it, and has no noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
import scipy

from splitband import Record

Array = npt.NDArray[np.float64]
SPREAD = 0.3
"""Parameters lie within this share of their usual values."""


@numba.njit(cache=True)
def _bouc_wen(x: Array, u: float, p: Array) -> Array:
    """Hysteresis: m y'' + c y' + k y + z = u (Noël and Schoukens, 2016; there ν = 1)."""
    y, v, z = x
    m, c, k, alpha, beta, gamma, delta = p
    dz = alpha * v - beta * (gamma * abs(v) * z + delta * v * abs(z))
    return np.array([v, (u - c * v - k * y - z) / m, dz])


@numba.njit(cache=True)
def _duffing(x: Array, u: float, p: Array) -> Array:
    """A spring that hardens."""
    return np.array([x[1], u - p[0] * x[1] - p[1] * x[0] - p[2] * x[0] ** 3])


@numba.njit(cache=True)
def _motor(x: Array, u: float, p: Array) -> Array:
    """A motor that drives a pulley by an elastic belt: speed, tension, speed of the pulley."""
    speed, tension, pulley = x
    rise = p[2] * (speed - pulley)
    return np.array([p[0] * (u - speed) - p[1] * tension, rise, p[1] * tension - p[3] * pulley])


@numba.njit(cache=True)
def _tanks(x: Array, u: float, p: Array) -> Array:
    """Two tanks, one above the other, of which the upper one overflows into the lower one."""
    upper, lower = max(x[0], 0.0), max(x[1], 0.0)
    fill, out = p[1] * u - p[0] * np.sqrt(upper), p[0] * np.sqrt(upper) - p[2] * np.sqrt(lower)
    over = fill if upper >= 10.0 and fill > 0.0 else 0.0
    fall = out + p[3] * over
    return np.array([fill - over, 0.0 if lower >= 10.0 and fall > 0.0 else fall])


@numba.njit(cache=True)
def _solved(rate: Any, x: Array, u: Array, p: Array, step: float, fine: int) -> Array:
    """The states at the samples, by the classical Runge-Kutta method."""
    states, h = np.empty((len(u), len(x))), step / fine
    for n in range(len(u)):
        states[n] = x
        for _ in range(fine):
            k1 = rate(x, u[n], p)
            k2 = rate(x + h / 2 * k1, u[n], p)
            k3 = rate(x + h / 2 * k2, u[n], p)
            k4 = rate(x + h * k3, u[n], p)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return states


def multisine(rng: np.random.Generator, samples: int, low: float, high: float) -> Array:
    """Random phases between two shares of the Nyquist frequency; a deviation of 1."""
    share = np.fft.rfftfreq(samples) * 2
    phases = np.exp(2j * np.pi * rng.random(len(share))) * ((share >= low) & (share <= high))
    u = np.fft.irfft(phases, samples)
    return np.asarray(u / u.std())


def steps(rng: np.random.Generator, samples: int, low: float, high: float, held: int) -> Array:
    """Random levels, each held for a random time."""
    found: list[float] = []
    while len(found) < samples:
        found += [rng.uniform(low, high)] * int(rng.integers(held // 2, 2 * held))
    return np.array(found[:samples])


Drive = Callable[[np.random.Generator, int], Array]


@dataclass(frozen=True)
class System:
    """A system: its parameters, its input, and what is measured of it.

    Attributes
    ----------
    step : Sampling time in seconds.
    parameters : Their usual values.
    drive : The input of a number of samples.
    measure : The measured channel, by parameters, input and a generator for initial states.
    noise : Deviation of the noise as a share of the signal's.
    """

    step: float
    parameters: tuple[float, ...]
    drive: Drive
    measure: Callable[[Array, Array, np.random.Generator], Array]
    noise: float


def _of_rate(
    rate: Any, output: Callable[[Array], Array], begin: tuple[float, ...], step: float, fine: int
) -> Callable[[Array, Array, np.random.Generator], Array]:
    def measure(p: Array, u: Array, rng: np.random.Generator) -> Array:
        x = np.array(begin) * (1 + 0.3 * rng.uniform(-1, 1, len(begin)))
        return output(_solved(rate, x, u, p, step, fine))

    return measure


def _wiener_hammerstein(p: Array, u: Array, rng: np.random.Generator) -> Array:
    """A filter, a diode that saturates on one side, another filter."""
    first = scipy.signal.cheby1(3, 0.5, 0.2 * p[0])
    second = scipy.signal.cheby2(3, 40, 0.25 * p[1])
    x = scipy.signal.lfilter(*first, u)
    x = np.where(x > 0, x / (1 + p[2] * np.maximum(x, 0)), x)
    return np.asarray(scipy.signal.lfilter(*second, x))


def _sines(gain: float, lowest: float, highest: float) -> Drive:
    return lambda rng, n: gain * multisine(rng, n, lowest, highest)


def _steps(low: float, high: float, held: int) -> Drive:
    return lambda rng, n: steps(rng, n, low, high, held)


_BOUC_WEN = _of_rate(_bouc_wen, lambda x: x[:, 0], (0.0, 0.0, 0.0), 1 / 750, 20)
_MOTOR = _of_rate(_motor, lambda x: np.abs(x[:, 2]), (0.0, 0.0, 0.0), 0.02, 10)
_TANKS = _of_rate(_tanks, lambda x: np.minimum(x[:, 1], 10.0), (4.0, 4.0), 4.0, 10)
_DUFFING = _of_rate(_duffing, lambda x: x[:, 0], (0.0, 0.0), 1 / 600, 10)
SYSTEMS: dict[str, System] = {
    "Bouc-Wen": System(
        1 / 750, (2.0, 10.0, 5e4, 5e4, 1e3, 0.8, -1.1), _sines(50, 0.013, 0.4), _BOUC_WEN, 0.005
    ),
    "Wiener-Hammerstein": System(
        1 / 1000, (1.0, 1.0, 1.5), _sines(1, 0.0, 0.3), _wiener_hammerstein, 0.002
    ),
    "motor": System(0.02, (4.0, 60.0, 8.0, 5.0), _steps(-1.5, 1.5, 40), _MOTOR, 0.01),
    "tank that overflows": System(4.0, (0.12, 0.08, 0.13, 0.5), _steps(1.0, 6.5, 25), _TANKS, 0.01),
    "Duffing": System(1 / 600, (80.0, 1.6e5, 2e5), _sines(2.5e4, 0.0, 0.4), _DUFFING, 0.005),
}


def drawn(
    name: str, seed: int, samples: int, tested: int = 2000, amplitudes: Sequence[float] = (1.0,)
) -> list[Record]:
    """The training record of so many samples, and test records, of one of the `SYSTEMS`.

    The input of each test record has one of the `amplitudes`, in those of training.
    """
    system, rng = SYSTEMS[name], np.random.default_rng(seed)
    p = np.array(system.parameters) * (1 + SPREAD * rng.uniform(-1, 1, len(system.parameters)))
    records = []
    tests = [(tested, 0.0, amplitude) for amplitude in amplitudes]
    for length, noise, amplitude in [(samples, system.noise, 1.0), *tests]:
        u = amplitude * system.drive(rng, length)
        y = system.measure(p, u, rng)
        seen = y + noise * y.std() * rng.standard_normal(length)
        records.append(Record(seen, system.step, u=u, name=name))
    return records
