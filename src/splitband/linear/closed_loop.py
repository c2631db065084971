"""Find a plant that is unstable, and kept in its range by a controller.

The predictor x' = (A - K C) x + B u + K y of an innovations form is a stable system with the inputs
u and y, even if A is not (L. Ljung, System Identification, 2nd ed., Sec. 4.3). Its errors, those of
predictions one sample ahead, are independent of all past inputs and outputs, with a controller,
too. A long ARX model estimates its impulse responses, a singular value decomposition reduces these
to A - K C and C (M. Jansson, SSARX, 2003; A. Chiuso, Automatica 43, 2007), and `linear.refinement`
fits the parameters to the least prediction error.

A plant counts as unstable only if the record leaves no doubt: at the lower limit of its pole, too,
its state would have grown far over the record, had the inputs not moved it as much as they must to
prevent that; and they depend on the outputs as much as they must to know how.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from splitband.linear.kalman import MAX_OBSERVER_POLE, states
from splitband.linear.refinement import (
    MOST_SAMPLES,
    Signals,
    Solution,
    blocks_of,
    length,
    linear_solution,
    refined,
    windows,
)
from splitband.linear.subspace import Subspace, filled, stable
from splitband.linear.uncertainty import Matrices, Uncertainty, uncertainty_of
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.deadlines import current

_PAST = 40
"""Past samples of regressions. Bounds the time."""
_REGRESSORS = 200
"""Most past values in a regression. Bounds the time."""
_EACH = 8
"""Fewest samples for each of them. By eye."""
_MOST = 10
"""Largest order of the choice. Bounds the time."""
_EXACT = 1e-4
"""Smallest RMS error that counts, in standard deviations. Smaller ones are the curvature of a plant
without noise."""
_HELD = 100.0
"""Least growth of an unstable state over the record. See docs/developers/rules.md."""
_SURE = 3.0
"""Standard errors from a pole to its lower limit. See docs/developers/rules.md."""
_DOUBLING = 4
"""Fewest samples in which an unstable state doubles: a controller would be too slow for a faster
one, and inputs that are logged late look like it."""
_NEEDED = 0.5
"""Least effect of the inputs on the state, and least information that they have of the outputs, as
shares of what a controller needs. See docs/developers/rules.md."""
_ADEQUATE = 2.0
"""Largest error of a predictor, as a multiple of the error of the ARX model. By eye."""
_ITERATIONS = 12
"""Largest number of iterations of the refinement. Bounds the time."""


class Predictor(NamedTuple):
    """The predictor of a plant, and the records with the outputs as further inputs."""

    solution: Solution
    runs: Sequence[Signals]

    def matrices(self, step: Array | None = None) -> tuple[Array, Array, Array, Array, Array]:
        """Return A, B, C, D and K of the plant, after a step of the predictor's parameters."""
        a, b, c, d = self.solution.matrices(step)
        gain, d = b[:, -len(c) :], d[:, : -len(c)]
        return a + gain @ c, b[:, : -len(c)] + gain @ d, c, d, gain

    def uncertainty(self, longest: int) -> Uncertainty:
        """Return the standard errors of the plant."""

        def plant(step: Array | None) -> Matrices:
            return self.matrices(step)[:4]

        return uncertainty_of(self.solution, self.runs, plant, longest)


def with_outputs(runs: Sequence[Signals], instead: Sequence[Array] | None = None) -> list[Signals]:
    """Return records with outputs as further inputs, with `instead` (or a line) in gaps."""
    seen = [np.where(run.measured > 0, run.y, np.nan) for run in runs]
    instead = [np.apply_along_axis(filled, 1, y) for y in seen] if instead is None else instead
    return [
        run._replace(u=np.vstack([run.u, np.where(run.measured > 0, run.y, y)]))
        for run, y in zip(runs, instead, strict=True)
    ]


