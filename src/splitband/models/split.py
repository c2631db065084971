"""Define the model of two networks, on the low and on the high band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from splitband.filters import ComplementaryPair
from splitband.filters.resampling import Alignment, check_downsampling
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
)
from splitband.models.downsampled import LowBand, SteppedLowBand
from splitband.models.stepping import (
    Run,
    Stepped,
    SteppedCell,
    both_ways,
    filtered,
    one_way,
    steady,
)
from splitband.networks import Cell, rollout
from splitband.networks.layers import Tensor, nn, torch
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

LOW, HIGH = "low band", "high band"


class SteppedSplit(Stepped):
    """The step form of `SplitModel`."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        if model.filter_output and not self.driven and model.pair.zero_phase:
            raise InputError(
                "a split model whose output is filtered forwards and backwards cannot be stepped"
            )
        if model.alignment != "time":
            raise InputError('a split model with alignment="paper" cannot be stepped')
        self.pair: ComplementaryPair = model.pair
        self.own_warmup: bool = model.own_warmup
        self.low, self.fast = SteppedLowBand(model.low_band), SteppedCell(model.fast)
        self.output = model.pair.one_way() if model.filter_output else None

    def _begin(self, y: Array, u: Array, slow: Array) -> Run:
        low = both_ways(self.pair, y)
        high = y - low if self.own_warmup else both_ways(self.pair, y, "high")
        run = self.low.begin(low, self._of_low(u))
        known = np.concatenate([low, *self.low.values(run, self.ahead)[1:]])
        run["fast"] = self.fast.begin(high, self._network_inputs(self._rows(u), known))
        if self.output is not None:
            _, run["output"] = one_way(
                self.output.b_high, self.output.a, high, steady(self.output, "high")
            )
        return run

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        before, run = self.low.values(run)[0], self.low.moved(run, self._of_low(u)[-1])
        low = [before, *self.low.values(run, self.ahead)] if self.conditioned else [before]
        inputs = self._network_inputs(self._rows(u), np.concatenate(low))
        run["fast"] = self.fast.advance(run["fast"], inputs[0])
        high = run["fast"]["y"]
        if self.output is not None:
            state, high = filtered(self.output.b_high, self.output.a, run["output"], high)
            run = {**run, "output": state}
        return run, self.low.values(run)[0][0] + high

    def _of_low(self, u: Array) -> Array:
        """Return the slow network's inputs: of the samples or, `at_once`, of the steps."""
        return self._rows(u) if self.low.at_once else u


