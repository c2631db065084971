"""Provide torch or, where it is not installed, layers that hold weights and compute nothing.

A saved network needs no more: its cells are built of these layers, whose weights have the names and
shapes that torch gives them, and run in NumPy (`networks.plain`). Whatever else is used of torch
raises the error that says how to install it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np

from splitband.runtime.optional import has_torch, require_torch

if TYPE_CHECKING or has_torch():
    import torch
    from torch import nn
else:

    class Weight:
        """An array; until a saved one is its `data`, it takes no memory."""

        def __init__(self, *shape: int, dtype: Any = np.float32) -> None:
            self.data = np.broadcast_to(np.zeros((), dtype), shape)

        shape = property(lambda self: self.data.shape)
        dtype = property(lambda self: self.data.dtype)

        def detach(self) -> Weight:
            """Return itself, as there are no gradients."""
            return self

        cpu = detach

        def double(self) -> Weight:
            """Return it in double precision."""
            new = Weight()
            new.data = self.data.astype(np.float64)
            return new

        def numpy(self) -> Any:
            """Return the array."""
            return self.data

    class Module:
        """Weights and further modules, by the names of attributes."""

        _forward_hooks = _forward_pre_hooks = ()

        def __call__(self, *_: Any) -> Any:
            require_torch("calling a layer")

        def register_buffer(self, name: str, value: Weight) -> None:
            """Keep an array that is not trained."""
            setattr(self, name, value)

        def children(self) -> Iterator[Module]:
            """Yield the modules among its attributes."""
            return (each for each in vars(self).values() if isinstance(each, Module))

        def named_parameters(self, recurse: bool = True) -> Iterator[tuple[str, Weight]]:
            """Yield the weights by their full names."""
            for name, each in vars(self).items():
                if isinstance(each, Weight):
                    yield name, each
                elif recurse and isinstance(each, Module):
                    yield from ((f"{name}.{of}", x) for of, x in each.named_parameters())

        def state_dict(self, keep_vars: bool = True) -> dict[str, Weight]:
            """Return the weights by their full names."""
            return dict(self.named_parameters())

        def to(self, *_: Any) -> Module:
            """Return itself: there is one device."""
            return self

        def eval(self) -> Module:
            """Return itself."""
            return self

    class Linear(Module):
        """Weight and bias."""

        def __init__(self, inputs: int, outputs: int) -> None:
            self.weight, self.bias = Weight(outputs, inputs), Weight(outputs)

    class GRUCell(Module):
        """Weights and biases of three gates."""

        def __init__(self, inputs: int, size: int) -> None:
            self.weight_ih, self.weight_hh = Weight(3 * size, inputs), Weight(3 * size, size)
            self.bias_ih, self.bias_hh = Weight(3 * size), Weight(3 * size)

    class Tanh(Module):
        """No weights."""

    class Sequential(Module):
        """Layers in a row, by their number."""

        def __init__(self, *layers: Module) -> None:
            vars(self).update({str(i): each for i, each in enumerate(layers)})

        def __len__(self) -> int:
            return len(vars(self))

    class ModuleList(Sequential):
        """Modules by their number."""

        def __init__(self, modules: list[Module]) -> None:
            super().__init__(*modules)

        def __getitem__(self, i: int) -> Module:
            return [*self.children()][i]

        def __iter__(self) -> Iterator[Module]:
            return self.children()

    class nn:  # noqa: N801  as torch calls it
        """The layers of the package's cells and models."""

        Module, Linear, Tanh, GRUCell = Module, Linear, Tanh, GRUCell
        Sequential, ModuleList = Sequential, ModuleList
        Parameter = staticmethod(lambda weight: weight)

    class _Torch:
        """What building and loading a model uses of torch."""

        float32, float64 = np.dtype(np.float32), np.dtype(np.float64)
        empty = zeros = ones = Weight
        as_tensor = staticmethod(np.asarray)

        def device(self, name: str) -> Any:
            """Return a context: weights take no memory in any."""
            return nullcontext()

        def is_floating_point(self, weight: Weight) -> bool:
            """Return that it is: no weight of the package is whole."""
            return True

        def __getattr__(self, name: str) -> Any:
            require_torch(f"a network's torch.{name}")

    torch = _Torch()

__all__ = ["nn", "torch"]