def unstable_predictor(
    runs: Sequence[Signals],
    direct: Sequence[bool],
    order: int | None = None,
    most: int | None = None,
) -> Predictor | None:
    """Return the predictor of an unstable plant in a closed loop; None for any other record.

    `direct`: whether an input has feedthrough; `most`: the largest order.
    """
    ny, both = len(runs[0].y), with_outputs(runs)
    some = [
        Signals(*(signal[:, begin:end] for signal in both[i]))
        for i, begin, end in windows(both, MOST_SAMPLES)
    ]
    longest = max(run.u.shape[1] for run in runs)
    if (space := _PredictorSubspace.of(some)) is None:
        return None
    largest = space.subspace.largest
    most = min(largest, _MOST if most is None else most)
    orders = range(1, most + 1) if order is None else [order] * (order <= largest)
    if not any(longest * np.log(space.largest_pole(n)) > np.log(_HELD) for n in orders):
        return None
    samples, starts = length(some), list[tuple[float, Solution]]()
    through = [*direct, *[False] * ny]
    for n in orders:
        a, c = space.subspace.matrices(n)
        at = linear_solution(blocks_of(stable(a), c, through), some)
        cost = 2 * samples * np.log(np.maximum(at.scale, _EXACT)).sum()
        starts.append((cost + n * (len(through) + ny) * np.log(samples), at))
        if current().over:
            return None
    at = refined(min(starts, key=lambda each: each[0])[1], some, _ITERATIONS, MAX_OBSERVER_POLE)
    if length(both) > samples:
        at = refined(linear_solution(at.blocks, both), both, _ITERATIONS, MAX_OBSERVER_POLE)
    found, adequate = Predictor(at, both), _ADEQUATE * np.maximum(space.scale, _EXACT)
    held = (at.scale < adequate).all() and _held(found, longest)
    return found if held and _informed(found, some) else None


def _held(found: Predictor, longest: int) -> bool:
    """Return whether the inputs certainly hold the state of the largest pole."""
    plant, effect, *_ = found.matrices()
    poles, vectors = np.linalg.eig(plant)
    size = abs(poles).max(initial=0.0)
    if not 1 < size <= 2 ** (1 / _DOUBLING):
        return False
    errors = found.uncertainty(longest)
    if not longest * np.log(size - _SURE * errors.pole_errors[0, 2]) > np.log(_HELD):
        return False
    mode, (a, b, *_) = np.linalg.inv(vectors)[np.argmax(abs(poles))], found.solution.matrices()
    kept, nu = found.solution.blocks.kept.ravel(), effect.shape[1]
    x = [
        states(a, run.u.T @ b.T, first.ravel()[kept]) @ mode
        for run, first in zip(found.runs, found.solution.first, strict=True)
    ]
    work = [run.u[:nu].T @ effect.T @ mode for run in found.runs]
    return bool(np.concatenate(work).std() > _NEEDED * (size - 1) * np.concatenate(x).std())


def _informed(found: Predictor, runs: Sequence[Signals]) -> bool:
    """Return whether the inputs have the information of the outputs that a controller needs.

    At each sample, that is at least the sum of the logarithms of the unstable poles (S. Tatikonda
    and S. Mitter, IEEE Trans. Autom. Control 49, 2004). In an open loop it is nothing.
    """
    ny, inputs = len(runs[0].y), len(runs[0].u)
    nu, past = inputs - ny, _past(runs, _EACH)
    rows = _lagged(runs, past)
    own, others = rows[:, 1:, :nu], rows[:, :, nu:]
    parts = [part.reshape(len(rows), -1) for part in (own, others, rows[:, :1, :nu])]
    data = np.hstack([np.ones((len(rows), 1)), *parts])
    r: Array = np.asarray(np.linalg.qr(data, mode="r"))
    alone, both = 1 + nu * past, 1 + nu * past + ny * (past + 1)
    left = [
        np.linalg.slogdet(r[k:, both:].T @ r[k:, both:] / (len(rows) - k))[1] for k in (alone, both)
    ]
    size = abs(np.linalg.eigvals(found.matrices()[0]))
    return bool(0.5 * (left[0] - left[1]) > _NEEDED * np.log(size[size > 1]).sum())


