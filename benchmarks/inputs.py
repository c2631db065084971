"""What `splitband compare` reaches on records with known inputs: a linear system and two others.

    python -m benchmarks.inputs [--out docs/benchmarks] [--jobs 2]

2,000 samples each, of which 1,200 are trained on; every choice is made on those, within the default
budget. A record whose results are in inputs.json is not computed again, and one that was cut off
goes on.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy

import splitband as sb
from splitband.data import Record
from splitband.evaluation.work import Work
from splitband.report.results import results
from splitband.runtime.files import CHECKPOINTS, write_json

Array = npt.NDArray[np.float64]
SAMPLES, TRAINING = 2000, 1200


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


def duffing(rng: np.random.Generator) -> Record:
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


RECORDS: tuple[Callable[[np.random.Generator], Record], ...] = (two_masses, tanks, duffing)
MIXED: tuple[Callable[[np.random.Generator], Record], ...] = (tanks_and_cycle,)
"""With a part that the inputs explain, and one that they do not."""


def main() -> None:
    """Measure the records that are missing, and print each method's error."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    out: Path = arguments.out
    path, checkpoints = out / "inputs.json", out / CHECKPOINTS
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for make in (*RECORDS, *MIXED):
        record = make(np.random.default_rng(0))
        if record.name in found:
            continue
        work = Work(arguments.jobs, None, checkpoints / record.name.replace(" ", "-"))
        found[record.name] = facts = results(sb.compare(record, TRAINING, work=work))
        write_json(path, found)
        shutil.rmtree(checkpoints)
        print(f"{record.name}: recommended {facts['recommended']}")
        for method, of_method in facts["methods"].items():
            print(f"  {method:24} {of_method['total_rmse_mean']:.4f}", flush=True)


if __name__ == "__main__":
    main()
