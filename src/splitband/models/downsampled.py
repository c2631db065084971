"""Run a network on every k-th sample of a low band: for whole signals, and sample by sample."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splitband.filters.resampling import Alignment, downsample, upsample
from splitband.models.base import FreeRun
from splitband.models.stepping import Run, SteppedCell
from splitband.networks import Cell
from splitband.networks.layers import Tensor, nn, torch
from splitband.runtime.arrays import Array
from splitband.runtime.tracing import cond


@dataclass(frozen=True, eq=False)
class LowBand:
    """A network on every k-th sample of a low band (paper, Sec. 4.2).

    Inputs act on no earlier sample: the step from n to n + k uses the mean of the k rows up to n,
    as the interpolation from n on needs the sample n + k.

    cell : The network.
    k : Down-sampling.
    at_once : With k = 1: rows of inputs belong to steps, and may include inputs at their ends.
    """

    cell: Cell
    k: int
    at_once: bool

    def run(self, low: Tensor, steps: int, rows: Tensor | None) -> FreeRun:
        """Return what `rollout` takes for samples at the network's rate, the first after `low`.

        `low` is the low band of the warm-up, `(batch, R, ny)`; `rows` are the network's inputs over
        warm-up and simulation, `(batch, R + samples, n)`.
        """
        offset = low.shape[1] % self.k
        if rows is not None and not self.at_once:
            rows = _mean_before(rows, self.k, offset)
        return downsample(low, self.k, offset), steps, rows

    def enough(self, low: Tensor, steps: int, rows: Tensor | None) -> FreeRun:
        """Return what `rollout` takes for `steps` samples at the full rate; see `run`."""
        # Interpolation needs a low-band sample at or after the last time.
        return self.run(low, steps if self.k == 1 else (steps - 2) // self.k + 2, rows)

    def at_full_rate(self, free: Tensor, steps: int, alignment: Alignment = "time") -> Tensor:
        """Return `steps` samples at the full rate, `(batch, steps, ny)`, of a free run."""
        return free if self.k == 1 else upsample(free, self.k, steps, alignment)


class SteppedLowBand:
    """The step form of `LowBand`.

    Unless `at_once`, the network is one of its steps ahead, and the low band is interpolated
    between its last two samples, without future inputs, see `LowBand`.
    """

    def __init__(self, network: LowBand) -> None:
        self.cell, self.k, self.at_once = SteppedCell(network.cell), network.k, network.at_once

    def begin(self, low: Array, rows: Array) -> Run:
        """Return the run at the last of the measured samples, of whose low band `(R, ny)` it is.

        `rows` are the inputs of these samples or, `at_once`, those of the R - 1 steps.
        """
        k, last = self.k, len(low) % self.k
        if self.at_once:
            return {"slow": self.cell.begin(low, rows), "current": low[-1]}
        means = self._means(np.concatenate([rows, rows[-1:]]), last)[: len(low) // k]
        slow = self.cell.advance(self.cell.begin(low[last::k], means[:-1]), means[-1])
        # The straight line to the network's next sample meets the low band here.
        current = k * low[-1] - (k - 1) * slow["y"]
        recent = rows[len(rows) - (k - 1) :].sum(axis=0)
        return {"slow": slow, "current": current, "phase": np.array(k - 1.0), "sum": recent}

    def moved(self, run: Run, row: Array) -> Run:
        """Return the run one sample later; `row` is of the new sample or, `at_once`, the step."""
        if self.at_once:
            moved = self.cell.advance(run["slow"], row)
            return {**run, "slow": moved, "current": moved["y"]}
        total, phase = run["sum"] + row, run["phase"] + 1

        def stepped() -> list[Any]:
            moved = self.cell.advance(run["slow"], total / self.k)
            return [moved, run["slow"]["y"], np.zeros(()), np.zeros(row.shape[0])]

        moved, current, phase, total = cond(
            phase >= self.k, stepped, lambda: [run["slow"], run["current"], phase, total]
        )
        return {**run, "slow": moved, "current": current, "phase": phase, "sum": total}

    def values(self, run: Run, ahead: int = 0) -> list[Array]:
        """Return the low band at the sample to predict and `ahead` later ones, `(1, ny)`."""
        current = run["current"]
        if self.at_once:
            return [current[None]]
        rise = run["slow"]["y"] - current
        return [(current + rise * ((run["phase"] + i) / self.k))[None] for i in range(1 + ahead)]

    def _means(self, rows: Array, offset: int) -> Array:
        """Return the mean inputs of the steps, see `_mean_before`."""
        before = np.broadcast_to(rows[:1], (self.k - 1 - offset, rows.shape[1]))
        blocks = np.concatenate([before, rows]) if len(before) else rows
        return blocks.reshape(len(blocks) // self.k, self.k, rows.shape[1]).sum(axis=1) / self.k


def _mean_before(rows: Tensor, k: int, offset: int) -> Tensor:
    """Return means of the k rows up to every k-th sample; the first row stands for earlier ones."""
    before = rows[:, :1].expand(-1, k - 1 - offset, -1)
    blocks = torch.cat([before, rows], dim=1).transpose(1, 2)
    return nn.functional.avg_pool1d(blocks, k).transpose(1, 2)
