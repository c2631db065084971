"""Two networks on the bands of a signal, as the readings of the paper's text have them."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from reproduction.readings import COLUMN, Reading
from splitband.filters.resampling import downsample, upsample
from splitband.models import Model
from splitband.models.base import Signals, Task
from splitband.networks import GRU, Cell, rollout

LOW, HIGH = "low band", "high band"


class Bands(Model):
    """Two networks on a record whose two channels are the bands of a signal.

    Parameters
    ----------
    networks : Of the low and the high band, one channel each.
    reading : What is done with the bands.
    sampling_rate : In Hz.
    filter_output : Whether the prediction of the high band is high-passed, the paper's "+HP".
    """

    def __init__(
        self, networks: list[GRU], reading: Reading, sampling_rate: float, filter_output: bool
    ) -> None:
        super().__init__(2, 0)
        self.networks = nn.ModuleList(networks)
        self.reading, self.filter_output = reading, filter_output
        self.pair = reading.filtering.pair(sampling_rate)
        self.trained: list[str] = []

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return both bands at the full rate, `(batch, steps, 1)`."""
        return {LOW: self.low_at_full_rate(known, steps), HIGH: self.high(known, steps)}

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the bands in `trained`, or their sum."""
        if self.reading.training.summed:
            target = record.y.sum(dim=1, keepdim=True)
            return [Task("sum", self.networks, record, target, self._sum)]
        k = self.reading.resampling.k
        tasks = [
            Task(LOW, self.networks[0], record, self._low_target(record.y), self._low, k),
            Task(HIGH, self.networks[1], record, record.y[:, 1:], self.high),
        ]
        return [task for task in tasks if task.name in self.trained]

    def _sum(self, known: Signals, steps: int) -> Tensor:
        return self.low_at_full_rate(known, steps) + self.high(known, steps)

    def _low_target(self, y: Tensor) -> Tensor:
        low, resampling = y[:, :1], self.reading.resampling
        if not resampling.mean:
            return low
        padded = torch.cat([low, low[-1:].expand(resampling.k - 1, 1)])
        return padded.unfold(0, resampling.k, 1).mean(dim=-1)

    def _history(self, known: Signals) -> tuple[Tensor, Tensor]:
        if not self.reading.filtering.own_warmup:
            return known.y[..., :1], known.y[..., 1:]
        y = known.y.sum(dim=-1, keepdim=True)
        low = self.pair.lowpass(y)
        return low, y - low

    def _low(self, known: Signals, steps: int) -> Tensor:
        history, k = self._history(known)[0], self.reading.resampling.k
        offset = history.shape[1] % k
        slow = downsample(history, k, offset)
        if self.reading.resampling.mean:
            slow = history[:, offset:].unflatten(1, (-1, k)).mean(dim=2)
        return self._rollout(0, slow, steps)

    def low_at_full_rate(self, known: Signals, steps: int) -> Tensor:
        """Return the free run of the low band, `(batch, steps, 1)`."""
        k, align = self.reading.resampling.k, self.reading.resampling.align
        return upsample(self._low(known, (steps - 2) // k + 2), k, steps, align)

    def high(self, known: Signals, steps: int) -> Tensor:
        """Return the free run of the high band, `(batch, steps, 1)`."""
        history = self._history(known)[1]
        y = self._rollout(1, history, steps)
        if not self.filter_output:
            return y
        if self.reading.hp_alone:
            return self._highpass(y)
        return self._highpass(torch.cat([history, y], dim=1))[:, history.shape[1] :]

    def _highpass(self, y: Tensor) -> Tensor:
        high = self.pair.highpass(y)
        return high.clamp(-1.0, 1.0) if self.reading.filtering.clamp else high

    def _rollout(self, band: int, history: Tensor, steps: int) -> Tensor:
        if self.reading.training.twice:
            history = torch.cat([history, history[:, -1:]], dim=1)
        cell: Cell = self.networks[band]  # type: ignore[assignment]
        return rollout(cell, history, steps)


def networks_of(method: str, reading: Reading, seed: int) -> list[GRU]:
    """Return untrained networks, the low band's first, with the weights of the package's own."""
    torch.manual_seed(0 if reading.training.fixed == "weights" else seed)
    sizes = [COLUMN.hidden_low, COLUMN.hidden_high]
    if method == "gru":
        sizes = [sum(sizes)]
    networks = [GRU(size) for size in (sizes[::-1] if reading.large_low else sizes)]
    for network in networks:
        _set_weights(network, reading.training.weights)
    return networks


def _set_weights(network: GRU, kind: str) -> None:
    for name, values in network.named_parameters():
        if kind == "orthogonal" and name == "transition.weight_hh":
            for gate in values.data.chunk(3):
                nn.init.orthogonal_(gate)
        if kind == "zero biases" and "bias" in name:
            nn.init.zeros_(values)
