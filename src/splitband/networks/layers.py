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
    from torch import Tensor, nn
else:

    class _Weight:
        """An array. Until a saved one is its `data`, it takes no memory."""

        def __init__(self, *shape: int, dtype: Any = np.float32) -> None:
            self.data = np.broadcast_to(np.zeros((), dtype), shape)

        shape = property(lambda self: self.data.shape)
        dtype = property(lambda self: self.data.dtype)

        def detach(self) -> _Weight:
            return self

        cpu = double = detach

        def numpy(self) -> Any:
            return self.data

    class _Module:
        """Weights and further modules, by the names of attributes."""

        _forward_hooks = _forward_pre_hooks = ()

        def __call__(self, *_: Any) -> Any:
            require_torch("a call of a layer")

        def register_buffer(self, name: str, value: _Weight) -> None:
            setattr(self, name, value)

        def children(self) -> Iterator[_Module]:
            return (each for each in vars(self).values() if isinstance(each, _Module))

        def named_parameters(self, recurse: bool = True) -> Iterator[tuple[str, _Weight]]:
            for name, each in vars(self).items():
                if isinstance(each, _Weight):
                    yield name, each
                elif recurse and isinstance(each, _Module):
                    yield from ((f"{name}.{of}", x) for of, x in each.named_parameters())

        def state_dict(self, keep_vars: bool = True) -> dict[str, _Weight]:
            return dict(self.named_parameters())

        def to(self, *_: Any) -> _Module:
            return self

        eval = to

    class _Linear(_Module):
        def __init__(self, inputs: int, outputs: int) -> None:
            self.weight, self.bias = _Weight(outputs, inputs), _Weight(outputs)

    class _GRUCell(_Module):
        def __init__(self, inputs: int, size: int) -> None:
            self.weight_ih, self.weight_hh = _Weight(3 * size, inputs), _Weight(3 * size, size)
            self.bias_ih, self.bias_hh = _Weight(3 * size), _Weight(3 * size)

    class _Tanh(_Module):
        pass

    class _Sequential(_Module):
        def __init__(self, *layers: _Module) -> None:
            vars(self).update({str(i): each for i, each in enumerate(layers)})

        def __len__(self) -> int:
            return len(vars(self))

        def __getitem__(self, i: int) -> _Module:
            return [*self.children()][i]

    class nn:  # noqa: D101, N801
        Module, Linear, Tanh, GRUCell, Sequential = _Module, _Linear, _Tanh, _GRUCell, _Sequential
        ModuleList = staticmethod(lambda modules: _Sequential(*modules))
        Parameter = staticmethod(lambda weight: weight)

    class _Torch:
        """What building and loading a model uses of torch."""

        float32, float64 = np.dtype(np.float32), np.dtype(np.float64)
        empty = zeros = ones = _Weight
        as_tensor = staticmethod(np.asarray)
        device = staticmethod(nullcontext)
        is_floating_point = staticmethod(lambda weight: True)

        def __getattr__(self, name: str) -> Any:
            require_torch(f"torch.{name} of a network")

    Tensor, torch = _Weight, _Torch()

__all__ = ["Tensor", "nn", "torch"]
