"""Define the gated recurrent unit (Ensinger et al. 2023, supplement, "GRU training")."""

from __future__ import annotations

from splitband.networks import plain
from splitband.networks.cell import are_plain, check_sizes
from splitband.networks.in_numpy import values
from splitband.networks.layers import Tensor, nn, torch
from splitband.runtime.options import WithRepr


class GRU(WithRepr, nn.Module):
    """A gated recurrent unit with a linear observation (Ensinger et al. 2023, supplement).

    Parameters and their initialisation are those of `torch.nn.GRUCell` and `torch.nn.Linear`.

    Parameters
    ----------
    hidden_size : Size of the state h.
    ny : Number of measured channels.
    nu : Number of known inputs, concatenated with y in every step.

    Raises
    ------
    ValueError
        For sizes that are no whole numbers from 1 (`nu`: from 0).

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> settings = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    >>> sb.Single(sb.GRU(8), settings).fit(record, seed=0).predict(20).y.shape
    (20, 1)
    """

    label = "gru"

    def __init__(self, hidden_size: int = 64, ny: int = 1, nu: int = 0) -> None:
        super().__init__()
        nu, ny, hidden_size = check_sizes(nu, ny=ny, hidden_size=hidden_size)
        self.ny, self.nu, self.hidden_size = ny, nu, hidden_size
        self.transition = nn.GRUCell(ny + nu, hidden_size)
        self.observation = nn.Linear(hidden_size, ny)

    def sized(self, ny: int, nu: int, warmup: int) -> GRU:
        """Return a new cell of equal hidden size, for warm-ups of any length."""
        return GRU(self.hidden_size, ny, nu)

    def variants(self) -> list[GRU]:
        """Return templates of this hidden size, two thirds and one third of it."""
        sizes = (self.hidden_size, round(2 / 3 * self.hidden_size), round(self.hidden_size / 3))
        return [GRU(max(1, size), self.ny, self.nu) for size in sizes]

    def size_in_words(self) -> str:
        """Return the hidden size, for tables."""
        return f"{self.hidden_size} hidden units"

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        """Run over the measured samples from h = 0 (paper: the warm-up phase)."""
        h = y_warmup.new_zeros(y_warmup.shape[0], self.hidden_size)
        for n in range(y_warmup.shape[1]):
            h = self.step(h, y_warmup[:, n], None if u is None else u[:, n])
        return h

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        """Return h after one gated update, shape `(batch, hidden_size)`."""
        return self.transition(y if u is None else torch.cat([y, u], dim=-1), h)

    def observe(self, h: Tensor) -> Tensor:
        """Return C h + c, shape `(batch, ny)`."""
        return self.observation(h)

    def fusable(self) -> bool:
        """Return whether the layers have their original types and no hooks."""
        return are_plain((self.transition, nn.GRUCell), (self.observation, nn.Linear))

    def in_numpy(self) -> plain.PlainGRU | None:
        """Return the cell in NumPy; None with replaced layers."""
        cell, out = self.transition, self.observation
        if not self.fusable():
            return None
        of_input, of_state = (cell.weight_ih, cell.bias_ih), (cell.weight_hh, cell.bias_hh)
        pairs = of_input, of_state, (out.weight, out.bias)
        return plain.PlainGRU(*((values(w), values(b)) for w, b in pairs))

    def fused_rollout(self, y_warmup: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
        """Compute the rollout in one compiled call on the CPU."""
        from splitband.kernels.gru import gru_rollout  # noqa: PLC0415  numba is slow to load

        cell, out = self.transition, self.observation
        recurrent = cell.weight_ih, cell.weight_hh, cell.bias_ih, cell.bias_hh
        return gru_rollout(y_warmup, steps, u, *recurrent, out.weight, out.bias)
