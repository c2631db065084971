"""Models learned from a record alone: one network, or two on their bands."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from splitband.cells import Cell
from splitband.filters import ComplementaryPair
from splitband.models.base import Model, Signals, Task, as_module
from splitband.resampling import check_downsampling, downsample, upsample
from splitband.rollouts import rollout


class Recurrent(Model):
    """One network on the whole band: the baseline (paper, Sec. 4.1)."""

    def __init__(self, cell: Cell) -> None:
        super().__init__(cell.ny, cell.nu)
        self.cell = cell

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """The network's free run."""
        return {"network": self._simulate(known, steps)}

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the record."""
        return [Task("network", as_module(self.cell), record, record.y, self._simulate)]

    def _simulate(self, known: Signals, steps: int) -> Tensor:
        return rollout(self.cell, known.y, steps, known.u)


class Split(Model):
    """Two networks, each on its band (paper, Sec. 4.2): "split GRU" and "split GRU + HP".

    The low-band network lives on the low-passed, down-sampled signal; its free run is up-sampled
    and added to that of the high-band network.

    The warm-up is filtered by itself, in training as in simulation: a prediction cannot depend on
    later samples through the zero-phase filter, and the networks learn to start from a history
    whose ends are distorted (docs/deviations.md).

    Parameters
    ----------
    low, high : The networks.
    pair : The filters that part the bands.
    downsampling : k: the low network sees every k-th sample.
    filter_output : High-pass the high network's output too, the paper's "+HP".

    Raises
    ------
    ValueError
        When the down-sampled signal cannot carry the low band (Nyquist).
    """

    def __init__(
        self,
        low: Cell,
        high: Cell,
        pair: ComplementaryPair,
        downsampling: int = 2,
        filter_output: bool = False,
    ) -> None:
        super().__init__(high.ny, high.nu)
        if (low.ny, low.nu) != (high.ny, high.nu):
            raise ValueError(
                f"low and high must agree in (ny, nu), got {(low.ny, low.nu)} "
                f"and {(high.ny, high.nu)}"
            )
        if pair.cutoff is not None:
            check_downsampling(downsampling, pair.cutoff, pair.sampling_rate)
        self.low, self.high = low, high
        self.pair, self.downsampling, self.filter_output = pair, downsampling, filter_output

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """The low band, up-sampled, and the high band (paper, Eq. 13)."""
        k = self.downsampling
        slow = self._simulate_low(known, (steps - 2) // k + 2)
        return {
            "low band": upsample(slow, k, length=steps),
            "high band": self._simulate_high(known, steps),
        }

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce each band of the record (paper, Eq. 12).

        The high band is what the low-pass filter leaves, so that the two add up to the record at
        its ends too; away from them it is H(y).
        """
        low, k = self.pair.lowpass(record.y), self.downsampling
        return [
            Task("low band", as_module(self.low), record, low, self._simulate_low, k),
            Task("high band", as_module(self.high), record, record.y - low, self._simulate_high),
        ]

    def _simulate_low(self, known: Signals, steps: int) -> Tensor:
        """`steps` samples at the low rate, the first of them right after the warm-up."""
        k, warmup = self.downsampling, known.y.shape[1]
        offset = warmup % k
        history = downsample(self.pair.lowpass(known.y), k, offset)
        u = None
        if known.u is not None:  # an input holds until the next low-rate sample
            held = known.u[:, offset:].transpose(1, 2)
            u = nn.functional.avg_pool1d(held, k, ceil_mode=True).transpose(1, 2)
        return rollout(self.low, history, steps, u)

    def _simulate_high(self, known: Signals, steps: int) -> Tensor:
        history = known.y - self.pair.lowpass(known.y)
        y = rollout(self.high, history, steps, known.u)
        if not self.filter_output:
            return y
        # With its own history in front the filter has settled before the first prediction.
        return self.pair.highpass(torch.cat([history, y], dim=1))[:, history.shape[1] :]
