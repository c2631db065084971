"""Combine a network and a black-box simulator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from splitband.filters import ComplementaryPair
from splitband.filters.resampling import check_downsampling
from splitband.models.base import (
    FreeRun,
    Model,
    Signals,
    Task,
    as_module,
    concat_inputs,
    conditioning,
    inputs_of,
    slope_scale,
    value_and_slope,
)
from splitband.models.downsampled import LowBand, SteppedLowBand
from splitband.models.labels import NETWORK, SIMULATOR
from splitband.models.stepping import (
    Run,
    Stepped,
    SteppedCell,
    filtered,
    one_way,
    state_after,
    steady,
)
from splitband.networks import Cell, rollout
from splitband.networks.layers import Tensor, torch
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError


class Hybrid(Model):
    """A network and a simulator.

    cell : The network.
    conditioned : The simulator's output, value and slope by channel, is an input of the network:
        2 ny additional inputs. The paper names conditioning as future work.
    feedthrough : As for `Recurrent`.
    """

    slope_scale: Tensor
    uses_simulator = True

    def __init__(self, cell: Cell, conditioned: bool = False, feedthrough: bool = False) -> None:
        super().__init__(cell.ny, inputs_of(cell, 2 * cell.ny * conditioned, feedthrough))
        self.cell, self.conditioned, self.feedthrough = cell, conditioned, feedthrough
        self.register_buffer("slope_scale", torch.ones(cell.ny, dtype=torch.float64))

    def adapt_to(self, records: Sequence[Record], normalize: bool = True) -> None:
        """Set the scaling of signals and the simulator's slope from the training records."""
        super().adapt_to(records, normalize)
        if not self.units_kept:
            self.slope_scale.copy_(self._slope_scale([*map(self.normalised, records)]))

    def _slope_scale(self, records: Sequence[Signals]) -> Tensor:
        """Return the scale of the slopes of the conditioning signal, `(ny,)`."""
        return slope_scale([*map(_required, records)], driven=self.nu > 0)

    def _conditioned(self, known: Signals) -> Signals:
        """Return the signals with the network's inputs, including the simulator if conditioned."""
        known = replace(known, u=self._rows(known.u))
        if not self.conditioned:
            return known
        # The simulator's output may depend on the inputs, as an FMU's does.
        additional = conditioning(_required(known), self.slope_scale, driven=self.nu > 0)
        return replace(known, u=concat_inputs(known.u, additional))


