"""What the baselines that need no training forecast, on records of known kinds, by kind.

    python -m benchmarks.baselines [--out docs/benchmarks/baselines.json] [--against before.json]

Rules and constants of the baselines were chosen on the development seeds; what is to be believed
are the report seeds, which nothing was chosen on. Both are in the file.

A record is 250 or 600 training samples and 500 to forecast. Errors are RMSE of the forecast, given
as multiples of the oracle's: the forecast of one who knows the equation and its parameters, but
not the noise to come. `--against` puts an earlier file's figures beside the new ones.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import geometric_mean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.data import Record
from splitband.forecasters.backtest import Origin, Question, backtest
from splitband.forecasters.names import NAMES, QUICK, named
from splitband.metrics import rmse
from splitband.runtime.files import write_json
from splitband.runtime.processes import map_jobs

Array = npt.NDArray[np.float64]
Rng = np.random.Generator

BASELINES = tuple(name for name in QUICK if not NAMES[name].needs)
TRAINING, AHEAD = (250, 600), 500
DEVELOPMENT, REPORT = range(6), range(100, 106)


class Sampled(NamedTuple):
    """Samples `(time,)`, training and future, and the oracle's forecast of the future."""

    y: Array
    oracle: Array


def _sine(n: Array, period: float, rng: Rng) -> Array:
    return np.asarray(np.sin(2 * np.pi * n / period + rng.uniform(0, 2 * np.pi)))


def _level(rng: Rng) -> float:
    return float(rng.normal(scale=5))


def _noise(rng: Rng, low: float = 0.02, high: float = 0.5) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def part_of_a_cycle(n: Array, train: int, rng: Rng) -> Array:
    """A sine of which the training part shows 0.3 to 0.9 of a cycle."""
    return _sine(n, train / rng.uniform(0.3, 0.9), rng)


def slow_and_fast_sine(n: Array, train: int, rng: Rng) -> Array:
    """The same, and a faster one."""
    return part_of_a_cycle(n, train, rng) + 0.5 * _sine(n, rng.uniform(15, 40), rng)


def cooling(n: Array, train: int, rng: Rng) -> Array:
    """An exponential towards an asymptote, of which the training part shows 1 to 8 e-foldings."""
    return np.asarray(_level(rng) + 3 * np.exp(-n * rng.uniform(1, 8) / train))


def cooling_and_season(n: Array, train: int, rng: Rng) -> Array:
    """The same with a season of 6 to 15 cycles in the training part."""
    return cooling(n, train, rng) + season(n, train, rng)


def season(n: Array, train: int, rng: Rng) -> Array:
    """A wave of three harmonics, 6 to 15 cycles in the training part."""
    period = train / rng.uniform(6, 15)
    return np.asarray(sum(_sine(n, period / k, rng) / k for k in (1, 2, 3)))


def trend(n: Array, train: int, rng: Rng) -> Array:
    """A straight line that changes by 0.5 to 4 in the training part."""
    return _level(rng) + rng.choice([-1, 1]) * rng.uniform(0.5, 4) * n / train


def trend_and_season(n: Array, train: int, rng: Rng) -> Array:
    """The same with a season."""
    return trend(n, train, rng) + season(n, train, rng)


def swelling_season(n: Array, train: int, rng: Rng) -> Array:
    """A season whose amplitude grows or falls by half over the training part."""
    return (1 + rng.choice([-0.5, 0.5]) * n / (n[-1] + 1)) * season(n, train, rng)


def damped_oscillation(n: Array, train: int, rng: Rng) -> Array:
    """What rings down after a step; 1 to 5 e-foldings in the training part."""
    decay = np.exp(-n * rng.uniform(1, 5) / train)
    return np.asarray(_level(rng) + decay * _sine(n, train / rng.uniform(4, 20), rng))


def one_sine(n: Array, train: int, rng: Rng) -> Array:
    """A sine of 3 to 30 cycles in the training part."""
    return _sine(n, train / rng.uniform(3, 30), rng)


def two_sines(n: Array, train: int, rng: Rng) -> Array:
    """Two of them."""
    return one_sine(n, train, rng) + one_sine(n, train, rng)


def logistic_growth(n: Array, train: int, rng: Rng) -> Array:
    """Growth towards a limit, half of it reached in the first half of the training part."""
    middle, width = rng.uniform(0.1, 0.5) * train, train / rng.uniform(6, 20)
    return np.asarray(_level(rng) + 3 / (1 + np.exp(-(n - middle) / width)))


def constant(n: Array, train: int, rng: Rng) -> Array:
    """A level, and noise alone."""
    return np.full(len(n), _level(rng))


def of_time(signal: Callable[[Array, int, Rng], Array]) -> Callable[[int, Rng], Sampled]:
    """A function of the sample's index and white noise; the oracle knows the function."""

    def record(train: int, rng: Rng) -> Sampled:
        y = signal(np.arange(train + AHEAD, dtype=np.float64), train, rng)
        return Sampled(y + _noise(rng) * rng.normal(size=len(y)), y[train:])

    return record


