"""Test how often `periodic` finds a period where there is none, and misses one that is there.

python -m benchmarks.periods [--draws 12] [--first 0] [--out FILE.json]

Signals are drawn afresh: Fourier series below noise, and signals without a period. The forecast of
`periodic` is compared with that of a constant (on a trend where there is one).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from benchmarks.timing import circumstances, write
from splitband.baselines.modes import Modes
from splitband.baselines.periodic import PeriodicRegression
from splitband.baselines.trend import find

Array = npt.NDArray[np.float64]
LENGTHS = (400, 1200)
AHEAD = 0.5
"""Samples forecast, by those fitted."""
DIFFERENT = 1.1
"""Ratio of two errors from which on one forecast counts as worse than the other."""


def series(noise: float) -> Callable[[np.random.Generator, int], Array]:
    """Return what draws a Fourier series with noise, in units of its standard deviation."""

    def draw(rng: np.random.Generator, samples: int) -> Array:
        period, order = rng.uniform(12, 100), np.arange(1, rng.integers(1, 7) + 1)
        phase = 2 * np.pi * np.outer(np.arange(samples), order) / period
        y = np.cos(phase + rng.uniform(0, 2 * np.pi, len(order))) @ rng.normal(size=len(order))
        return np.asarray(y / y.std() + noise * rng.standard_normal(samples))

    return draw


def driven(damping: float) -> Callable[[np.random.Generator, int], Array]:
    """Return what draws an oscillator's response to random steps of random lengths."""

    def draw(rng: np.random.Generator, samples: int) -> Array:
        u = np.repeat(rng.normal(size=samples), rng.integers(5, 40))[:samples]
        pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * 2 * np.pi / rng.uniform(15, 80))
        return _measured(scipy.signal.lfilter([1.0], [1, -2 * pole.real, abs(pole) ** 2], u), rng)

    return draw


def first_order(rng: np.random.Generator, samples: int) -> Array:
    """Return a first-order system's response to white noise."""
    pole = 1 - 1 / rng.uniform(5, 50)
    return _measured(scipy.signal.lfilter([1.0], [1, -pole], rng.normal(size=samples)), rng)


def random_walk(rng: np.random.Generator, samples: int) -> Array:
    """Return the sum of white noise."""
    return np.asarray(rng.standard_normal(samples).cumsum())


def chirp(rng: np.random.Generator, samples: int) -> Array:
    """Return a sine whose frequency grows by a factor of two to five."""
    first, factor = 1 / rng.uniform(50, 150), rng.uniform(2, 5)
    t = np.arange(samples)
    y = scipy.signal.chirp(t, first, int(samples / (1 + AHEAD)), factor * first)
    return _measured(y, rng)


def white(rng: np.random.Generator, samples: int) -> Array:
    """Return white noise."""
    return rng.standard_normal(samples)


def _measured(y: Array, rng: np.random.Generator) -> Array:
    return np.asarray(y + 0.02 * y.std() * rng.standard_normal(len(y)))


KINDS: dict[str, tuple[bool, Callable[[np.random.Generator, int], Array]]] = {
    **{f"series, noise {noise:g}": (True, series(noise)) for noise in (0.1, 0.5, 1, 2, 3)},
    "driven, damping 0.5": (False, driven(0.5)),
    "driven, damping 0.05": (False, driven(0.05)),
    "first order": (False, first_order),
    "random walk": (False, random_walk),
    "chirp": (False, chirp),
    "white noise": (False, white),
}
"""Each kind of signal: whether it has a period, and what draws it."""


def tried(kind: str, samples: int, seed: int) -> dict[str, Any]:
    """Fit one signal; return the period that was found, and the errors of both forecasts."""
    has, draw = KINDS[kind]
    rng = np.random.default_rng([seed, samples, [*KINDS].index(kind)])
    y = draw(rng, int(samples * (1 + AHEAD)))
    seen, later = y[:samples], y[samples:]
    fitted = PeriodicRegression.fit(seen[:, None])
    trend = find(seen)
    flat = Modes.none(seen, trend.shape if trend else None)
    ahead = np.arange(samples, len(y))
    errors = [
        float(np.sqrt(np.mean((later - forecast) ** 2)))
        for forecast in (fitted.predict(samples, len(later))[:, 0], flat.predict(ahead))
    ]
    return {
        "kind": kind,
        "has_period": has,
        "samples": samples,
        "seed": seed,
        "found": fitted.periods[0],
        "error": errors[0],
        "error_flat": errors[1],
    }


def rates(found: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Return the shares of missed periods and false alarms, and the error over that of the best."""
    there = [each for each in found if each["has_period"]]
    others = [each for each in found if not each["has_period"]]
    missed = [each for each in there if each["error"] > DIFFERENT * min(_both(each))]
    alarms = [each for each in others if each["found"]]
    harmful = [each for each in alarms if each["error"] > DIFFERENT * each["error_flat"]]
    regret = [np.log(each["error"] / min(_both(each))) for each in found]
    return {
        "missed": len(missed) / max(len(there), 1),
        "false_alarms": len(alarms) / max(len(others), 1),
        "harmful_false_alarms": len(harmful) / max(len(others), 1),
        "error_over_best": float(np.exp(np.mean(regret))),
    }


def _both(each: dict[str, Any]) -> tuple[float, float]:
    return each["error"], each["error_flat"]


def main() -> None:
    """Draw, fit and print; see the module."""
    parser = argparse.ArgumentParser(description="Test the threshold of periodic regression")
    parser.add_argument("--draws", type=int, default=12)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.draws)
    found = [tried(kind, n, seed) for kind in KINDS for n in LENGTHS for seed in seeds]
    by_kind = {kind: rates([each for each in found if each["kind"] == kind]) for kind in KINDS}
    for kind, row in {"all": rates(found), **by_kind}.items():
        print(kind, {name: round(value, 3) for name, value in row.items()})
    if options.out:
        facts = {"all": rates(found), "by_kind": by_kind, "found": found}
        write({**circumstances(), "seeds": [seeds[0], seeds[-1]], **facts}, options.out)


if __name__ == "__main__":
    main()
