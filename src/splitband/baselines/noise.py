"""Fit the Kalman filter of a linear system, or the whole system by prediction error.

With the gain K the system is x' = A x + B u + K e, y = C x + D u + offset + e, where e is white.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

from splitband.baselines.modal import Run, blocks_of
from splitband.baselines.refinement import Solution, linear_solution, refined
from splitband.baselines.systems import kalman_gain, states
from splitband.runtime.arrays import Array

_FACTORS = (0.0, *np.geomspace(1e-4, 1.0, 9))
"""Process noise that is tried, as a share of the states' standard deviations in the record.
By eye."""
_FREE = 24
"""Most entries of the gain that are refined one by one. By eye."""
_MARGIN = 1e-9
"""Distance of the observer's poles from the unit circle, at least."""
_ITERATIONS = 15
"""Most iterations of a refinement by prediction error. By eye."""
_LAGS = 16
"""Past samples from which an input is predicted. By eye."""
_ROWS = 20_000
"""Most samples of a record for this. By eye."""
_SHARE = 0.02
"""Share of an input's unpredicted power that past errors explain behind a controller. By eye."""
_CHANCE = 1e-6
"""Probability that errors without effect do so. By eye."""


def innovations(a: Array, c: Array, gain: Array, errors: Array) -> Array:
    """Return the prediction errors `(time, ny)` of simulation errors `(time, ny)`."""
    x = states(a - gain @ c, errors @ gain.T, np.zeros(len(a)))
    return errors - x @ c.T


@np.errstate(all="ignore")
def covariance(
    a: Array, c: Array, gain: Array, errors: Sequence[Array], seen: Sequence[Array]
) -> Array:
    """Return the covariance of prediction errors `(ny, ny)`; arguments as of `fitted_gain`."""
    left = np.concatenate(
        [innovations(a, c, gain, e) * s for e, s in zip(errors, seen, strict=True)]
    )
    return np.asarray(left.T @ left / np.maximum(np.concatenate(seen).sum(axis=0), 1))


def fitted_gain(
    a: Array,
    c: Array,
    spread: Array,
    errors: Sequence[Array],
    seen: Sequence[Array],
) -> Array:
    """Return the gain K `(states, ny)` that predicts best, for the errors of a simulation.

    The gains of a Riccati equation, with process noise in proportion to the states' covariance in
    the record, are the start; a small gain is then refined entry by entry.

    Parameters
    ----------
    a, c : Of the simulated system.
    spread : Covariance of its states in the record, `(states, states)`.
    errors, seen : Simulation errors of each record, 0 in gaps, and 1 where outputs were measured,
        `(time, ny)` each.
    """

    def cost(gain: Array) -> float:
        observer = a - gain @ c
        if len(a) and abs(np.linalg.eigvals(observer)).max() > 1 - _MARGIN and gain.any():
            return np.inf
        power = np.diag(covariance(a, c, gain, errors, seen))
        return float(np.log(np.maximum(power, 1e-24)).sum()) if np.isfinite(power).all() else np.inf

    together = np.concatenate(errors)
    r = together.T @ together / len(together) + 1e-18 * np.eye(len(c))
    gains = [np.zeros((len(a), len(c)))]
    for factor in _FACTORS[1 :: 1 if len(a) <= 12 else 3]:
        try:
            gains.append(kalman_gain(a, c, factor**2 * spread + 1e-18 * np.eye(len(a)), r))
        except (np.linalg.LinAlgError, ValueError):
            continue
    stable = len(a) == 0 or abs(np.linalg.eigvals(a)).max() <= 1
    best = min(gains if stable else gains[1:] or gains, key=cost)
    if best.any() and best.size <= _FREE:
        best = _refined(best, cost)
    return best


def _refined(gain: Array, cost: Callable[[Array], float]) -> Array:
    """Return the gain after a local search."""
    scale = float(abs(gain).max())

    def bounded(x: Array) -> float:
        return min(cost(scale * x.reshape(gain.shape)), 1e6)

    start = gain.ravel() / scale
    minimum: Any = scipy.optimize.minimize(
        bounded, start, method="L-BFGS-B", options={"maxiter": 15}
    )
    return np.asarray(scale * minimum.x.reshape(gain.shape))


class Predicted(NamedTuple):
    """Hold a system in innovations form that was fitted by prediction error.

    `solution` has the blocks of the predictor, whose inputs are those of the record and its
    outputs.
    """

    solution: Solution
    runs: tuple[Run, ...]

    def matrices(self, step: Array | None = None) -> tuple[Array, Array, Array, Array, Array]:
        """Return A, B, C, D and K, after a step of the predictor's parameters."""
        blocks = self.solution.blocks if step is None else self.solution.blocks.moved(step)
        a, b, c, d = blocks.matrices()
        nu = b.shape[1] - len(c)
        gain, d = b[:, nu:], d[:, :nu]
        return a + gain @ c, b[:, :nu] + gain @ d, c, d, gain


def prediction_error(
    a: Array,
    c: Array,
    gain: Array,
    direct: Sequence[bool],
    runs: Sequence[Run],
    simulated: Sequence[Array],
) -> Predicted:
    """Return the system of this order with the least one-step prediction error.

    Parameters
    ----------
    a, c, gain : From where it starts.
    direct : Whether each input may act at once.
    runs : The records.
    simulated : Outputs in gaps, `(ny, time)` for each record.
    """
    filled = []
    for run, y in zip(runs, simulated, strict=True):
        whole = np.where(run.seen > 0, run.y, y)
        filled.append(run._replace(u=np.vstack([run.u, whole])))
    begin = linear_solution(blocks_of(a - gain @ c, c, [*direct, *[False] * len(c)]), filled)
    at = refined(begin.blocks, filled, _ITERATIONS, begin.first, 1 - _MARGIN)
    return Predicted(at, tuple(filled))


def feedback(errors: Sequence[Array], inputs: Sequence[Array]) -> bool:
    """Return whether a controller acts on the inputs: past errors of a simulation predict an input.

    Beside its own past and that of the other inputs, that is (C. W. J. Granger, 1969). In an open
    loop the errors are noise, which no input knows.

    Parameters
    ----------
    errors, inputs : Of each record, `(ny, time)` and `(nu, time)`.
    """
    rows = [
        np.vstack([_lagged(u), _lagged(e), u[:, _LAGS:]]).T[:_ROWS]
        for e, u in zip(errors, inputs, strict=True)
        if u.shape[1] > 2 * _LAGS
    ]
    if not rows:
        return False
    data, nu, ny = np.concatenate(rows), len(inputs[0]), len(errors[0])
    freedom = len(data) - data.shape[1]
    if freedom < data.shape[1]:
        return False
    size = np.linalg.norm(data, axis=0)
    r: Array = np.asarray(np.linalg.qr(data / np.where(size > 0, size, 1.0), mode="r"))
    own, both = nu * _LAGS, (nu + ny) * _LAGS
    explained = (r[own:both, both:] ** 2).sum(axis=0)
    left = (np.triu(r[both:, both:]) ** 2).sum(axis=0) + 1e-18
    least = max(_SHARE, scipy.stats.f.isf(_CHANCE, both - own, freedom) * (both - own) / freedom)
    return bool((explained > least * left).any())


def _lagged(x: Array) -> Array:
    """Return the signals 1, 2, ... `_LAGS` samples late, `(signals * _LAGS, time - _LAGS)`."""
    time = x.shape[1]
    return np.concatenate([x[:, _LAGS - lag : time - lag] for lag in range(1, _LAGS + 1)])
