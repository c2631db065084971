"""Models that are wrong, and models that are right, by which the residual tests are judged.

A system of first order, for even seeds, or with a resonance, for odd ones, is driven by one of the
`INPUTS` for 1,000 samples, and measured with one of the `NOISES` of a tenth of the output's
deviation. The right one of the `MODELS` leaves the noise alone. The tests have a level of 99 %; it
was developed on the seeds 0 to 99 (docs/developers/rules.md).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.signal import butter, lfilter

from splitband.checks.residuals import ResidualTests, residual_tests
from splitband.runtime.arrays import Array

SAMPLES, NOISE, BEFORE = 1000, 0.1, 300
POLES = 0.9 * np.exp(1j * np.array([0.3, -0.3]))
TIME = np.arange(SAMPLES)
SMOOTH = butter(3, 0.05, output="ba")
Draw = Callable[[np.random.Generator], Array]


def held(values: Draw, samples: int) -> Draw:
    """Return a signal whose values are held for some samples."""
    return lambda rng: np.repeat(values(rng), samples)[:SAMPLES]


def sines(periods: Draw) -> Draw:
    """Return a sum of sinusoids with random phases; they have whole numbers of periods."""

    def draw(rng: np.random.Generator) -> Array:
        cycles = periods(rng)
        phases = 2 * np.pi * rng.uniform(size=(len(cycles), 1))
        return np.asarray(np.sin(2 * np.pi * cycles[:, None] * TIME / SAMPLES + phases).sum(axis=0))

    return draw


def filtered(b: Array | list[float], a: Array | list[float]) -> Draw:
    """Return filtered white noise, from its steady state."""

    def draw(rng: np.random.Generator) -> Array:
        return np.asarray(lfilter(b, a, rng.standard_normal(SAMPLES + BEFORE))[BEFORE:])

    return draw


def step(rng: np.random.Generator) -> Array:
    """Return a single step, within the middle three fifths."""
    return np.where(rng.integers(SAMPLES // 5, 4 * SAMPLES // 5) > TIME, 0.0, rng.uniform(0.5, 1.5))


def levels(count: int) -> Draw:
    """Return random levels."""
    return lambda rng: rng.uniform(-1, 1, count)


def signs(count: int) -> Draw:
    """Return random signs."""
    return lambda rng: rng.choice([-1.0, 1.0], count)


INPUTS: dict[str, Draw] = {
    "one step": step,
    "5 steps": held(levels(5), 200),
    "20 steps": held(levels(20), 50),
    "binary, fast": held(signs(200), 5),
    "binary, slow": held(signs(25), 40),
    "1 sinusoid": sines(lambda rng: rng.uniform(12, 50, 1)),
    "5 sinusoids": sines(lambda rng: rng.permutation(np.linspace(1, 59, 59))[:5]),
    "30 sinusoids": sines(lambda rng: np.linspace(3, 90, 30)),
    "sawtooth": lambda rng: (TIME + rng.integers(100)) % rng.integers(60, 140) / 50.0 - 1,
    "white noise": filtered([1.0], [1.0]),
    "filtered noise": filtered([1.0], [1.0, -0.8]),
    "slow noise": filtered([1.0], [1.0, -0.97]),
    "smooth noise": filtered(SMOOTH[0], SMOOTH[1]),
}
NOISES: dict[str, Draw] = {
    "white": filtered([1.0], [1.0]),
    "AR(0.8)": filtered([1.0], [1.0, -0.8]),
    "AR(0.97)": filtered([1.0], [1.0, -0.97]),
    "resonant": filtered([1.0], [1.0, *np.poly(POLES)[1:].real]),
    "ARMA": filtered([1.0, -0.7], [1.0, -0.95]),
    "differences": filtered([1.0, -0.9], [1.0]),
    "Laplace": lambda rng: rng.laplace(size=SAMPLES),
}
_GAINS = "right", "of nothing", "half the gain", "9/10 of the gain"
_DELAYS = "3 samples early", "without 60 samples of delay"
MODELS = (*_GAINS, "without a mode", *_DELAYS, "without a square", "without a saturation")


def first_order(u: Array) -> Array:
    """Simulate a first-order system from its steady state."""
    return np.asarray(lfilter([0.0, 0.147], [1.0, -0.951], u))


def resonant(u: Array) -> Array:
    """Simulate a second-order system with a resonance."""
    return np.asarray(lfilter([0.0, 0.2, 0.1], np.real(np.poly(POLES)), u))


def drawn(kind: str, noise: str, model: str, seed: int) -> tuple[Array, Array, Array]:
    """Return the residuals of a model, its simulation, and the input."""
    names = [[*INPUTS].index(kind), [*NOISES].index(noise), MODELS.index(model)]
    rng = np.random.default_rng([seed, *names])
    u, v = INPUTS[kind](rng), NOISES[noise](rng)
    before = np.append(np.full(BEFORE, u[0]), u)
    own, another = (first_order, resonant)[:: 1 - 2 * (seed % 2)]
    x, mode = own(before)[BEFORE:], another(before)[BEFORE:]
    size = x.std()
    late = np.append(np.full(60, x[0]), x)
    saturated = size * np.tanh(1.5 * x / size)
    y, simulated = {
        "right": (x, x),
        "of nothing": (x, 0 * x),
        "half the gain": (x, 0.5 * x),
        "9/10 of the gain": (x, 0.9 * x),
        "without a mode": (x + 0.3 * mode * size / mode.std(), x),
        "3 samples early": (late[57:][:SAMPLES], x),
        "without 60 samples of delay": (late[:SAMPLES], x),
        "without a square": (x + 0.3 * (x - x.mean()) ** 2 / size, x),
        "without a saturation": (saturated, x * (x @ saturated) / (x @ x)),
    }[model]
    return y + NOISE * size * v / v.std() - simulated, simulated, u


def tested(kind: str, noise: str, model: str, seed: int) -> ResidualTests:
    """Return the test of a model."""
    e, simulated, u = drawn(kind, noise, model, seed)
    (test,) = residual_tests(e[:, None], u[:, None], ("y",), ("u",), simulated[:, None])
    return test
