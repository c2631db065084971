"""A recurrent cell of your own, an LSTM, where a GRU would be: four short methods."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

import splitband as sb


class LSTM(nn.Module):
    """A long short-term memory with a linear observation; its state is the pair (h, c)."""

    def __init__(self, hidden_size: int, ny: int = 1, nu: int = 0) -> None:
        super().__init__()
        self.ny, self.nu, self.hidden_size = ny, nu, hidden_size
        self.cell, self.out = nn.LSTMCell(ny + nu, hidden_size), nn.Linear(hidden_size, ny)

    def sized(self, ny: int, nu: int, warmup: int) -> LSTM:
        """A new one for a record of so many channels and inputs."""
        return LSTM(self.hidden_size, ny, nu)

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """The state after the measured samples."""
        h = y_warmup.new_zeros(2, y_warmup.shape[0], self.hidden_size)
        state = h[0], h[1]
        for n in range(y_warmup.shape[1]):
            state = self.step(state, y_warmup[:, n], None if u is None else u[:, n])
        return state

    def step(
        self, h: tuple[Tensor, Tensor], y: Tensor, u: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """One update of the state."""
        return self.cell(y if u is None else torch.cat([y, u], dim=-1), h)

    def observe(self, h: tuple[Tensor, Tensor]) -> Tensor:
        """What is seen of the state."""
        return self.out(h[0])


if __name__ == "__main__":
    time = 0.1 * np.arange(450)
    record = sb.Record(np.sin(0.9 * time) + 0.3 * np.sin(7 * time), 0.1)
    settings = sb.TrainingSettings(window=60, warmup=20, epochs=15)
    methods = [sb.Split(LSTM(6), LSTM(12), settings=settings), sb.Persistence()]
    result = sb.compare(record, 300, methods, seeds=1)
    print(result.table[["forecast fit %", "held-out RMSE"]].round(3).to_string())
    print(f"recommended: {result.recommended}")
