"""Define the cells in NumPy, without a batch and without torch, for steps and for export.

Each has the methods of `networks.Cell`, for `y` `(time, ny)` or `(ny,)` and `u` `(time, nu)` or
`(nu,)`; without inputs `u` has no columns. A warm-up of at least `fewest_steps` steps can go on by
single steps; `size` is that of the state. The code can be traced, see `runtime.tracing`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.tracing import scan

Dense = tuple[tuple[Array, Array], ...]
"""Weights and biases of linear layers, followed by tanh unless stated otherwise."""


class PlainGRU(NamedTuple):
    """Weights and biases of a `GRU`, gates in torch's order: reset, update, new."""

    of_input: tuple[Array, Array]
    of_state: tuple[Array, Array]
    observation: tuple[Array, Array]

    @property
    def size(self) -> int:
        return int(self.of_state[0].shape[1])

    @property
    def fewest_steps(self) -> float:
        return 1

    def initial_state(self, y: Array, u: Array) -> Array:
        return _observed(self, np.zeros(self.of_state[0].shape[1]), y, u)

    def step(self, h: Array, y: Array, u: Array) -> Array:
        n = self.of_state[0].shape[1]
        of_input = self.of_input[0] @ np.concatenate([y, u]) + self.of_input[1]
        of_state = self.of_state[0] @ h + self.of_state[1]
        gates = scipy.special.expit(of_input[: 2 * n] + of_state[: 2 * n])
        new = np.tanh(of_input[2 * n :] + gates[:n] * of_state[2 * n :])
        return new + gates[n:] * (h - new)

    def observe(self, h: Array) -> Array:
        return self.observation[0] @ h + self.observation[1]


class PlainEulerMLP(NamedTuple):
    """The weights of an `EulerMLP`; the last layer of the dynamics has no tanh."""

    dynamics: Dense
    recognition: Dense
    ny: int
    warmup: int
    step_size: float

    @property
    def size(self) -> int:
        return len(self.recognition[-1][1])

    @property
    def fewest_steps(self) -> float:
        return math.inf

    def initial_state(self, y: Array, u: Array) -> Array:
        samples = np.concatenate([y, u], axis=1)[len(y) - self.warmup :]
        return _dense(self.recognition, samples.reshape(-1))

    def step(self, h: Array, y: Array, u: Array) -> Array:
        *hidden, (weight, bias) = self.dynamics
        inner = _dense(tuple(hidden), np.concatenate([h, u]))
        return h + self.step_size * (weight @ inner + bias)

    def observe(self, h: Array) -> Array:
        return h[: self.ny]


class PlainStateSpace(NamedTuple):
    """The weights of a `StateSpace`."""

    f: Dense
    g: Dense
    transition: tuple[Array, Array]
    observation: tuple[Array, Array]
    gain: Array
    first: tuple[Array, Array]
    encoded: int

    @property
    def size(self) -> int:
        return len(self.gain) + len(self.observation[1])

    @property
    def fewest_steps(self) -> float:
        return max(self.encoded, 1)

    def initial_state(self, y: Array, u: Array) -> Array:
        weight, x = self.first
        if self.encoded:
            samples = np.concatenate([y[: self.encoded], u[: self.encoded]], axis=1)
            x = weight @ samples.reshape(-1) + x
        return _observed(self, self._with_output(x, u[0]), y, u)

    def step(self, h: Array, y: Array, u: Array) -> Array:
        n = len(self.gain)
        moved = _mixed(self.f, self.transition, np.concatenate([h[:n], u]))
        return self._with_output(moved + self.gain @ (y - h[n:]), u)

    def observe(self, h: Array) -> Array:
        return h[len(self.gain) :]

    def _with_output(self, x: Array, u: Array) -> Array:
        return np.concatenate([x, _mixed(self.g, self.observation, np.concatenate([x, u]))])


def _observed(cell: Any, h: Any, y: Array, u: Array) -> Any:
    """Return the state after steps over measured samples."""
    return scan(lambda h, row: (cell.step(h, *row), None), h, [y, u])[0]


def _dense(layers: Dense, x: Array) -> Array:
    for weight, bias in layers:
        x = np.tanh(weight @ x + bias)
    return x


def _mixed(layers: Dense, out: tuple[Array, Array], x: Array) -> Array:
    """Return a linear map of x and of the outputs of tanh units on x."""
    weight, bias = out
    return weight @ (np.concatenate([x, _dense(layers, x)]) if layers else x) + bias
