"""Define the interface of recurrent cells: state transition and observation (paper, Eq. 8).

Any `nn.Module` with these three methods works wherever a `GRU` does. State is passed and
returned, never kept on the module.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

from torch import Tensor, nn

from splitband.runtime.arguments import LARGEST_SIZE, whole


@runtime_checkable
class Cell(Protocol):
    """Define the methods that a rollout calls on a recurrent network.

    Attributes
    ----------
    ny, nu : Number of measured channels and of known inputs.
    """

    ny: int
    nu: int

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Any:
        """Return the state h_R after `y_warmup` `(batch, R, ny)` and `u` `(batch, R, nu)`."""

    def step(self, h: Any, y: Tensor, u: Tensor | None = None) -> Any:
        """Return h_{n+1} = f(h_n, y_n, u_n) for `y` `(batch, ny)` and `u` `(batch, nu)`."""

    def observe(self, h: Any) -> Tensor:
        """Return y_n = C h_n, shape `(batch, ny)`."""


def are_plain(*modules: tuple[nn.Module, type[nn.Module]]) -> bool:
    """Return whether each module has exactly its type, its biases, and no hooks."""
    return all(
        type(module) is kind
        and getattr(module, "bias", True) is not None
        and getattr(module, "bias", True) is not False
        and not module._forward_hooks
        and not module._forward_pre_hooks
        for module, kind in modules
    )


def check_sizes(nu: int, **sizes: int) -> tuple[int, ...]:
    """Return the sizes of a network, `nu` first; raises ValueError for what cannot be one."""
    inputs = whole("nu", nu, 0, LARGEST_SIZE)
    return inputs, *(whole(name, size, 1, LARGEST_SIZE) for name, size in sizes.items())