def autoregression(pole: float, drift: float = 0.0) -> Callable[[int, Rng], Sampled]:
    """y_n = pole * y_(n-1) + drift + noise; a random walk for a pole of 1."""

    def record(train: int, rng: Rng) -> Sampled:
        shocks = drift + rng.normal(size=train + AHEAD + 500)
        y = scipy.signal.lfilter([1.0], [1.0, -pole], shocks)[500:]
        response = scipy.signal.lfilter([1.0], [1.0, -pole], np.full(AHEAD, drift))
        return Sampled(y, y[train - 1] * pole ** np.arange(1, AHEAD + 1) + response)

    return record


def steps(train: int, rng: Rng) -> Sampled:
    """A level that jumps two to five times in the training part, and a season."""
    n = np.arange(train + AHEAD, dtype=np.float64)
    at = rng.integers(0, int(0.9 * train), rng.integers(2, 6))
    y = season(n, train, rng) + (n[:, None] >= at) @ rng.normal(scale=2, size=len(at))
    return Sampled(y + _noise(rng, high=0.2) * rng.normal(size=len(y)), y[train:])


KINDS: dict[str, Callable[[int, Rng], Sampled]] = {
    "part of a cycle": of_time(part_of_a_cycle),
    "slow and fast sine": of_time(slow_and_fast_sine),
    "cooling": of_time(cooling),
    "cooling and season": of_time(cooling_and_season),
    "trend": of_time(trend),
    "trend and season": of_time(trend_and_season),
    "logistic growth": of_time(logistic_growth),
    "season": of_time(season),
    "swelling season": of_time(swelling_season),
    "steps and season": steps,
    "damped oscillation": of_time(damped_oscillation),
    "one sine": of_time(one_sine),
    "two sines": of_time(two_sines),
    "constant": of_time(constant),
    "AR(0.99)": autoregression(0.99),
    "random walk": autoregression(1.0),
    "random walk with drift": autoregression(1.0, 0.2),
}


def _measured(job: tuple[str, int], report: object) -> dict[str, Any]:
    """One record: the RMSE of each baseline's forecast and of the oracle's."""
    kind, seed = job
    train = TRAINING[seed % len(TRAINING)]
    made = KINDS[kind](train, np.random.default_rng([seed, *kind.encode()]))
    record = Record(made.y[:, None], 1.0, name=kind)
    future, found, origin = record.y[train:], {}, Origin(train, train)
    began = time.process_time()
    for name in BASELINES:
        done = backtest(named(name), Question(record, [origin], len(record)))
        found[name] = rmse(future, done.predictions[origin].y)
    seconds = time.process_time() - began
    oracle = rmse(future[:, 0], made.oracle)
    return {"kind": kind, "seed": seed, "rmse": found, "oracle": oracle, "seconds": seconds}


def summarised(found: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """By kind and method, the geometric mean of the error as a multiple of the oracle's."""
    return {
        kind: {
            name: geometric_mean(
                max(f["rmse"][name] / f["oracle"], 1e-9) for f in found if f["kind"] == kind
            )
            for name in next(f for f in found if f["kind"] == kind)["rmse"]
        }
        for kind in dict.fromkeys(f["kind"] for f in found)
    }


def _print(title: str, new: dict[str, Any], old: dict[str, Any]) -> None:
    print(f"\n{title}: forecast RMSE over the oracle's, geometric mean; (before)")
    print(f"{'':24}" + "".join(f"{name:>20}" for name in BASELINES))
    for kind, errors in new.items():
        cells = []
        for name in BASELINES:
            before = old.get(kind, {}).get(name)
            cells.append(f"{errors[name]:.2f}" + (f" ({before:.2f})" if before else ""))
        print(f"{kind:24}" + "".join(f"{cell:>20}" for cell in cells))


def main() -> None:
    """Measure all records, print and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks/baselines.json"))
    parser.add_argument("--against", type=Path, help="an earlier file, to compare with")
    parser.add_argument("--seeds", choices=("development", "report", "both"), default="both")
    parser.add_argument("--kinds", default=",".join(KINDS), help="some of them, by commas")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    kinds = arguments.kinds.split(",")
    earlier = json.loads(arguments.against.read_text()) if arguments.against else {}
    parts = {"development": DEVELOPMENT, "report": REPORT}
    written: dict[str, Any] = {}
    for part, seeds in parts.items():
        if arguments.seeds in (part, "both"):
            jobs = [(kind, seed) for kind in kinds for seed in seeds]
            found = list(map_jobs(partial(_measured), jobs, arguments.jobs))
            before = earlier.get(part, {}).get("over_oracle", {})
            written[part] = {
                "seeds": [*seeds],
                "over_oracle": summarised(found),
                **({"over_oracle_before": before} if before else {}),
                "records": found,
            }
            _print(part, written[part]["over_oracle"], before)
    write_json(arguments.out, written)


if __name__ == "__main__":
    main()
