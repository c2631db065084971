"""A damped pendulum on which a fixed recipe learns nothing: what the default command makes of it.

    python -m benchmarks.pendulum [--draws 5] [--budget 120]

It swings freely for 2,750 samples, of which 1,000 are trained on: with windows of 400 samples the
training stays on a plateau, with shorter ones it does not. A development record, on which the
search for recipes was made. A draw of the noise that is there is not run again; `python -m
benchmarks.public --no-run` puts the results into its page.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import scipy

import splitband as sb
from benchmarks.plain import BUDGET, Facts, compared, complete

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


def measured(draw: int, budget: float) -> Facts:
    """Return what `splitband compare` says, and the NRMSE of each forecast."""
    record = pendulum(draw)
    facts = compared(record, TRAINING, seed=draw, budget=budget)
    scale = record.truth[TRAINING:].std()
    return facts | {
        "errors": {name: [float(of[0] / scale)] for name, of in facts["errors"].items()}
    }


def main() -> None:
    """Measure what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--budget", type=float, default=BUDGET, metavar="SECONDS")
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    given = parser.parse_args()
    run = partial(measured, budget=given.budget)
    complete(given.out, "pendulum", given.budget, range(given.draws), run)


if __name__ == "__main__":
    main()
