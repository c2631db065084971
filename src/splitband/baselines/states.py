"""Estimate the initial state of a linear model from a history and the states in training.

The state is written as the polynomial C of `baselines.channel`, `(n,)`: without inputs the output
is C / A. It is what `scipy.signal.lfilter` calls `zi`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.common import known
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

FACTORS = np.geomspace(1e-4, 1e6, 41)
"""Candidate factors of the prior covariance of an initial state. By eye."""
SURPRISING = 8.0
"""Rise of twice the log-likelihood that a factor other than the usual one must bring. By eye."""
EXACT = 1e-9
"""Smallest model error, as a share of the response to a usual state; smaller ones are rounding."""
_MOST_CORRELATED = 0.999
"""Upper limit of the correlation of successive errors. By eye."""


@saved
class States(NamedTuple):
    """Hold the states that a linear model had in training, and its errors.

    Attributes
    ----------
    mean, root : Mean of the states, `(n,)`, and a square root R of their covariance R'R, `(n, n)`.
    error : RMSE of the simulation of the training records.
    correlation : Correlation of successive errors, 0 to 1.
    """

    mean: Array
    root: Array
    error: float
    correlation: float

    @classmethod
    def of(
        cls, a: Array, b: Array, runs: Sequence[tuple[Array, Array]], errors: Sequence[Array]
    ) -> States:
        """Return the statistics of the states and errors of simulations.

        Parameters
        ----------
        a : A, `(n + 1,)`.
        b : B of each input, `(nu, n + 1)`.
        runs : Output without the offset, `(time,)`, and inputs, `(time, nu)`, of each simulation.
        errors : Errors of each simulation, `(time,)`, NaN in gaps.
        """
        states = np.concatenate([_states(a, b, y, u) for y, u in runs])
        mean = states.mean(axis=0)
        _, size, directions = np.linalg.svd(states - mean, full_matrices=False)
        root = np.zeros((len(a) - 1, len(a) - 1))
        root[: len(size)] = (size / np.sqrt(len(states)))[:, None] * directions
        power = float(np.nanmean(np.concatenate(errors) ** 2))
        pairs = np.concatenate([e[1:] * e[:-1] for e in errors])
        pairs = pairs[~np.isnan(pairs)]
        correlation = float(pairs.mean()) / power if len(pairs) and power else 0.0
        return cls(mean, root, float(np.sqrt(power)), min(max(correlation, 0.0), _MOST_CORRELATED))

    def scaled(self, scale: float) -> States:
        """Return the statistics for outputs that are `scale` times as large."""
        return self._replace(
            mean=scale * self.mean, root=scale * self.root, error=scale * self.error
        )

    def correction(self, left: Array, samples: int, a: Array, expected: bool) -> Array:
        """Return the correction of a simulation for its estimated initial state, `(samples,)`.

        The state is the maximum a posteriori estimate, for Gaussian errors correlated as in
        training, and for a prior around the assumed state: the covariance in training times a
        factor. If the first samples are surprising, the factor is the most likely one (empirical
        Bayes); otherwise the usual one, so that noise alone does not move an expected state.

        Parameters
        ----------
        left : First measured samples minus the simulation from the assumed state, `(any time,)`,
            NaN in gaps.
        samples : Number of samples to return, from the first of `left` on.
        a : A, `(n + 1,)`.
        expected : Whether the assumed state was simulated (usual factor 0), or is the mean of
            the states in training (usual factor 1).
        """
        impulse = np.asarray(np.arange(samples) == 0, dtype=np.float64)
        answers = np.stack([scipy.signal.lfilter(c, a, impulse) for c in self.root], axis=1)
        rows = known(left)
        both = self._whitened(np.hstack([answers[rows], left[rows, None]]), rows)
        outer, size, inner = np.linalg.svd(both[:, :-1], full_matrices=False)
        if not size.any():
            return np.zeros(samples)
        seen = outer.T @ both[:, -1]
        noise = max(self.error, EXACT * float(abs(answers).max())) ** 2

        def unlikely(factor: float) -> float:
            variance = noise + factor * size**2
            return float(np.sum(np.log(variance) + seen**2 / variance))

        usual = 0.0 if expected else 1.0
        factor = min(FACTORS, key=unlikely)
        if unlikely(factor) + SURPRISING > unlikely(usual):
            factor = usual
        return np.asarray(answers @ (inner.T @ (factor * size * seen / (noise + factor * size**2))))

    def _whitened(self, x: Array, rows: npt.NDArray[np.int_]) -> Array:
        """Return samples at these rows, `(rows, any)`, whitened by the correlation of errors."""
        kept = self.correlation ** np.diff(rows)[:, None]
        return np.concatenate([x[:1], (x[1:] - kept * x[:-1]) / np.sqrt(1 - kept**2)])


def _states(a: Array, b: Array, y: Array, u: Array) -> Array:
    """Return the state before each sample from the n-th on, `(time, n)`; 0 for fewer samples."""
    order, samples = len(a) - 1, len(y)
    if samples <= order:
        return np.zeros((1, order))
    states = np.zeros((samples - order, order))
    for k in range(order):
        for j in range(k + 1, order + 1):
            past = slice(order + k - j, samples + k - j)
            states[:, k] += u[past] @ b[:, j] - a[j] * y[past]
    return states
