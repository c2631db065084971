"""Start a network's training from the linear model of its record.

The training then need not find the linear dynamics: from random weights it may take as long for
them as for everything else, or never find them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from splitband import models
from splitband.linear.identification import identified, unstable
from splitband.linear.model import Realisation, realised
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.threads import one_thread

if TYPE_CHECKING:
    from splitband.models import Model


_WINDOWS = 20_000
"""Windows of long records from which states are estimated, at even distances. Bounds the memory."""
_RIDGE = 1e-6
"""Ridge penalty of the state estimator, as a share of the regressors' mean square. Rounding."""


@runtime_checkable
class LinearPart(Protocol):
    """Describe a cell with a linear part that can be set, such as `StateSpace`."""

    ny: int
    nu: int
    states: int
    encoded: int

    def begin_linear(self, model: Realisation, first: tuple[Array, Array] | None) -> None:
        """Set the linear part to a model; `first` maps the `encoded` samples to its first state."""

    def growth(self) -> float:
        """Return the factor by which an error of a simulation grows, see `FitReport`."""


def reach_of(record: Record, others: Sequence[Record] = ()) -> int | None:
    """Return how far forecasts of an unstable plant are worth making; None for others."""
    seen = [(each.y_with_gaps, each.u) for each in (record, *others) if each.u is not None]
    if len({(y.shape[1], u.shape[1]) for y, u in seen}) != 1:
        return None
    with one_thread():
        found = unstable(seen)
    return None if found is None else found.reach


def begin_as_linear(model: Model, records: Sequence[Record], normalize: bool, seed: int) -> None:
    """Set the linear parts of a model's networks to linear models, in place.

    They then simulate like `linear.model`, with at most as many poles as they have states; the
    `seed` is for states beyond these. Networks without a linear part, of a down-sampled band, or of
    records without inputs do not change. `records` have delayed inputs and the base's output.
    """
    linear = any(isinstance(part, LinearPart) for part in model.modules())
    if not (model.feedthrough and linear):
        return
    model.adapt_to(records, normalize)
    seen = [model.normalised(record) for record in records]
    for tasks in zip(*map(model.tasks, seen), strict=True):
        cell = tasks[0].network
        if not isinstance(cell, LinearPart) or tasks[0].stride != 1:
            continue
        inputs = [each.u.double() for each in seen if each.u is not None]
        rows = [models.with_next_input(u).numpy() for u in inputs]
        plain = [u.numpy() for u in inputs]
        targets = [
            np.where(np.isnan(record.y_with_gaps), np.nan, task.target.double().numpy())
            for record, task in zip(records, tasks, strict=True)
        ]
        _set(cell, targets, plain, rows, seed)


def _set(
    cell: LinearPart,
    targets: Sequence[Array],
    inputs: Sequence[Array],
    rows: Sequence[Array],
    seed: int,
) -> None:
    """Set the linear part of one network, which predicts `targets`."""
    delay = np.zeros((targets[0].shape[1], inputs[0].shape[1]), int)
    with one_thread():
        seen = [*zip(targets, inputs, strict=True)]
        linear = identified(seen, delay=delay, most=cell.states)
    found = realised(linear, seen, cell.states, np.random.default_rng(seed))
    nu = inputs[0].shape[1]
    # A row of the network's inputs is [u of this sample, u of the next one, other inputs].
    b, d = np.zeros((cell.states, cell.nu)), np.zeros((cell.ny, cell.nu))
    b[:, :nu], d[:, nu : 2 * nu] = found.b, found.d
    first = None
    if cell.encoded:
        runs = [*zip(targets, rows, strict=True)]
        weight, bias = state_estimator(runs, found.states, cell.encoded)
        told = np.zeros((cell.states, cell.encoded, cell.ny + cell.nu))
        told[:, :, : cell.ny + 2 * nu] = weight.reshape(cell.states, cell.encoded, -1)
        first = told.reshape(cell.states, -1), bias
    cell.begin_linear(found._replace(b=b, d=d), first)


def state_estimator(
    runs: Sequence[tuple[Array, Array]], states: Sequence[Array], samples: int
) -> tuple[Array, Array]:
    """Fit a linear map from windows of some samples of y and u to the states at their beginning.

    Returns matrix and constant, by ridge regression over the windows without gaps. `runs` are y and
    the network's inputs in each record; in a window they are ordered sample by sample, y first.
    """
    seen, wanted = [], []
    thin = max(sum(len(y) for y, _ in runs) // _WINDOWS, 1)
    for (y, u), x in zip(runs, states, strict=True):
        if len(y) >= samples:
            both = np.hstack([y, u])
            views = np.lib.stride_tricks.sliding_window_view(both, samples, axis=0)[::thin]
            seen.append(views.transpose(0, 2, 1).reshape(len(views), -1))
            wanted.append(x[: len(views) * thin : thin])
    rows, target = np.concatenate(seen), np.concatenate(wanted)
    whole = ~np.isnan(rows).any(axis=1)
    rows, target = rows[whole], target[whole]
    if not len(rows):
        width = samples * (runs[0][0].shape[1] + runs[0][1].shape[1])
        return np.zeros((states[0].shape[1], width)), np.zeros(states[0].shape[1])
    middle, mean = rows.mean(axis=0), target.mean(axis=0)
    rows, target = rows - middle, target - mean
    square = rows.T @ rows
    square += _RIDGE * np.trace(square) / len(square) * np.eye(len(square))
    weight = np.linalg.solve(square, rows.T @ target).T
    return weight, mean - weight @ middle
