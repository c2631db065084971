"""How good the recommendation and its bands are, over many records of many kinds.

    python -m benchmarks.recommendation [--out docs/benchmarks] [--seeds 3] [--jobs 2]

Baselines only, which take no training: what they are worth differs as much as it does for networks.
Regret is the error of the recommended one over that of the best one, known afterwards.
"""

from __future__ import annotations

import argparse
import math
import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.comparison import compare
from splitband.data import Trajectory, double_torsion, drill_string
from splitband.defaults import default_setup
from splitband.files import write_json
from splitband.processes import over
from splitband.systems import double_mass_spring, double_torsion_pendulum, van_der_pol
from splitband.trial import try_out

Array = npt.NDArray[Any]
BASELINES = ("mean", "persistence", "seasonal-naive", "periodic", "harmonic")
SAMPLES, TRAINING = 2000, (600, 1000)
UNBOUNDED = ("random walk", "trend")
"""Kinds whose future lies outside of everything that was seen."""


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


def _sine(n: Array, period: float) -> Array:
    return np.sin(2 * np.pi * n / period)


def _tones(n: Array, rng: np.random.Generator) -> Array:
    phase = 2 * np.pi * np.outer(n, rng.uniform(0.003, 0.06, 5)) + rng.uniform(0, 6, 5)
    return np.asarray(np.sin(phase) @ rng.uniform(0.2, 1, 5))


def _wandering(n: Array, rng: np.random.Generator) -> Array:
    phase = np.cumsum(2 * np.pi / 50 * (1 + 0.1 * rng.normal(size=len(n))))
    return np.asarray(np.sin(phase) + 0.3 * np.sin(2 * phase))


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
}


def records(seeds: int) -> Iterator[tuple[str, Callable[[], Trajectory], int]]:
    """Kind, record and training samples."""
    for kind in KINDS:
        for seed in range(seeds):
            yield from ((kind, partial(_record, kind, seed), train) for train in TRAINING)
    yield "double-torsion record", double_torsion, 600
    for row in ("ii", "iii", "iv"):
        yield "pendulum", partial(double_torsion_pendulum, row), 600
    yield "v", van_der_pol, 600
    yield "vi", drill_string, 2000
    yield from (("i", partial(double_mass_spring, seed=draw), 250) for draw in range(4))


def _record(kind: str, seed: int) -> Trajectory:
    return Trajectory(KINDS[kind](np.random.default_rng(seed)), 0.1, name=kind)


def _measured(job: tuple[str, Callable[[], Trajectory], int], report: object) -> dict[str, Any]:
    kind, make, train = job
    record = replace(make(), y_sim=None, beyond=None)
    setup = default_setup(record, train)
    runs = compare(record, BASELINES, setup)
    trial = try_out(record, BASELINES, setup)
    settled = trial.settled(runs)
    best = min(r[0].total_rmse for r in runs.values())
    left = record.y[train:] - runs[settled.recommended][0].forecast
    return {
        "kind": kind,
        "train": train,
        "recommended": settled.recommended,
        "regret": runs[settled.recommended][0].total_rmse / best,
        "regret_by_held_out_alone": runs[trial.recommended][0].total_rmse / best,
        "in_band": settled.bands[settled.recommended].coverage(left),
    }


def main() -> None:
    """Measure all records and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    found = list(over(_measured, [*records(arguments.seeds)], arguments.jobs))
    bounded = [f for f in found if f["kind"] not in UNBOUNDED]
    summary = {
        "records": len(found),
        "mean_log_regret": statistics.mean(math.log(f["regret"]) for f in found),
        "mean_log_regret_by_held_out_alone": statistics.mean(
            math.log(f["regret_by_held_out_alone"]) for f in found
        ),
        "in_band": statistics.mean(f["in_band"] for f in found),
        "in_band_bounded": statistics.mean(f["in_band"] for f in bounded),
    }
    print(summary)
    write_json(arguments.out / "recommendation.json", {**summary, "found": found})


if __name__ == "__main__":
    main()
