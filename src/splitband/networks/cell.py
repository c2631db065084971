"""Define the interface of recurrent cells (Ensinger et al. 2023, Eq. 7, recurrent model).

Any `nn.Module` with the methods of `Cell` and `Template` works wherever a `GRU` does. State is
passed and returned, never kept on the module. The cells of this package have further, optional
members: `label` and `words` (names in tables and sentences), `variants` and `size_in_words`
(sizes that a search may try), `stable`, `penalised`, `in_numpy` (streams and exports), and compiled
kernels: `fusable`, `fused_rollout`, and `fused_jacobian`, with which it is trained by
Levenberg-Marquardt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from splitband.runtime.arguments import LARGEST_SIZE, whole

if TYPE_CHECKING:
    from torch import Tensor, nn


@runtime_checkable
class Cell(Protocol):
    """A recurrent network, as a rollout calls it.

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


@runtime_checkable
class Template(Protocol):
    """A template, such as a cell, for new cells of given sizes."""

    def sized(self, ny: int, nu: int, warmup: int) -> Cell:
        """Return a new cell, with weights drawn by torch's generator.

        It has `ny` channels and `nu` inputs; `warmup` measured samples set the initial state.
        """


@runtime_checkable
class WithSize(Protocol):
    """A cell with a size for tables."""

    def size_in_words(self) -> str:
        """Return the size, such as "64 units"."""


@runtime_checkable
class Penalised(Protocol):
    """A network with a penalty on some of its weights only."""

    def penalised(self) -> Sequence[Tensor]:
        """Return the penalised weights."""


def as_template(cell: Any) -> Template:
    """Return the cell as a template; raises TypeError without `sized`."""
    if isinstance(cell, type):
        raise TypeError(
            f"a cell must be an object, such as {cell.__name__}(...), got the class {cell.__name__}"
        )
    if not isinstance(cell, Template):
        raise TypeError(
            f"a cell must have a method sized(ny, nu, warmup) that makes one of these sizes, got "
            f"{type(cell).__name__}"
        )
    return cell


def words_of(template: Template) -> str:
    """Return the name of a cell in sentences: its `words`, or its class."""
    return str(getattr(template, "words", type(template).__name__))


def label_of(template: Template) -> str:
    """Return the name of a cell in method names and tables: its `label`, or its class."""
    return str(getattr(template, "label", type(template).__name__.lower()))


def are_plain(*modules: tuple[nn.Module, type[nn.Module]]) -> bool:
    """Return whether all modules have exactly the given types, biases, and no hooks."""
    return all(
        type(module) is kind
        and _biased([name for name, _ in module.named_parameters(recurse=False)])
        and not module._forward_hooks
        and not module._forward_pre_hooks
        for module, kind in modules
    )


def _biased(names: Sequence[str]) -> bool:
    """Return whether a layer has a bias, or no parameters."""
    return not names or any(name.startswith("bias") for name in names)


def check_sizes(nu: int, **sizes: int) -> tuple[int, ...]:
    """Return the sizes of a network, `nu` first; raises ValueError for an impossible size."""
    inputs = whole("nu", nu, 0, LARGEST_SIZE)
    return inputs, *(whole(name, size, 1, LARGEST_SIZE) for name, size in sizes.items())
