"""The systems of the paper that are simulated, and named records for the command line."""

from __future__ import annotations

import numpy as np

from splitband.data import Trajectory, double_torsion


def double_mass_spring(
    samples: int = 1000, noise_variance: float = 0.1, seed: int = 0
) -> Trajectory:
    """System (i): two superposed cosines and an offset (paper, supplement, Eq. 19).

    Parameters
    ----------
    samples : At 0.1 s.
    noise_variance : Of the Gaussian noise on `y`; `y_true` is without.
    seed : Of the noise.
    """
    t = 0.1 * np.arange(samples)
    x = 1.28 * np.cos(2 * np.pi * 0.115 * t - 7.7) + 0.677 * np.cos(2 * np.pi * 0.57 * t) - 0.009
    noise = np.random.default_rng(seed).normal(0.0, np.sqrt(noise_variance), samples)
    return Trajectory(x + noise, 0.1, y_true=x, name="double-mass-spring", columns=("x",))


RECORDS = {"double-mass-spring": double_mass_spring, "double-torsion": double_torsion}
