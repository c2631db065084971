"""Models of a record: what is trained, and how it simulates from a warm-up.

A model says which networks it has and what each must reproduce (`tasks`); `training.fit` knows
nothing more. Training and simulation go through the same methods, so a network meets in training
just what it will meet in use.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from splitband.cells import Cell
from splitband.data import Trajectory
from splitband.filters import ComplementaryPair
from splitband.resampling import check_downsampling, downsample, upsample
from splitband.rollout import rollout
from splitband.simulators import affine_fit

Signal = TypeVar("Signal", npt.NDArray[Any], Tensor)


@dataclass(frozen=True, eq=False)
class Signals:
    """What a model may know, normalised: `(time, n)` for a record, `(batch, time, n)` otherwise."""

    y: Tensor
    u: Tensor | None = None
    y_sim: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Task:
    """One network's share of the training.

    Attributes
    ----------
    name : For messages and loss curves.
    network : Whose parameters are trained.
    known : What windows are cut from, aligned with the record.
    target : What the output is compared with, `(time, ny)`, aligned with the record.
    simulate : Maps what is known of a batch of windows, `y` over the warm-up only, and a number
        of samples to the network's share of them, `(batch, samples, ny)`.
    stride : The output holds every `stride`-th sample, the first right after the warm-up.
    """

    name: str
    network: nn.Module
    known: Signals
    target: Tensor
    simulate: Callable[[Signals, int], Tensor]
    stride: int = 1


class Model(nn.Module, ABC):
    """A simulator learned from a record; subclasses say what its components are.

    Parameters
    ----------
    ny, nu : Measured channels and known inputs.
    """

    y_mean: Tensor
    y_std: Tensor
    u_mean: Tensor
    u_std: Tensor

    def __init__(self, ny: int, nu: int) -> None:
        super().__init__()
        self.ny, self.nu = ny, nu
        for name, size in (("y", ny), ("u", nu)):
            self.register_buffer(f"{name}_mean", torch.zeros(size, dtype=torch.float64))
            self.register_buffer(f"{name}_std", torch.ones(size, dtype=torch.float64))

    @abstractmethod
    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """The parts of a simulation, to be added: `steps` samples after the warm-up `known.y`."""

    @abstractmethod
    def tasks(self, record: Signals) -> list[Task]:
        """What each network has to learn from a normalised record."""

    def simulate(
        self,
        y_warmup: Signal,
        steps: int,
        u: Signal | None = None,
        y_sim: Signal | None = None,
    ) -> Signal:
        """Run free for `steps` samples after a measured warm-up.

        Parameters
        ----------
        y_warmup : Measured samples `(R,)`, `(R, ny)` or `(batch, R, ny)`, NumPy or torch.
        steps : How many samples to simulate.
        u : Known inputs over warm-up and simulation, `(R + steps, nu)`, with a batch if y has one.
        y_sim : A simulator's output over warm-up and simulation, shaped like y, where one is used.

        Returns
        -------
        Signal
            Shaped like `y_warmup`, with `steps` samples; in its units, dtype and device.
        """
        parts = list(self.simulate_components(y_warmup, steps, u, y_sim).values())
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return total

    def simulate_components(
        self,
        y_warmup: Signal,
        steps: int,
        u: Signal | None = None,
        y_sim: Signal | None = None,
    ) -> dict[str, Signal]:
        """The parts that `simulate` adds up, by name; the first one carries the record's mean."""
        known = self._normalised(y_warmup, steps, u, y_sim)
        if isinstance(y_warmup, Tensor):
            parts = self.components(known, steps)
        else:
            with torch.no_grad():
                parts = self.components(known, steps)
        units: dict[str, Signal] = {}
        for name, part in parts.items():
            value = part.double() * self.y_std + (self.y_mean if not units else 0.0)
            value = value.reshape(*y_warmup.shape[:-2], steps, self.ny)
            value = value[:, 0] if y_warmup.ndim == 1 else value
            units[name] = value.to(y_warmup) if isinstance(y_warmup, Tensor) else value.numpy()
        return units

    def adapt_to(self, trajectory: Trajectory, normalize: bool = True) -> None:
        """Take from a training record what is not learned by gradient: here, the units.

        With `normalize`, that is the mean and the standard deviation of each channel.
        """
        if not normalize:
            return
        for name, values in (("y", trajectory.y), ("u", trajectory.u)):
            if values is not None:
                std = values.std(axis=0)
                spread = np.where(std > 0, std, 1.0)
                getattr(self, f"{name}_mean").copy_(torch.from_numpy(values.mean(axis=0)))
                getattr(self, f"{name}_std").copy_(torch.from_numpy(spread))

    def normalised(self, trajectory: Trajectory) -> Signals:
        """The signals of a record as the networks see them, each `(time, n)`."""
        u, y_sim = trajectory.u, trajectory.y_sim
        return Signals(
            self._to_network(trajectory.y, "y"),
            self._to_network(u, "u") if self.nu and u is not None else None,
            None if y_sim is None else self._to_network(y_sim, "y"),
        )

    def _normalised(
        self, y_warmup: Signal, steps: int, u: Signal | None, y_sim: Signal | None
    ) -> Signals:
        if steps < 1:
            raise ValueError(f"steps must be at least 1, got {steps}")
        total = (y_warmup.shape[0] if y_warmup.ndim == 1 else y_warmup.shape[-2]) + steps
        if bool(self.nu) != (u is not None):
            raise ValueError(f"u must be given exactly where the model has inputs, nu = {self.nu}")
        return Signals(
            self._batch(y_warmup, "y_warmup", self.ny, 1),
            None if u is None else self._batch(u, "u", self.nu, total),
            None if y_sim is None else self._batch(y_sim, "y_sim", self.ny, total),
        )

    def _batch(self, x: Signal, name: str, channels: int, samples: int) -> Tensor:
        """Bring `(time,)`, `(time, n)` or `(batch, time, n)` to a normalised batch."""
        shape = tuple(x.shape)
        x = x[:, None] if x.ndim == 1 else x
        x = x[None] if x.ndim == 2 else x
        if x.ndim != 3 or x.shape[-1] != channels or x.shape[1] < samples:
            raise ValueError(
                f"{name} must have {channels} channel(s) and at least {samples} sample(s), shape "
                f"(time, {channels}) or (batch, time, {channels}), got {shape}"
            )
        return self._to_network(x, "u" if name == "u" else "y")

    def _to_network(self, x: npt.NDArray[Any] | Tensor, kind: str) -> Tensor:
        # In float64 first: a large offset would use up the digits of a float32.
        mean, std = getattr(self, f"{kind}_mean"), getattr(self, f"{kind}_std")
        x = x if isinstance(x, Tensor) else torch.from_numpy(np.array(x, dtype=np.float64))
        values = x.to(mean)
        return ((values - mean) / std).to(next(self.parameters()).dtype)


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
        return [Task("network", _module(self.cell), record, record.y, self._simulate)]

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
        low = self.pair.lowpass(record.y)
        return [
            Task("low band", _module(self.low), record, low, self._simulate_low, self.downsampling),
            Task("high band", _module(self.high), record, record.y - low, self._simulate_high),
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

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the record (paper, Eq. 14); L(simulator) is filtered once, as a whole."""
        known = self._low_passed(record)
        return [Task("network", _module(self.cell), known, record.y, self._combined)]

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
        return [Task("network", _module(self.cell), known, target, self._simulate)]

    def _simulate(self, known: Signals, steps: int) -> Tensor:
        warmup = known.y.shape[1]
        return rollout(self.cell, known.y - _required(known)[:, :warmup], steps, known.u)


def _required(known: Signals) -> Tensor:
    if known.y_sim is None:
        raise ValueError("y_sim must be given: the model needs a simulator's output")
    return known.y_sim


def _module(cell: Cell) -> nn.Module:
    if not isinstance(cell, nn.Module):
        raise TypeError(f"a cell must be an nn.Module, got {type(cell).__name__}")
    return cell
