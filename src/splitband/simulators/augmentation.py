"""Train the unknown terms of an equation together with its parameters.

The weights begin at a term of 0, at the parameters and states that were found without it. Their
prior has two parts. Weights are drawn to their beginning, by a weight decay that is chosen on
held-out samples. And a term does not take the part of a parameter: what it adds to the right-hand
side is projected on the derivatives by the parameters (Györök, Hoekstra, Kon, Péni, Schoukens and
Tóth, L4DC 2025), and the change of parameters that it stands for is drawn to 0, where the record
leaves the choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.shooting import Experiment, Shooting
from splitband.simulators.unknown import Trained, packed

DECAYS = 1.0, 100.0
"""Weight decays that are tried: so many times the squared weights count as an error of one
deviation of the noise in one sample. Chosen by the errors of drawn systems (`drawn-springs` and
`drawn-tanks` of `benchmarks.unknown`)."""
MEMBERS = 4
"""Trainings from different weights. Bounds the time."""
AS_GOOD = 1.1
"""Largest held-out error of a further training that is kept, by the least one. By eye."""
HELD_OUT = 0.25
"""Share of the samples of a record, its last ones, by which the weight decay is chosen. By eye."""
_TAKEN = 0.1
"""Change of a parameter for which a term may stand, as a share of its range. By eye."""
_POINTS = 200
"""Largest number of samples on which terms are compared with parameters. Bounds the time."""
Prior = Callable[[Array], tuple[Array, Array]]


def begun(
    shooting: Shooting, unknowns: Array, path: Sequence[Array], seed: int
) -> tuple[Any, Array]:
    """Return the simulator with terms that begin at 0, and which weights are to be trained.

    Arguments as of `prior`; `seed` is that of the weights.
    """
    simulator = shooting.simulator
    points = _points(shooting, unknowns, path)
    by_output = _gains(simulator, points, shooting.sizes)
    states, trained, at = list[Any](), [], 0
    for i, term in enumerate(simulator.terms):
        state = term.trained
        if term.free:
            pairs = zip(path, shooting.experiments, strict=True)
            z = np.concatenate([_quantities(term, x, each) for x, each in pairs])
            state = term.begun(z, by_output[at : at + term.outputs], seed + 1000 * i)
        trained.append(np.full(0 if state is None else len(state.weights), term.free))
        states.append(state)
        at += term.outputs
    return simulator.taught(states), np.concatenate(trained)


def prior(shooting: Shooting, unknowns: Array, path: Sequence[Array], decay: float) -> Prior:
    """Return the prior of the weights of terms.

    Parameters
    ----------
    shooting : The comparison, with the terms as they begin.
    unknowns : Of the comparison: parameters and weights.
    path : States by record, `(time, nx)`.
    decay : Weight decay.
    """
    simulator, trained = shooting.simulator, shooting.trained
    beginning = simulator.weights[trained]
    points, terms = _points(shooting, unknowns, path), simulator.resolved_terms
    z = [np.concatenate([_row(term, x, u) for term in terms]) for _, _, x, u in points]
    takes = _takes(shooting, points)

    def residuals(weights: Array) -> tuple[Array, Array]:
        from splitband.kernels.terms import evaluate  # noqa: PLC0415  numba is slow to load

        whole = simulator.weights.copy()
        whole[trained] = weights
        arrays = packed(simulator.weighted(whole).resolved_terms)
        w = np.empty(takes.shape[2])
        by_z, by_theta = np.empty((len(w), len(z[0]))), np.empty((len(w), len(whole)))
        taken, slopes = np.zeros(len(takes[0])), np.zeros((len(takes[0]), len(weights)))
        for take, quantities in zip(takes, z, strict=True):
            evaluate(*arrays, quantities, w, by_z, by_theta)
            taken += take @ w
            slopes += take @ by_theta[:, trained]
        steady = np.sqrt(decay) * np.eye(len(weights))
        left = np.sqrt(decay) * (weights - beginning)
        return np.concatenate([taken, left]), np.vstack([slopes, steady])

    return residuals


def beginnings(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Return the experiments without their last samples, which are held out."""
    return [each.part(0, int((1 - HELD_OUT) * len(each.y))) for each in experiments]


