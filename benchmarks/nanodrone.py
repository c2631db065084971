"""Predict the NanoDrone benchmark 1 to 50 samples ahead, from every sample of its test flights.

The files are those of data/train and data/test of idsia-robotics/nanodrone-sysid-benchmark, a
motion-captured Crazyflie at 100 Hz (Busetto et al., 2026, arXiv:2512.14450), below
`SPLITBAND_DATA_DIR`/benchmarks/nanodrone. They could not be had where this was written: it was
tested on files of that layout alone, and no hash is pinned.

    python -m benchmarks.nanodrone --budget 600 --cores 2
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial.transform import Rotation

from splitband import Forecaster, Record, compare
from splitband.forecasters.held_out import Origin, forecasts

Array = npt.NDArray[np.float64]
AHEAD, STEP = 50, 0.01
QUANTITIES = {"position": 0, "velocity": 3, "rotation": 6, "rate": 9}
"""First of the three outputs of each: m, m/s, rotation vector in rad, rad/s."""
PUBLISHED = {
    "physics": (2.32, 10.62, 5.10, 29.1),
    "physics and residual network": (2.36, 10.40, 6.15, 29.0),
    "LSTM": (5.97, 16.7, 5.65, 35.8),
}
"""Sums over 1 to 50 samples ahead of the mean errors, by quantity."""
OUTPUTS = ("x", "y", "z", "vx", "vy", "vz", "rx", "ry", "rz", "wx", "wy", "wz")
MOTORS = ("m1_erpm", "m2_erpm", "m3_erpm", "m4_erpm")
PER_REVOLUTION = 6
"""Electrical revolutions in one of a motor."""


def flight(path: Path) -> Record:
    """A flight: twelve outputs, and the speeds of the motors in rad/s as inputs."""
    table = pd.read_csv(path)
    rotation = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy()).as_rotvec()
    given = table[[*OUTPUTS[:6], *OUTPUTS[9:]]].to_numpy()
    y = np.hstack([given[:, :6], rotation, given[:, 6:]])
    u = table[[*MOTORS]].to_numpy() * 2 * np.pi / (60 * PER_REVOLUTION)
    return Record(y, STEP, u=u, name=path.stem, columns=OUTPUTS, inputs=MOTORS)


def flights(part: str) -> list[Record]:
    """The flights of the training or of the test part."""
    folder = Path(os.environ["SPLITBAND_DATA_DIR"]) / "benchmarks" / "nanodrone" / part
    found = [flight(path) for path in sorted(folder.glob("*.csv"))]
    if not found:
        raise FileNotFoundError(f"{folder} must have the CSV files of data/{part}")
    return found


def errors(truth: Array, predicted: Array) -> dict[str, Array]:
    """Mean errors by samples ahead of arrays `(origins, steps, 12)`, of each quantity.

    They are Euclidean distances and, of rotations, the angle between both.
    """
    found = {}
    for name, first in QUANTITIES.items():
        one, other = (each[..., first : first + 3] for each in (truth, predicted))
        size = np.linalg.norm(one - other, axis=-1)
        if name == "rotation":
            apart = Rotation.from_rotvec(one.reshape(-1, 3)).inv()
            turn = apart * Rotation.from_rotvec(other.reshape(-1, 3))
            size = turn.magnitude().reshape(size.shape)
        found[name] = size.mean(axis=0)
    return found


def judged(model: Forecaster, tests: Sequence[Record], warmup: int) -> dict[str, Array]:
    """The errors of a model from every sample of the test flights after a warm-up."""
    truth, predicted = list[Array](), list[Array]()
    for test in tests:
        origins = [Origin(0, at, AHEAD) for at in range(warmup, len(test) - AHEAD + 1)]
        for origin, said in forecasts(model, test, origins, other_record=True).items():
            truth.append(test.y[origin.at : origin.at + AHEAD])
            predicted.append(said.y)
    return errors(np.stack(truth), np.stack(predicted))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--budget", type=float, default=600.0, help="seconds of the comparison")
    parser.add_argument("--cores", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    (first, *others), tests = flights("train"), flights("test")
    result = compare(
        first,
        len(first),
        others=others,
        tests=tests,
        ahead=AHEAD,
        budget=given.budget,
        cores=given.cores,
        seed=given.seed,
    )
    print(result)
    found = judged(result.model, tests, max(result.model.warmup, 2))
    for name, of in found.items():
        print(f"{name}: 1, 10, 50 ahead {of[0]:.4g} {of[9]:.4g} {of[-1]:.4g}, sum {of.sum():.4g}")
    print("published sums:", PUBLISHED)


if __name__ == "__main__":
    main()
