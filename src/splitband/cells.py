"""Recurrent cells: one step of the dynamics, and what is seen of the state (paper, Eq. 8).

Any `nn.Module` with these three methods works wherever a `GRU` does. State is passed and
returned, never kept on the module.
"""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn


@runtime_checkable
class Cell(Protocol):
    """What a rollout asks of a recurrent network.

    Attributes
    ----------
    ny, nu : Number of measured channels and of known inputs.
    """

    ny: int
    nu: int

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Any:
        """The state h_R after the measured `y_warmup` `(batch, R, ny)`, `u` `(batch, R, nu)`."""

    def step(self, h: Any, y: Tensor, u: Tensor | None = None) -> Any:
        """h_{n+1} = f(h_n, y_n, u_n) for `y` `(batch, ny)` and `u` `(batch, nu)`."""

    def observe(self, h: Any) -> Tensor:
        """y_n = C h_n, shape `(batch, ny)`."""


class GRU(nn.Module):
    """A gated recurrent unit with a linear observation (paper, supplement, "GRU training").

    Parameters and their initialisation are those of `torch.nn.GRUCell` and `torch.nn.Linear`.

    Parameters
    ----------
    ny : Measured channels.
    hidden_size : Size of the state h.
    nu : Known inputs; they enter each step beside y.
    """

    def __init__(self, ny: int = 1, hidden_size: int = 64, nu: int = 0) -> None:
        super().__init__()
        _check_sizes(nu, ny=ny, hidden_size=hidden_size)
        self.ny, self.nu, self.hidden_size = ny, nu, hidden_size
        self.transition = nn.GRUCell(ny + nu, hidden_size)
        self.observation = nn.Linear(hidden_size, ny)

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        """Run over the measured samples from h = 0 (paper: the warm-up phase)."""
        h = y_warmup.new_zeros(y_warmup.shape[0], self.hidden_size)
        for n in range(y_warmup.shape[1]):
            h = self.step(h, y_warmup[:, n], None if u is None else u[:, n])
        return h

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        """One gated update of h, shape `(batch, hidden_size)`."""
        return self.transition(y if u is None else torch.cat([y, u], dim=-1), h)

    def observe(self, h: Tensor) -> Tensor:
        """C h + c."""
        return self.observation(h)

    def fusable(self) -> bool:
        """Whether the parts are what they were built as, and nothing listens to them."""
        return _are_plain((self.transition, nn.GRUCell), (self.observation, nn.Linear))

    def fused_rollout(self, y_warmup: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
        """What `splitband.rollout` computes step by step, in one compiled call on the CPU."""
        from splitband.kernels import gru_rollout  # noqa: PLC0415  numba loads on first use

        cell, out = self.transition, self.observation
        recurrent = cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh
        return gru_rollout(y_warmup, steps, u, *recurrent, out.weight, out.bias)


class EulerMLP(nn.Module):
    """A recurrent multilayer perceptron, the paper's "RNN" (supplement, "MLP training").

    h_{n+1} = h_n + dt f(h_n, u_n) with three layers and tanh between them; the observation is
    fixed: y is the first `ny` entries of h. A recognition network maps the whole warm-up to h_R,
    so its length is part of the cell. The state is not corrected by y.

    Parameters
    ----------
    ny : Measured channels.
    warmup : R, samples of the warm-up.
    state_size : Size of h, at least `ny` (the paper's input_dim).
    hidden_size : Width of f.
    recognition_size : Width of the recognition network (the paper's rec_dim).
    step_size : dt, in whatever unit of time suits f.
    nu : Known inputs of f.
    """

    def __init__(
        self,
        ny: int = 1,
        warmup: int = 10,
        state_size: int = 4,
        hidden_size: int = 500,
        recognition_size: int = 100,
        step_size: float = 1.0,
        nu: int = 0,
    ) -> None:
        super().__init__()
        _check_sizes(
            nu,
            ny=ny,
            warmup=warmup,
            state_size=state_size,
            hidden_size=hidden_size,
            recognition_size=recognition_size,
        )
        if state_size < ny:
            raise ValueError(f"state_size must be at least ny = {ny}, got {state_size}")
        self.ny, self.nu, self.warmup = ny, nu, warmup
        self.state_size, self.hidden_size = state_size, hidden_size
        self.recognition_size, self.step_size = recognition_size, step_size
        self.dynamics = nn.Sequential(
            nn.Linear(state_size + nu, hidden_size),
            nn.Tanh(),
            nn.Linear(hidden_size, hidden_size),
            nn.Tanh(),
            nn.Linear(hidden_size, state_size),
        )
        self.recognition = nn.Sequential(
            nn.Linear(warmup * (ny + nu), recognition_size),
            nn.Tanh(),
            nn.Linear(recognition_size, recognition_size),
            nn.Tanh(),
            nn.Linear(recognition_size, state_size),
            nn.Tanh(),
        )

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        """h_R, recognised from the last R measured samples; raises ValueError for fewer."""
        if y_warmup.shape[1] < self.warmup:
            raise ValueError(
                f"the warm-up must have at least {self.warmup} samples, got {y_warmup.shape[1]}"
            )
        seen = y_warmup if u is None else torch.cat([y_warmup, u], dim=-1)
        return self.recognition(seen[:, -self.warmup :].flatten(1))

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        """One Euler step of h, shape `(batch, state_size)`; `y` is not used."""
        return h + self.step_size * self.dynamics(h if u is None else torch.cat([h, u], dim=-1))

    def observe(self, h: Tensor) -> Tensor:
        """The first `ny` entries of h."""
        return h[:, : self.ny]

    def fusable(self) -> bool:
        """Whether the parts are what they were built as, and nothing listens to them."""
        kinds = (nn.Linear, nn.Tanh, nn.Linear, nn.Tanh, nn.Linear)
        return len(self.dynamics) == len(kinds) and _are_plain(
            (self.dynamics, nn.Sequential), *zip(self.dynamics.children(), kinds, strict=True)
        )

    def fused_rollout(self, y_warmup: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
        """What `splitband.rollout` computes step by step, in one compiled call on the CPU."""
        from splitband.kernels import euler_rollout  # noqa: PLC0415  numba loads on first use

        warmup = y_warmup.shape[1]
        past, future = (None, None) if u is None else (u[:, :warmup], u[:, warmup:])
        h = self.initial_state(y_warmup, past)
        weights = (p for layer in self.dynamics.children() for p in layer.parameters())
        return euler_rollout(h, steps, self.ny, self.step_size, future, *weights)


def _are_plain(*modules: tuple[nn.Module, type[nn.Module]]) -> bool:
    """Whether each module is of exactly its type, has its biases, and no hooks."""
    return all(
        type(module) is kind
        and getattr(module, "bias", True) is not None
        and getattr(module, "bias", True) is not False
        and not module._forward_hooks
        and not module._forward_pre_hooks
        for module, kind in modules
    )


def _check_sizes(nu: int, **sizes: int) -> None:
    if nu < 0:
        raise ValueError(f"nu must not be negative, got {nu}")
    for name, size in sizes.items():
        if size < 1:
            raise ValueError(f"{name} must be at least 1, got {size}")
