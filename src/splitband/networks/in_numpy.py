"""Turn cells of torch into those of `networks.plain`; a user's own cell is called through torch."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from splitband.networks.cell import Cell, are_plain
from splitband.networks.layers import Tensor, nn, torch
from splitband.networks.plain import Dense, PlainEulerMLP, PlainGRU, PlainStateSpace
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError


def in_numpy(cell: Cell) -> PlainGRU | PlainEulerMLP | PlainStateSpace | TorchCell:
    """Return a cell in NumPy; a user's own is called through torch, and cannot be exported."""
    # A subclass may step differently. Therefore only the class that declares it is trusted.
    plain = cell.in_numpy() if "in_numpy" in vars(type(cell)) else None  # type: ignore[attr-defined]
    return TorchCell(cell) if plain is None else plain


class TorchCell:
    """Call a user's own cell through torch."""

    size, fewest_steps = 0, math.inf

    def __init__(self, cell: Cell) -> None:
        self.cell = cell
        weight = next(cell.parameters(), None)  # type: ignore[attr-defined]
        self.like = torch.zeros((), dtype=torch.float64) if weight is None else weight.detach()

    def initial_state(self, y: Array, u: Array) -> Any:
        """Return the state after a warm-up."""
        with torch.no_grad():
            return self.cell.initial_state(self._tensor(y), self._inputs(u))

    def step(self, h: Any, y: Array, u: Array) -> Any:
        """Return the state one sample later."""
        with torch.no_grad():
            return self.cell.step(h, self._tensor(y), self._inputs(u))

    def observe(self, h: Any) -> Array:
        """Return the outputs `(ny,)` of a state."""
        with torch.no_grad():
            return self.cell.observe(h)[0].double().cpu().numpy()

    def _tensor(self, x: Array) -> Tensor:
        try:
            values = np.array(x)
        except TypeError:  # a symbol, as an export is made
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
    return np.asarray(tensor.detach().double().cpu().numpy(), np.float64)


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