class SplitModel(Model):
    """The sum of a network per band (paper, Sec. 4.2): "split GRU" and "split GRU + HP".

    The slow network simulates the low-passed, down-sampled signal. Its up-sampled free run is added
    to the free run of the fast network. The paper has no conditioning.

    A simulation filters its warm-up alone (paper, Eq. 11, prediction): no prediction depends on
    later samples through the zero-phase filter. The ends of a short filtered stretch differ from
    the same samples of the filtered record, on which the paper trains (Eq. 10, training); with
    `own_warmup`, networks are trained on the same beginnings as in simulation.

    Known inputs act on no earlier sample: the slow network's step from n to n + k uses the mean of
    the k inputs up to n, with feedthrough and k = 1 also the next input.

    networks : The slow one and the fast one.
    pair : Filters of the bands.
    downsampling : k: the slow network runs on every k-th sample.
    filter_output : High-pass the fast network's output too, the paper's "+HP"; with known inputs
        one way only.
    conditioned : The slow network's prediction of the low band, value and slope by channel, is an
        input of the fast network: 2 ny additional inputs.
    feedthrough : As for `Recurrent`, for networks at the full rate.
    own_warmup : Filter the warm-ups of training windows one by one; the high band is then y - L(y),
        so that both bands add up to the record at its ends, too. Otherwise windows are cut from
        L(y) and H(y) of the whole training record (paper, Eq. 10, training).
    alignment : Of the up-sampled low band, see `upsample`; `"paper"` shifts it in time.

    Raises
    ------
    ValueError
        For a down-sampling against the Nyquist condition.
    """

    steps = SteppedSplit
    slope_scale: Tensor

    def __init__(  # noqa: PLR0913
        self,
        networks: Sequence[Cell],
        pair: ComplementaryPair,
        downsampling: int = 2,
        filter_output: bool = False,
        conditioned: bool = False,
        feedthrough: bool = False,
        own_warmup: bool = True,
        alignment: Alignment = "time",
    ) -> None:
        slow, fast = networks
        super().__init__(slow.ny, inputs_of(slow, 0, feedthrough and downsampling == 1))
        self.pair, self.downsampling = pair, downsampling
        self.networks = nn.ModuleList([as_module(slow), as_module(fast)])
        self.filter_output, self.conditioned = filter_output, conditioned
        self.feedthrough, self.own_warmup, self.alignment = feedthrough, own_warmup, alignment
        self.register_buffer("slope_scale", torch.ones(1, self.ny, dtype=torch.float64))
        if pair.cutoff is not None:
            check_downsampling(downsampling, pair.cutoff, pair.sampling_rate)

    @property
    def slow(self) -> Cell:
        """Return the network of the low band."""
        return self.networks[0]  # type: ignore[return-value]

    @property
    def fast(self) -> Cell:
        """Return the network of the high band."""
        return self.networks[1]  # type: ignore[return-value]

    @property
    def low_band(self) -> LowBand:
        """Return the slow network with its rate."""
        k = self.downsampling
        return LowBand(self.slow, k, self.feedthrough and self.nu > 0 and k == 1)

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return both bands at the full rate (paper, Eq. 11, prediction)."""
        return self.components_of(self._bands(known), steps)

    def components_of(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return both bands at the full rate; `known.y` has the warm-up's bands side by side."""
        # The slope at the last sample needs the next sample.
        low = self.low(known, steps + 1 if self.conditioned and not self.nu else steps)
        return {LOW: low[:, :steps], HIGH: self.high(known, steps, low)}

    def tasks(self, record: Signals) -> list[Task]:
        """Return the tasks of the low and the high band (paper, Eq. 10, training)."""
        bands = self._bands(record)
        low, high = bands.y.split(self.ny, dim=-1)
        known = record if self.own_warmup else bands
        slow, fast = self.networks
        high_passed = self._high_in_training if self.filter_output else None
        return [
            Task(LOW, slow, known, low, self._slow_in_training, self.downsampling),
            Task(HIGH, fast, known, high, self._fast_in_training, output=high_passed),
        ]

    def _bands(self, known: Signals) -> Signals:
        """Return the signals with both bands of `y` side by side, `(..., time, 2 ny)`."""
        low = self.pair.lowpass(known.y)
        high = known.y - low if self.own_warmup else self.pair.highpass(known.y)
        return replace(known, y=torch.cat([low, high], dim=-1))

    def adapt_to(self, records: Sequence[Record], normalize: bool = True) -> None:
        """Set the scaling of signals and slopes from the training records."""
        super().adapt_to(records, normalize)
        if not self.units_kept:
            low = [self.pair.lowpass(self.normalised(record).y) for record in records]
            self.slope_scale[0].copy_(slope_scale(low, driven=self.nu > 0))

    def slow_run(self, known: Signals, steps: int) -> FreeRun:
        """Return the free run of the low band at its rate, the first right after the warm-up."""
        return self.low_band.run(known.y[..., : self.ny], steps, self._of_low(known.u))

    def low(self, known: Signals, steps: int) -> Tensor:
        """Return `steps` samples of the low band at the full rate."""
        low, rows = known.y[..., : self.ny], self._of_low(known.u)
        free = rollout(self.slow, *self.low_band.enough(low, steps, rows))
        return self.low_band.at_full_rate(free, steps, self.alignment)

    def _of_low(self, u: Tensor | None) -> Tensor | None:
        """Return the slow network's inputs by sample or, `at_once`, by step."""
        return self._rows(u) if self.low_band.at_once else u

    def high(self, known: Signals, steps: int, low: Tensor) -> Tensor:
        """Return `steps` samples of the high band, given the low one."""
        return self._filtered(rollout(self.fast, *self._fast_run(known, steps, low)), known)

    def _fast_run(self, known: Signals, steps: int, low: Tensor) -> FreeRun:
        before, history = known.y.split(self.ny, dim=-1)
        u = self._rows(known.u)
        if self.conditioned:
            whole = torch.cat([before, low], dim=1)
            u = concat_inputs(u, conditioning(whole, self.slope_scale[0], driven=self.nu > 0))
        return history, steps, u

    def _filtered(self, fast: Tensor, known: Signals) -> Tensor:
        """Return the fast network's output, high-passed where the model does so."""
        if not self.filter_output:
            return fast
        history = known.y[..., self.ny :]
        # A zero-phase filter would let an input act on earlier samples.
        pair = self.pair.one_way() if self.nu else self.pair
        # The filter begins in the history and has settled at the first prediction.
        return pair.highpass(torch.cat([history, fast], dim=1))[:, history.shape[1] :]

    def _in_training(self, known: Signals) -> Signals:
        """Return the signals of training windows, with both bands."""
        return self._bands(known) if self.own_warmup else known

    def _slow_in_training(self, known: Signals, steps: int) -> FreeRun:
        return self.slow_run(self._in_training(known), steps)

    def _high_in_training(self, fast: Tensor, known: Signals, steps: int) -> Tensor:
        return self._filtered(fast, self._in_training(known))

    def _fast_in_training(self, known: Signals, steps: int) -> FreeRun:
        """Return the free run in the high band, given the low one, which has no gradient."""
        known = self._in_training(known)
        low = known.y[:, :0, : self.ny]
        if self.conditioned:
            # The fast network may be in float64 while the slow one is in float32.
            dtype = next(as_module(self.slow).parameters()).dtype
            with torch.no_grad():
                low = self.low(known.map(lambda signal: signal.to(dtype)), steps).to(low.dtype)
        return self._fast_run(known, steps, low)
