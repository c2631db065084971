"""The gated recurrent unit (paper, supplement, "GRU training")."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from splitband.networks.cell import are_plain, check_sizes
from splitband.runtime.options import Written


class GRU(Written, nn.Module):
    """A gated recurrent unit with a linear observation (paper, supplement, "GRU training").

    Parameters and their initialisation are those of `torch.nn.GRUCell` and `torch.nn.Linear`.

    Parameters
    ----------
    hidden_size : Size of the state h.
    ny : Measured channels.
    nu : Known inputs; they enter each step beside y.
    """

    label = "gru"

    def __init__(self, hidden_size: int = 64, ny: int = 1, nu: int = 0) -> None:
        super().__init__()
        nu, ny, hidden_size = check_sizes(nu, ny=ny, hidden_size=hidden_size)
        self.ny, self.nu, self.hidden_size = ny, nu, hidden_size
        self.transition = nn.GRUCell(ny + nu, hidden_size)
        self.observation = nn.Linear(hidden_size, ny)

    def sized(self, ny: int, nu: int, warmup: int) -> GRU:
        """A new one of the same hidden size; it warms up on any number of samples."""
        return GRU(self.hidden_size, ny, nu)

    def scaled(self, share: float) -> GRU:
        """A template with fewer hidden units, or more."""
        return GRU(max(1, round(share * self.hidden_size)), self.ny, self.nu)

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
        return are_plain((self.transition, nn.GRUCell), (self.observation, nn.Linear))

    def fused_rollout(self, y_warmup: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
        """What `splitband.rollout` computes step by step, in one compiled call on the CPU."""
        from splitband.kernels import gru_rollout  # noqa: PLC0415  numba loads on first use

        cell, out = self.transition, self.observation
        recurrent = cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh
        return gru_rollout(y_warmup, steps, u, *recurrent, out.weight, out.bias)