def held(shooting: Shooting, path: Sequence[Array]) -> tuple[Trained, ...]:
    """Return the states of trained terms, with the range that the records visited."""
    states = list[Any]()
    for term in shooting.simulator.terms:
        if term.trained is None:
            states.append(None)
            continue
        pairs = zip(path, shooting.experiments, strict=True)
        z = np.concatenate([_quantities(term, x, each) for x, each in pairs])
        states.append(term.holding(z).trained)
    return tuple(states)


def _quantities(term: Any, x: Array, experiment: Experiment) -> Array:
    good = np.isfinite(x).all(axis=1)
    u = None if experiment.u is None else experiment.u[good]
    z: Array = term.quantities(x[good], u)
    return z


def _row(term: Any, x: Array, u: Array) -> Array:
    z: Array = term.quantities(x[None], u[None])[0] if term.trained else np.empty(0)
    return z


def _points(shooting: Shooting, unknowns: Array, path: Sequence[Array]) -> list[Any]:
    """Return values of the parameters, time, state and inputs at samples on the way."""
    points = []
    for record, (x, each) in enumerate(zip(path, shooting.experiments, strict=True)):
        values = shooting.values(unknowns, record)
        good = np.flatnonzero(np.isfinite(x).all(axis=1))
        count = min(len(good), _POINTS // len(path) + 1)
        for n in good[np.linspace(0, len(good) - 1, count).astype(int)]:
            u = np.empty(0) if each.u is None else each.u[n]
            points.append((values, float(each.time[n]), x[n], u))
    return points


def _slope(simulator: Any, point: Any, w: Array, **changed: float) -> Array:
    values, time, x, u = point
    with np.errstate(all="ignore"):
        slope = simulator.rhs(time, x, u, simulator.p({**values, **changed}), w)
    return np.array([float(slope[i]) for i in range(len(x))])


def _gains(simulator: Any, points: Sequence[Any], sizes: Array) -> Array:
    """Return the outputs of terms that change the right-hand side as much as its own size."""
    zero = np.zeros(sum(term.outputs for term in simulator.terms))
    at = np.array([_slope(simulator, point, zero) for point in points])
    scales = []
    for output, unit in enumerate(np.eye(len(zero))):
        change = np.array([_slope(simulator, point, unit) for point in points]) - at
        own, by = (np.sqrt(np.nanmean(each**2, axis=0)) for each in (at, change))
        some = by > 0
        if not some.any():
            raise InputError(
                f"outputs of unknown terms must each be in the equation: w[{output}] changes "
                "nothing along the record; use it in rhs, or give fewer outputs"
            )
        scales.append(float(np.min(own[some] / by[some], initial=np.inf)))
    return np.array([scale if np.isfinite(scale) and scale > 0 else 1.0 for scale in scales])


def _takes(shooting: Shooting, points: Sequence[Any]) -> Array:
    """Return the change of parameters for which outputs of terms stand, `(points, n, outputs)`.

    In `_TAKEN` of the ranges; the changes of all points are added.
    """
    simulator, known = shooting.simulator, shooting.simulator.known
    by_parameter, by_output = [], []
    for point in points:
        values, _, x, u = point
        w = np.concatenate([term.at(x, u) for term in simulator.resolved_terms])
        at = _slope(simulator, point, w)
        steps = {name: known.step(name, values[name], 1e-6) for name in known.shared}
        by_parameter.append(
            [
                (_slope(simulator, point, w, **{name: values[name] + step}) - at)
                * 1e6
                * np.sign(step)
                for name, step in steps.items()
            ]
        )
        by_output.append([_slope(simulator, point, w + unit) - at for unit in np.eye(len(w))])
    parameters = np.reshape(by_parameter, (len(points), len(known.shared), len(shooting.sizes)))
    outputs = np.array(by_output)
    # (points, n, nx) -> (points * nx, n)
    rows = np.nan_to_num((parameters / shooting.sizes).transpose(0, 2, 1))
    columns = np.nan_to_num((outputs / shooting.sizes).transpose(0, 2, 1))
    inverse = np.linalg.pinv(np.concatenate(rows), rcond=1e-3)
    inverse = inverse.reshape(len(known.shared), *rows.shape[:2]).transpose(1, 0, 2)
    return inverse @ columns / _TAKEN