class SteppedFiltered(Stepped):
    """The step form of `FilteredModel`."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.cell = SteppedCell(model.cell)
        self.pair: ComplementaryPair = model.pair

    def _begin(self, y: Array, u: Array, slow: Array) -> Run:
        pair, since = self.pair, len(y) - self.pair.order
        low, low_state = one_way(pair.b_low, pair.a, slow[: len(y)], steady(pair, "low"))
        high_state = state_after(pair.b_high, pair.a, y[since:], y[since:] - low[since:])
        net = self.cell.begin(y, self._network_inputs(self._rows(u), slow))
        return {"net": net, "low": low_state, "high": high_state}

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        pair = self.pair
        low_state, low = filtered(pair.b_low, pair.a, run["low"], slow[1])
        net = self.cell.advance(run["net"], self._network_inputs(self._rows(u), slow)[0])
        high_state, high = filtered(pair.b_high, pair.a, run["high"], net["y"])
        return {"net": net, "low": low_state, "high": high_state}, low + high


class FilteredModel(Hybrid):
    """The simulator in the low band plus a network in the high band (paper, Sec. 4.3).

    H(network) + L(simulator) through the joint recurrence, trained end to end. The paper starts
    the filter with the first P samples of the training signal; here these are the last P of the
    warm-up, so that a simulation needs no later sample (reproduction/REPORT.md).

    cell : The network of the whole signal; its high band is used.
    pair : One-way filters, with L + H = 1.
    conditioned : See `Hybrid`. The high-pass filter also removes the simulator's effect on the low
        band of the network's output.
    feedthrough : See `Hybrid`.
    """

    steps = SteppedFiltered

    def __init__(
        self,
        cell: Cell,
        pair: ComplementaryPair,
        conditioned: bool = False,
        feedthrough: bool = False,
    ) -> None:
        super().__init__(cell, conditioned, feedthrough)
        self.pair = pair

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return L(simulator) and H(network)."""
        filtered = self._low_passed(known)
        network = rollout(self.cell, *self._run(filtered, steps))
        low, high = _after_warmup(filtered, steps), self._high(network, filtered)
        return {f"{SIMULATOR}, low band": low, f"{NETWORK}, high band": high}

    def unfiltered(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the outputs of the simulator and of the network, before the filters."""
        network = rollout(self.cell, known.y, steps, self._conditioned(known).u)
        return {SIMULATOR: _after_warmup(known, steps), NETWORK: network}

    def tasks(self, record: Signals) -> list[Task]:
        """Return one task, the record (paper, Eq. 12, hybrid loss); L(simulator) filtered once."""
        known, cell = self._low_passed(record), as_module(self.cell)
        return [Task(NETWORK, cell, known, record.y, self._run, output=self._combined)]

    def _low_passed(self, known: Signals) -> Signals:
        """Return the conditioned signals, with L(simulator) in place of the simulator's output."""
        return replace(self._conditioned(known), y_sim=self.pair.lowpass(_required(known)))

    def _run(self, filtered: Signals, steps: int) -> FreeRun:
        return filtered.y, steps, filtered.u

    def _combined(self, network: Tensor, filtered: Signals, steps: int) -> Tensor:
        return self._high(network, filtered) + _after_warmup(filtered, steps)

    def _high(self, network: Tensor, filtered: Signals) -> Tensor:
        """Return H(network); the filter starts from measured samples minus L(simulator)."""
        order, warmup = self.pair.order, filtered.y.shape[1]
        measured = filtered.y[:, warmup - order :]
        first = measured - _required(filtered)[:, warmup - order : warmup]
        high = self.pair.highpass_from(torch.cat([measured, network], dim=1), first)
        return high[:, order:]


class SteppedFilteredHigh(Stepped):
    """The step form of `FilteredHighModel`."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.pair: ComplementaryPair = model.pair
        self.low = SteppedLowBand(model.low_band)
        self.ahead = 0  # the network has no later samples of the simulator as inputs

    def _begin(self, y: Array, u: Array, slow: Array) -> Run:
        low, _ = one_way(self.pair.b_low, self.pair.a, y, steady(self.pair, "low"))
        high, state = one_way(self.pair.b_high, self.pair.a, slow, steady(self.pair, "high"))
        run = self.low.begin(low, self._of_low(u, high))
        return {**run, "state": state, "high": high[-1]}

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        state, high = filtered(self.pair.b_high, self.pair.a, run["state"], slow[1])
        rows = self._of_low(u, np.stack([run["high"], high]))
        moved = self.low.moved(run, rows[-1])
        return {**moved, "state": state, "high": high}, self.low.values(moved)[0][0] + high

    def _of_low(self, u: Array, high: Array) -> Array:
        """Return the network's inputs by sample or, `at_once`, by step."""
        if self.low.at_once:
            return self._network_inputs(self._rows(u), high)
        if not self.conditioned:
            return u
        steps = high[1:] - high[:-1]
        slope = np.concatenate([steps[:1], steps]) / self.slope_scale
        return np.concatenate([u, high, slope], axis=1)


class FilteredHighModel(Hybrid):
    """The simulator in the high band plus a network on the down-sampled low band.

    H(simulator) + network, the reverse of `Filtered`. The network simulates L(y) of the measured
    signal at every k-th sample, and its free run is interpolated, as in `Split`. The paper has one
    such case, the gyroscope of its introduction.

    Both filters run one way and start in the steady state of the warm-up's first sample, in
    training, too: if the simulator is right apart from an offset, L(y) + H(simulator) is then y
    after warm-ups of any length. The loss is the error of the sum: the network can correct the
    remains of a drift after the high-pass filter.

    cell : The network.
    pair : One-way filters, with L + H = 1. H should be the steep one: a Butterworth filter of order
        n removes a drift of the simulator up to the power n - 1 of time.
    downsampling : k: the network runs on every k-th sample.
    conditioned : H(simulator), value and slope by channel, is an input of the network: 2 ny
        additional inputs. A drift takes the simulator's whole output, or its low band, out of the
        range of training, but not its high band.
    feedthrough : As for `Recurrent`, for a network at the full rate.

    Raises
    ------
    ValueError
        For a down-sampling against the Nyquist condition.
    """

    steps = SteppedFilteredHigh

    def __init__(
        self,
        cell: Cell,
        pair: ComplementaryPair,
        downsampling: int = 1,
        conditioned: bool = False,
        feedthrough: bool = False,
    ) -> None:
        super().__init__(cell, conditioned, feedthrough and downsampling == 1)
        check_downsampling(downsampling, pair.cutoff or 0.0, pair.sampling_rate)
        self.pair, self.downsampling = pair, downsampling

    @property
    def low_band(self) -> LowBand:
        """Return the network with its rate."""
        return LowBand(self.cell, self.downsampling, self.feedthrough and self.nu > 0)

    def _slope_scale(self, records: Sequence[Signals]) -> Tensor:
        """Return the scale of the slopes of H(simulator), `(ny,)`."""
        return slope_scale([_required(self._high_passed(record)) for record in records], True)

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the network's low band and H(simulator)."""
        network = rollout(self.cell, *self._run(known, steps))
        low = self.low_band.at_full_rate(network, steps)
        high = _after_warmup(self._high_passed(known), steps)
        return {f"{NETWORK}, low band": low, f"{SIMULATOR}, high band": high}

    def unfiltered(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the simulator's output before the filter."""
        return {SIMULATOR: _after_warmup(known, steps)}

    def tasks(self, record: Signals) -> list[Task]:
        """Return one task, the record (paper, Eq. 12, hybrid loss), windows filtered one by one."""
        cell = as_module(self.cell)
        return [Task(NETWORK, cell, record, record.y, self._run, output=self._combined)]

    def _run(self, known: Signals, steps: int) -> FreeRun:
        rows = self._of_low(self._high_passed(known))
        return self.low_band.enough(self.pair.lowpass(known.y), steps, rows)

    def _combined(self, network: Tensor, known: Signals, steps: int) -> Tensor:
        high = _after_warmup(self._high_passed(known), steps)
        return self.low_band.at_full_rate(network, steps) + high

    def _high_passed(self, known: Signals) -> Signals:
        """Return the signals with H(simulator) in place of the simulator's output."""
        return replace(known, y_sim=self.pair.highpass(_required(known)))

    def _of_low(self, known: Signals) -> Tensor | None:
        """Return the known inputs of the network, followed by H(simulator) if conditioned."""
        rows, high = self._rows(known.u), _required(known)
        if not self.conditioned:
            return rows
        # The row of a step has H(simulator) at the step's end, the row of a sample at the sample.
        columns_of = conditioning if self.low_band.at_once else value_and_slope
        return concat_inputs(rows, columns_of(high, self.slope_scale, driven=True))


class SteppedResidual(Stepped):
    """The step form of `ResidualModel`."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.cell = SteppedCell(model.cell)

    def _begin(self, y: Array, u: Array, slow: Array) -> Run:
        return self.cell.begin(y - slow[: len(y)], self._network_inputs(self._rows(u), slow))

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        run = self.cell.advance(run, self._network_inputs(self._rows(u), slow)[0])
        return run, run["y"] + slow[1]


class ResidualModel(Hybrid):
    """The simulator plus a network for its residual: y = network + simulator (paper, Sec. 5.1).

    The network warms up on the residual of the measured samples. Parameters as for `Hybrid`.
    """

    steps = SteppedResidual

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the outputs of the simulator and of the network."""
        residual = rollout(self.cell, *_of_residual(self._conditioned(known), steps))
        return {SIMULATOR: _after_warmup(known, steps), NETWORK: residual}

    def tasks(self, record: Signals) -> list[Task]:
        """Return one task, with the simulator's residual as the target."""
        known, target = self._conditioned(record), record.y - _required(record)
        return [Task(NETWORK, as_module(self.cell), known, target, _of_residual)]


def _of_residual(known: Signals, steps: int) -> FreeRun:
    return known.y - _required(known)[:, : known.y.shape[1]], steps, known.u


def _after_warmup(known: Signals, steps: int) -> Tensor:
    """Return the simulator's `steps` samples after the warm-up."""
    warmup = known.y.shape[1]
    return _required(known)[:, warmup : warmup + steps]


def _required(known: Signals) -> Tensor:
    if known.y_sim is None:
        raise InputError("y_sim must be given: the model needs a simulator's output")
    return known.y_sim
