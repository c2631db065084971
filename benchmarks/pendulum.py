"""A damped pendulum on which a fixed recipe learns nothing: what the default command makes of it.

    python -m benchmarks.pendulum [--draws 1] [--jobs 1]

It swings freely for 2,750 samples, of which 1,000 are trained on: with windows of 400 samples the
training stays on a plateau, with shorter ones it does not. A development record, on which the
search for recipes was made. Each draw of the noise is a file that is made once; `python -m
benchmarks.public --no-run` puts the results into its page.
"""

from __future__ import annotations

import argparse
import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy

import splitband as sb
from splitband.evaluation.work import Work
from splitband.report.results import results
from splitband.runtime.files import CHECKPOINTS, write_json

SAMPLES, TRAINING, STEP = 2750, 1000, 0.02
STIFFNESS, DAMPING, ANGLE, NOISE = 64.2, 0.055, 1.6, 0.005


def pendulum(draw: int) -> sb.Record:
    """The angle in rad, with the noise of a draw."""

    def slope(_: float, state: npt.NDArray[np.float64]) -> Sequence[float]:
        return [state[1], -STIFFNESS * np.sin(state[0]) - DAMPING * state[1]]

    t = STEP * np.arange(SAMPLES)
    solved = scipy.integrate.solve_ivp(slope, (0, t[-1]), [ANGLE, 0], t_eval=t, rtol=1e-9)
    y = solved.y[0]
    noise = NOISE * np.random.default_rng(draw).standard_normal(SAMPLES)
    return sb.Record(y + noise, STEP, y_true=y, name=f"pendulum, draw {draw}")


def measure(draw: int, work: Work) -> dict[str, object]:
    """What `splitband compare` says, the NRMSE of each forecast, and the CPU time of it all."""
    record, began = pendulum(draw), _cpu_seconds()
    comparison = sb.compare(record, TRAINING, work=work)
    truth = record.truth[TRAINING:]
    return {
        "draw": draw,
        "nrmse": {name: sb.nrmse(truth, mean.ahead) for name, mean in comparison.medians.items()},
        "cpu_seconds": round(_cpu_seconds() - began, 1),
    } | results(comparison)


def _cpu_seconds() -> float:
    """Of this process and of those it started that are over."""
    return sum(os.times()[:4])


def path_of(out: Path, draw: int) -> Path:
    """The file of a draw."""
    return out / f"pendulum-{draw}.json"


def main() -> None:
    """Measure what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    arguments = parser.parse_args()
    out: Path = arguments.out
    out.mkdir(parents=True, exist_ok=True)
    for draw in range(arguments.draws):
        path = path_of(out, draw)
        if not path.exists():
            checkpoints = out / CHECKPOINTS / path.stem
            facts = measure(draw, Work(arguments.jobs, None, checkpoints))
            write_json(path, facts)
            shutil.rmtree(out / CHECKPOINTS)
            print(path.stem, facts["recommended"], facts["nrmse"], flush=True)


if __name__ == "__main__":
    main()
