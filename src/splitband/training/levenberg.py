"""Finish a training by Levenberg-Marquardt on windows laid end to end, all of them in every step.

Not in the paper. For a network with few weights and a kernel for their derivatives, a step takes
the time of about ten iterations of L-BFGS, and near a minimum it is worth hundreds (Nocedal and
Wright, Numerical Optimization, 2006, Sec. 10.3). Without known inputs noise is most of what drives
a network, and iterations of both are worth the same. All weights have the same damping: with one by
their curvature, tanh units that do little yet would move far. It follows how well the quadratic
model has told the decrease of the error (Nielsen, Damping Parameter in Marquardt's Method, 1999).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, cast

import numpy as np
import scipy
import torch
from torch import Tensor

from splitband.models import Signals, Task
from splitband.networks import Cell
from splitband.networks.cell import Penalised
from splitband.networks.rollout import jacobians
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import Deadline
from splitband.training.lbfgs import CONVERGED
from splitband.training.windows import select

STEPS = 2
"""Steps of a round, for the time of a round of L-BFGS."""
ENOUGH = 1.5
"""Fewest samples for each weight, of all outputs. With fewer, the minimum over the training samples
may be far from the best model, and so near to the start that little else is seen on the way."""
FEWEST = 500
"""Fewest samples to train on, of all outputs. Between records on which it was better than
L-BFGS (562 samples) and on which it was worse (225 to 400)."""
MOST_WEIGHTS = 1000
"""Most weights of a network. Bounds the time and the memory of a step."""
_FIRST, _MOST = 1e-3, 1e9
"""Damping at the beginning, and where a step is given up, in multiples of the largest curvature."""
_LESS = 0.2
"""Factor on the damping after a step whose decrease was as expected."""


class Windows(NamedTuple):
    """Hold windows to train on: known signals, targets, and which of them were measured."""

    known: Signals
    target: Tensor
    measured: Tensor | None

    def double(self) -> Windows:
        """Return the windows in float64."""
        return Windows(self.known.map(Tensor.double), self.target.double(), self.measured)


class _Point(NamedTuple):
    """Hold the mean square at some weights, with half its gradient and half its curvature."""

    mean_square: float
    gradient: Array
    curvature: Array


class _OverError(Exception):
    """The deadline has passed in the middle of a step."""


def suits(task: Task, windows: Windows) -> bool:
    """Return whether the task's network has a kernel, and enough samples for its weights."""
    weights = sum(p.numel() for p in task.network.parameters())
    given = task.target.numel()
    samples = min(_count(windows), given)  # windows may overlap
    few = weights <= min(MOST_WEIGHTS, samples // ENOUGH)
    return few and given >= FEWEST and _slopes(task, windows) is not None


def _slopes(task: Task, windows: Windows) -> Iterator[Array] | None:
    """Return the derivatives of the network's free run by its weights, window by window."""
    run = task.run(windows.known, windows.target.shape[1])
    return jacobians(cast("Cell", task.network), *run)


def _count(windows: Windows) -> int:
    """Return the number of values that count."""
    return windows.target.numel() if windows.measured is None else int(windows.measured.sum())


class Levenberg:
    """Train by Levenberg-Marquardt, round by round; `settled` and `cut` are those of `Lbfgs`.

    The objective is the mean squared error of all windows plus the penalty `l2`. The network and
    the windows are in float64. At the `deadline` a round ends with the best weights so far.
    """

    def __init__(self, task: Task, windows: Windows, l2: float, deadline: Deadline) -> None:
        self._task, self._windows, self._deadline = task, windows, deadline
        self._parameters = [*task.network.parameters()]
        self._penalty = l2 * self._penalised()
        self._damping = _FIRST
        self._point: _Point | None = None
        self.settled = self._stuck = self.cut = False

    def round(self) -> float:
        """Take `STEPS` steps; return the RMS error after them.

        The second round in a row without progress (see `CONVERGED`) is the last one.
        """
        began = reached = self._mean_square(self._weights())
        try:
            for _ in range(STEPS):
                self._point = self._point or self._differentiated()
                reached = self._step(self._point)
        except _OverError:
            self.cut = True
            return float(self._mean_square(self._weights()) ** 0.5)
        slow = not reached < (1 - CONVERGED) * began
        self.settled, self._stuck = slow and self._stuck, slow
        return float(reached**0.5)

    def _step(self, point: _Point) -> float:
        """Go to the first damped minimum of the quadratic model that lowers the mean square."""
        if not np.isfinite(point.curvature).all():  # a state has grown without bound
            return point.mean_square
        weights, growth = self._weights(), 2.0
        unit = float(point.curvature.diagonal().max()) or 1.0
        while self._damping < _MOST:
            damped = point.curvature + self._damping * unit * np.eye(len(weights))
            try:
                move = -scipy.linalg.solve(damped, point.gradient, assume_a="pos")
            except np.linalg.LinAlgError:  # rounding
                move = np.zeros_like(weights)
            expected = -float(move @ (2 * point.gradient + point.curvature @ move))
            reached = self._mean_square(weights + move)
            if reached < point.mean_square:
                ratio = (point.mean_square - reached) / expected
                self._damping *= max(_LESS, 1 - (2 * ratio - 1) ** 3)
                self._put(weights + move)
                self._point = None
                return reached
            self._damping *= growth
            growth *= 2
            self._check_time()
        self._damping = _FIRST
        return point.mean_square

    def _differentiated(self) -> _Point:
        """Return the mean square, its gradient and its curvature by Gauss and Newton."""
        task, (known, target, measured) = self._task, self._windows
        steps, weights = target.shape[1], self._weights()
        errors = self._errors()
        curvature, gradient = np.zeros((len(weights), len(weights))), np.zeros(len(weights))
        with torch.no_grad(), np.errstate(over="ignore", invalid="ignore"):
            slopes = _slopes(task, self._windows)
            assert slopes is not None
            for i, free in enumerate(slopes):
                self._check_time()
                window = select(known, torch.tensor([i]))
                of_weights = torch.from_numpy(free).permute(2, 0, 1)
                seen = task.tangent(of_weights, window, steps).permute(1, 2, 0)
                rows = seen.reshape(-1, len(weights)).numpy()
                if measured is not None:
                    rows = rows * measured[i].reshape(-1, 1).numpy()
                curvature += rows.T @ rows
                gradient += errors[i].ravel() @ rows
        count = _count(self._windows)
        mean_square = self._of(errors, weights)
        return _Point(
            mean_square,
            gradient / count + self._penalty * weights,
            curvature / count + np.diag(self._penalty),
        )

    def _errors(self) -> Array:
        """Return the error of each predicted value, 0 where it was not measured."""
        known, target, measured = self._windows
        with torch.no_grad():
            errors = self._task.simulate(known, target.shape[1]) - target
        return (errors if measured is None else errors * measured).numpy()

    def _mean_square(self, weights: Array) -> float:
        """Return the objective at some weights."""
        before = self._weights()
        self._put(weights)
        found = self._of(self._errors(), weights)
        self._put(before)
        return found

    def _of(self, errors: Array, weights: Array) -> float:
        """Return the objective for some errors, infinite where a state has grown without bound."""
        with np.errstate(over="ignore", invalid="ignore"):
            square = float(np.square(errors).sum()) / _count(self._windows)
        found = square + float(self._penalty @ np.square(weights))
        return found if np.isfinite(found) else np.inf

    def _penalised(self) -> Array:
        """Return 1 for each weight with a penalty, 0 for the others."""
        network = self._task.network
        some = network.penalised() if isinstance(network, Penalised) else [*network.parameters()]
        total = torch.stack([weight.sum() for weight in some]).sum()
        found = torch.autograd.grad(total, self._parameters, materialize_grads=True)
        return torch.cat([each.flatten() for each in found]).double().numpy()

    def _weights(self) -> Array:
        return torch.cat([p.detach().flatten() for p in self._parameters]).numpy()

    def _put(self, weights: Array) -> None:
        parts = torch.from_numpy(weights).split([p.numel() for p in self._parameters])
        with torch.no_grad():
            for p, part in zip(self._parameters, parts, strict=True):
                p.copy_(part.view_as(p))

    def _check_time(self) -> None:
        if self._deadline.over:
            raise _OverError
