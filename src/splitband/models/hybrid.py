"""Hybrid models: a network and a black-box simulator."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from splitband.cells import Cell
from splitband.data import Trajectory
from splitband.filters import ComplementaryPair
from splitband.models.base import Model, Signals, Task, as_module
from splitband.rollouts import rollout
from splitband.simulators import affine_fit


class Hybrid(Model):
    """A network and a simulator; the simulator may be calibrated first.

    Parameters
    ----------
    cell : The network.
    calibrate : Fit a gain and an offset for each channel of the simulator by least squares on the
        training record, before anything is learned. Not in the paper.
    """

    gain: Tensor
    offset: Tensor

    def __init__(self, cell: Cell, calibrate: bool = False) -> None:
        super().__init__(cell.ny, cell.nu)
        self.cell, self.calibrate = cell, calibrate
        self.register_buffer("gain", torch.ones(cell.ny, dtype=torch.float64))
        self.register_buffer("offset", torch.zeros(cell.ny, dtype=torch.float64))

    def adapt_to(self, trajectory: Trajectory, normalize: bool = True) -> None:
        """Take the units and, if asked to, the calibration from a training record."""
        super().adapt_to(trajectory, normalize)
        if self.calibrate:
            known = self.normalised(trajectory)
            y_sim = _required(known)
            gain, offset = affine_fit(y_sim.double().cpu().numpy(), known.y.double().cpu().numpy())
            self.gain.copy_(torch.from_numpy(gain))
            self.offset.copy_(torch.from_numpy(offset))

    def _calibrated(self, known: Signals) -> Tensor:
        """The simulator's output, `(..., time, ny)`, in normalised units."""
        y_sim = _required(known)
        return y_sim * self.gain.to(y_sim) + self.offset.to(y_sim)


class Filtered(Hybrid):
    """The simulator in the low band, a network in the high band (paper, Sec. 4.3).

    H(network) + L(simulator) through the joint recurrence, trained end to end. The paper starts
    the filter with the first P samples of the training signal; here these are the last P of the
    warm-up, so that a simulation needs no sample after it (docs/deviations.md).

    Parameters
    ----------
    cell : The network; its free run is that of the whole signal, of which the high band is used.
    pair : One-way filters, of which L + H = 1.
    calibrate : See `Hybrid`.
    """

    def __init__(self, cell: Cell, pair: ComplementaryPair, calibrate: bool = False) -> None:
        super().__init__(cell, calibrate)
        if pair.zero_phase:
            raise ValueError("the hybrid model's pair must filter one way (zero_phase=False)")
        self.pair = pair

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """L(simulator) and H(network)."""
        filtered = self._low_passed(known)
        low = _required(filtered)[:, known.y.shape[1] :][:, :steps]
        return {"simulator, low band": low, "network, high band": self._high(filtered, steps)}

    def unfiltered(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """The simulator's samples and the network's, before the filters."""
        calibrated, warmup = self._calibrated(known), known.y.shape[1]
        network = rollout(self.cell, known.y, steps, known.u)
        return {"simulator": calibrated[:, warmup : warmup + steps], "network": network}

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the record (paper, Eq. 14); L(simulator) is filtered once, as a whole."""
        known = self._low_passed(record)
        return [Task("network", as_module(self.cell), known, record.y, self._combined)]

    def _low_passed(self, known: Signals) -> Signals:
        return replace(known, y_sim=self.pair.lowpass(self._calibrated(known)))

    def _combined(self, filtered: Signals, steps: int) -> Tensor:
        warmup = filtered.y.shape[1]
        return self._high(filtered, steps) + _required(filtered)[:, warmup : warmup + steps]

    def _high(self, filtered: Signals, steps: int) -> Tensor:
        """H(network), going on from what L(simulator) leaves of the last measured samples."""
        order, warmup = self.pair.order, filtered.y.shape[1]
        if warmup < order:
            raise ValueError(f"the warm-up must have at least {order} samples, got {warmup}")
        measured = filtered.y[:, warmup - order :]
        first = measured - _required(filtered)[:, warmup - order : warmup]
        network = rollout(self.cell, filtered.y, steps, filtered.u)
        high = self.pair.highpass_from(torch.cat([measured, network], dim=1), first)
        return high[:, order:]


class Residual(Hybrid):
    """A network for what the simulator leaves: y = network + simulator (paper, Sec. 5.1).

    The network warms up on the residual of the measured samples. Parameters as for `Hybrid`.
    """

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """The simulator's samples and the network's."""
        calibrated = self._calibrated(known)
        warmup = known.y.shape[1]
        residual = self._simulate(replace(known, y_sim=calibrated), steps)
        return {"simulator": calibrated[:, warmup : warmup + steps], "network": residual}

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the simulator's residual."""
        calibrated = self._calibrated(record)
        known = replace(record, y_sim=calibrated)
        target = record.y - calibrated
        return [Task("network", as_module(self.cell), known, target, self._simulate)]

    def _simulate(self, known: Signals, steps: int) -> Tensor:
        warmup = known.y.shape[1]
        return rollout(self.cell, known.y - _required(known)[:, :warmup], steps, known.u)


def _required(known: Signals) -> Tensor:
    if known.y_sim is None:
        raise ValueError("y_sim must be given: the model needs a simulator's output")
    return known.y_sim