def _past(runs: Sequence[Signals], each: int) -> int:
    """Return the number of past samples in a regression with `each` samples for each value."""
    inputs = len(runs[0].u)
    return min(_PAST, _REGRESSORS // inputs, length(runs) // (each * inputs))


def _lagged(runs: Sequence[Signals], past: int) -> Array:
    """Return inputs and outputs from each sample back to `past` before it, without gaps.

    They are `(samples, past + 1, inputs)`, the latest ones first. Where gaps leave fewer than half
    of the samples, those are returned that follow a measured one: no interpolated value before them
    tells of them.
    """
    views = np.lib.stride_tricks.sliding_window_view
    long = [run for run in runs if run.u.shape[1] > past]
    known = [views(run.measured.all(axis=0), past + 1) for run in long]
    whole: list[Flags] = [np.asarray(each.all(axis=1)) for each in known]
    if 2 * sum(int(each.sum()) for each in whole) < sum(len(each) for each in whole):
        whole = [np.asarray((each[:, -2:] > 0).all(axis=1)) for each in known]
    rows = [
        views(run.u, past + 1, axis=1)[:, at, ::-1].transpose(1, 2, 0)
        for run, at in zip(long, whole, strict=True)
    ]
    return np.concatenate([np.zeros((0, past + 1, len(runs[0].u))), *rows])


class _PredictorSubspace(NamedTuple):
    """The range of the predictor's observability matrix.

    subspace : The range, by the responses of an ARX model.
    response : Of all future samples to the last outputs.
    scale : RMS errors of the ARX model, `(ny,)`.
    """

    subspace: Subspace
    response: Array
    scale: Array

    @classmethod
    def of(cls, runs: Sequence[Signals]) -> _PredictorSubspace | None:
        """Return the subspace, with the past of the best AIC; None for short records."""
        ny, inputs, past = len(runs[0].y), len(runs[0].u), _past(runs, _EACH)
        if past < 2 or len(rows := _lagged(runs, past)) < 2 * past * inputs:
            return None
        regressors, targets = rows[:, 1:].reshape(len(rows), -1), rows[:, 0, -ny:]
        data = np.hstack([regressors, targets])
        # As with noise: without any, many models predict exactly.
        noise = _EXACT * np.sqrt(len(rows)) * np.eye(data.shape[1])[:-ny]
        data = np.vstack([data - data.mean(axis=0), noise])
        r: Array = np.asarray(np.linalg.qr(data, mode="r"))
        # The first columns of the factor are those of a model with a shorter past.
        sizes = inputs * np.arange(2, past + 1)
        powers = [np.sum(r[size:, -ny:] ** 2, axis=0) / len(rows) + _EXACT**2 for size in sizes]
        criteria = len(rows) * np.log(powers).sum(axis=1) + 2 * ny * sizes
        size = int(sizes[np.argmin(criteria)])
        past = size // inputs
        of_past, left = r[:size, :size], r[size:, -ny:] / np.sqrt(len(rows))
        theta = scipy.linalg.solve_triangular(of_past, r[:size, -ny:]).reshape(past, inputs, ny)
        future = max(min(past, 2 * _MOST // ny + 2), 2)
        blocks = np.zeros((future, ny, past, inputs))
        for k in range(future):
            blocks[k, :, : past - k] = theta[k:].transpose(2, 0, 1)
        hankel = blocks.reshape(future * ny, -1)
        root = np.linalg.cholesky(left.T @ left + _EXACT**2 * np.eye(ny))
        white = np.kron(np.eye(future), np.linalg.inv(root))
        outer, values, _ = np.linalg.svd(white @ hankel @ of_past.T, full_matrices=False)
        vectors = np.kron(np.eye(future), root) @ outer
        scale = np.linalg.norm(left, axis=0) * np.sqrt(len(rows) / (len(rows) - size))
        return cls(Subspace(vectors, values, ny), hankel[:, inputs - ny : inputs], scale)

    def largest_pole(self, order: int) -> float:
        """Return the largest absolute value of a pole of the plant of this order."""
        a, c = self.subspace.matrices(order)
        gain = np.linalg.lstsq(self.subspace.vectors[:, :order], self.response, rcond=None)[0]
        return float(abs(np.linalg.eigvals(a + gain @ c)).max(initial=1e-300))
