"""Define the cells in NumPy, without a batch, for runs step by step and for export.

The classes have the methods of `networks.Cell`, for `y` `(time, ny)` or `(ny,)` and `u` `(time,
nu)` or `(nu,)`; without inputs `u` has no columns. `paused_state` is the state before the last step
of `initial_state`, whose inputs are missing. The code can be traced, see `runtime.tracing`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy
import torch
from torch import Tensor, nn

from splitband.networks.cell import Cell, are_plain
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import scan

Dense = tuple[tuple[Array, Array], ...]
"""Weights and biases of linear layers, followed by tanh unless stated otherwise."""


def in_numpy(cell: Cell) -> PlainGRU | PlainEulerMLP | PlainStateSpace | TorchCell:
    """Return a cell in NumPy; a user's own is called through torch, and cannot be exported."""
    # A subclass may step differently: it has to declare `in_numpy` itself.
    plain = cell.in_numpy() if "in_numpy" in vars(type(cell)) else None  # type: ignore[attr-defined]
    return TorchCell(cell) if plain is None else plain


class PlainGRU(NamedTuple):
    """Weights and biases of a `GRU`, gates in torch's order: reset, update, new."""

    of_input: tuple[Array, Array]
    of_state: tuple[Array, Array]
    observation: tuple[Array, Array]

    def initial_state(self, y: Array, u: Array) -> Array:
        return _observed(self, np.zeros(self.of_state[0].shape[1]), y, u)

    def paused_state(self, y: Array, u: Array) -> Array:
        return self.initial_state(y[:-1], u)

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

    def initial_state(self, y: Array, u: Array) -> Array:
        samples = np.concatenate([y, u], axis=1)[len(y) - self.warmup :]
        return _dense(self.recognition, samples.reshape(-1))

    def paused_state(self, y: Array, u: Array) -> Array:
        raise InputError(
            "an EulerMLP cannot be a CasADi function: it begins with all inputs of its warm-up at "
            "once, that of the sample to predict included; GRU and StateSpace can"
        )

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

    def initial_state(self, y: Array, u: Array) -> Array:
        weight, x = self.first
        if self.encoded:
            samples = np.concatenate([y[: self.encoded], u[: self.encoded]], axis=1)
            x = weight @ samples.reshape(-1) + x
        return _observed(self, self._with_output(x, u[0]), y, u)

    def paused_state(self, y: Array, u: Array) -> Array:
        if len(u) < max(self.encoded, 1):
            raise InputError(
                f"a StateSpace needs a warm-up of more than {max(self.encoded, 1)} samples to be a "
                f"CasADi function, got {len(y)}"
            )
        return self.initial_state(y[:-1], u)

    def step(self, h: Array, y: Array, u: Array) -> Array:
        n = len(self.gain)
        moved = _mixed(self.f, self.transition, np.concatenate([h[:n], u]))
        return self._with_output(moved + self.gain @ (y - h[n:]), u)

    def observe(self, h: Array) -> Array:
        return h[len(self.gain) :]

    def _with_output(self, x: Array, u: Array) -> Array:
        return np.concatenate([x, _mixed(self.g, self.observation, np.concatenate([x, u]))])


class TorchCell:
    """A user's own cell, called through torch."""

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        weight = next(cell.parameters(), None)  # type: ignore[attr-defined]
        self.like = torch.zeros((), dtype=torch.float64) if weight is None else weight.detach()

    def initial_state(self, y: Array, u: Array) -> Any:
        with torch.no_grad():
            return self.cell.initial_state(self._tensor(y), self._inputs(u))

    def paused_state(self, y: Array, u: Array) -> Any:
        raise self._unwritten()

    def step(self, h: Any, y: Array, u: Array) -> Any:
        with torch.no_grad():
            return self.cell.step(h, self._tensor(y), self._inputs(u))

    def observe(self, h: Any) -> Array:
        with torch.no_grad():
            return self.cell.observe(h)[0].double().cpu().numpy()

    def _tensor(self, x: Array) -> Tensor:
        try:
            values = np.array(x)
        except TypeError:  # a symbol of an export
            raise self._unwritten() from None
        return torch.from_numpy(values).to(self.like)[None]

    def _unwritten(self) -> InputError:
        return InputError(
            f"the cell {type(self.cell).__name__} cannot be exported, as it is Python code of "
            "your own; GRU, EulerMLP and StateSpace can"
        )

    def _inputs(self, u: Array) -> Tensor | None:
        return self._tensor(u) if self.cell.nu else None


def values(tensor: Tensor) -> Array:
    """Return a tensor as an array in double precision."""
    return tensor.detach().double().cpu().numpy()


def linear(layer: nn.Linear) -> tuple[Array, Array]:
    """Return weight and bias of a layer."""
    return values(layer.weight), values(layer.bias)


def dense(layers: nn.Sequential) -> Dense | None:
    """Return the linear layers among alternating linear and tanh layers; None for other layers."""
    kinds = (nn.Linear, nn.Tanh)
    pairs = [(layer, kinds[i % 2]) for i, layer in enumerate(layers.children())]
    if not are_plain((layers, nn.Sequential), *pairs):
        return None
    return tuple(linear(layer) for layer in layers.children() if isinstance(layer, nn.Linear))


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
