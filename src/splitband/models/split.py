"""Define the model of two networks, each on its band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from splitband.data import Record
from splitband.filters import ComplementaryPair
from splitband.filters.resampling import Alignment, check_downsampling, downsample, upsample
from splitband.models.base import (
    Model,
    Signals,
    Task,
    as_module,
    concat_inputs,
    conditioning,
    inputs_of,
    slope_scale,
    with_next_input,
)
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
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import cond

LOW, HIGH = "low band", "high band"


class SteppedSplit(Stepped):
    """Step two networks, each on its band.

    Unless `at_once`, the slow network is one of its steps ahead, and the low band is interpolated
    between its last two samples. That needs no future input, see `models.Split`.
    """

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
        self.slow, self.fast = (SteppedCell(network) for network in model.networks)
        self.k: int = model.downsampling
        self.output = model.pair.one_way() if model.filter_output else None
        self.at_once = self.feedthrough and self.driven and self.k == 1

    def _begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
        k, warmup = self.k, len(y)
        low = both_ways(self.pair, y)
        high = y - low if self.own_warmup else both_ways(self.pair, y, "high")
        means = self._rows(u) if self.at_once else self._means(u, warmup % k)
        run: Run = {"slow": self.slow.begin(low[warmup % k :: k], means[: warmup // k])}
        run["current"] = run["slow"]["y"]
        if not self.at_once:
            run["slow"] = self.slow.advance(run["slow"], means[warmup // k])
        run |= {"phase": np.zeros(()), "sum": np.zeros(len(self.u_mean))}
        given = self._beside(low, run, u)
        run["fast"] = self.fast.begin(high, given)
        if self.output is not None:
            _, run["output"] = one_way(
                self.output.b_high, self.output.a, high, steady(self.output, "high")
            )
        return self._combined(run)

    def _paused(self, y: Array, u: Array, slow: Array) -> Run:
        k, last = self.k, len(y) % self.k
        low = both_ways(self.pair, y)
        high = y - low if self.own_warmup else both_ways(self.pair, y, "high")
        run: Run = {}
        if self.at_once:
            run["slow"], run["current"] = self.slow.paused(low, self._rows(u)), low[-1]
        else:
            means = self._means(np.concatenate([u, u[-1:]]), last)[: len(y) // k]
            run["slow"] = self.slow.begin(low[last::k], means)
            # The straight line to the slow network's next sample meets the low band here.
            run["current"] = k * low[-1] - (k - 1) * run["slow"]["y"]
        run |= {"phase": np.array(k - 1.0), "sum": u[len(u) - (k - 1) :].sum(axis=0)}
        run["fast"] = self.fast.paused(high, self._network_inputs(self._rows(u), low))
        if self.output is not None:
            _, run["output"] = one_way(
                self.output.b_high, self.output.a, high, steady(self.output, "high")
            )
        return run

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        before, run = self._low(run)[0], self._moved(run, u)
        run["fast"] = self.fast.advance(run["fast"], self._beside(before, run, u)[0])
        return self._combined(run)

    def _beside(self, before: Array, run: Run, u: Array) -> Array:
        """Return the inputs of the fast network, after the low band `before`."""
        rows = self._rows(u)
        return self._network_inputs(
            rows, np.concatenate([before, *self._low(run)]) if self.conditioned else before
        )

    def _moved(self, run: Run, u: Array) -> Run:
        """Return the run with the low band advanced by one sample."""
        if self.at_once:
            moved = self.slow.advance(run["slow"], self._rows(u)[0])
            return {**run, "slow": moved, "current": moved["y"]}
        total, phase = run["sum"] + u[1], run["phase"] + 1

        def stepped() -> list[Any]:
            moved = self.slow.advance(run["slow"], total / self.k)
            return [moved, run["slow"]["y"], np.zeros(()), np.zeros(len(self.u_mean))]

        moved, current, phase, total = cond(
            phase >= self.k, stepped, lambda: [run["slow"], run["current"], phase, total]
        )
        return {**run, "slow": moved, "current": current, "phase": phase, "sum": total}

    def _low(self, run: Run) -> list[Array]:
        """Return the low band at the sample to predict and `ahead` later ones, each `(1, ny)`."""
        current = run["current"]
        if self.at_once:
            return [current[None]]
        rise = run["slow"]["y"] - current
        return [(current + rise * ((run["phase"] + i) / self.k))[None]
                for i in range(1 + self.ahead)]  # fmt: skip

    def _combined(self, run: Run) -> tuple[Run, Array]:
        high = run["fast"]["y"]
        if self.output is not None:
            state, high = filtered(self.output.b_high, self.output.a, run["output"], high)
            run = {**run, "output": state}
        return run, self._low(run)[0][0] + high

    def _means(self, u: Array, offset: int) -> Array:
        """Return the mean inputs of the slow steps, see `_mean_before`."""
        before = np.broadcast_to(u[:1], (self.k - 1 - offset, u.shape[1]))
        blocks = np.concatenate([before, u]) if len(before) else u
        return blocks.reshape(len(blocks) // self.k, self.k, u.shape[1]).sum(axis=1) / self.k


class Split(Model):
    """Add two networks, each on its band (paper, Sec. 4.2): "split GRU" and "split GRU + HP".

    The slow network simulates the low-passed, down-sampled signal. Its free run is up-sampled and
    added to that of the fast network. The paper has no conditioning.

    A simulation filters its warm-up alone (paper, Eq. 11, prediction): no prediction depends on
    later samples through the zero-phase filter. The ends of a short filtered stretch differ from
    the same samples of the filtered record, on which the paper trains (Eq. 10, training); with
    `own_warmup`, networks are trained on what they will start from.

    Known inputs act on no sample before them: the slow network's step from n to n + k uses the mean
    of the k inputs up to n, with feedthrough and k = 1 also the next input.

    Parameters
    ----------
    networks : The slow one and the fast one.
    pair : Filters that separate the bands.
    downsampling : k: the slow network sees every k-th sample.
    filter_output : High-pass the fast network's output too, the paper's "+HP"; with known inputs
        one way only.
    conditioned : The low band as the slow network predicts it, value and slope of each channel, is
        an input of the fast network: 2 ny additional inputs.
    feedthrough : As for `Recurrent`, for networks that see every sample.
    own_warmup : Filter the warm-up of each training window alone; the high band is then y - L(y),
        so that both bands add up to the record at its ends, too. Otherwise windows are cut from
        L(y) and H(y) of the whole training record (paper, Eq. 10, training).
    alignment : Of the up-sampled low band, see `upsample`; `"paper"` shifts it in time.

    Raises
    ------
    ValueError
        When the networks' channels do not fit, and when a down-sampled signal cannot carry its band
        (Nyquist).
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
        each = 2 if feedthrough else 1
        of_slow = self.nu * (each if downsampling == 1 else 1)
        wanted = [(self.ny, of_slow), (self.ny, self.nu * each + 2 * self.ny * conditioned)]
        given = [(network.ny, network.nu) for network in networks]
        if given != wanted:
            told = ", with 2 ny inputs for the slow band" if conditioned else ""
            raise InputError(f"the networks' (ny, nu) must be {wanted}{told}, got {given}")
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

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return both bands at the full rate (paper, Eq. 11, prediction)."""
        return self.components_of(self._bands(known), steps)

    def components_of(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return both bands at the full rate; `known.y` has those of the warm-up, side by side."""
        # The slope at the last sample needs the one after it.
        low = self.low(known, steps + 1 if self.conditioned and not self.nu else steps)
        return {LOW: low[:, :steps], HIGH: self.high(known, steps, low)}

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce each band of the record, the slow one first (paper, Eq. 10, training)."""
        bands = self._bands(record)
        low, high = bands.y.split(self.ny, dim=-1)
        known = record if self.own_warmup else bands
        slow, fast = self.networks
        return [
            Task(LOW, slow, known, low, self.slow_in_training, self.downsampling),
            Task(HIGH, fast, known, high, self.high_in_training),
        ]

    def _bands(self, known: Signals) -> Signals:
        """Return the signals with both bands of `y` beside each other, `(..., time, 2 ny)`."""
        low = self.pair.lowpass(known.y)
        high = known.y - low if self.own_warmup else self.pair.highpass(known.y)
        return replace(known, y=torch.cat([low, high], dim=-1))

    def adapt_to(self, records: Sequence[Record], normalize: bool = True) -> None:
        """Set the scaling from the training records, that of the slopes included."""
        super().adapt_to(records, normalize)
        if not self.units_kept:
            low = [self.pair.lowpass(self.normalised(record).y) for record in records]
            self.slope_scale[0].copy_(slope_scale(low, driven=self.nu > 0))

    def slow_run(self, known: Signals, steps: int) -> Tensor:
        """Return `steps` samples of the low band at its rate, the first right after the warm-up."""
        k, u = self.downsampling, known.u
        offset = known.y.shape[1] % k
        if u is not None:
            at_once = self.feedthrough and k == 1
            u = with_next_input(u) if at_once else _mean_before(u, k, offset)
        return rollout(self.slow, downsample(known.y[..., : self.ny], k, offset), steps, u)

    def low(self, known: Signals, steps: int) -> Tensor:
        """Return `steps` samples of the low band at the full rate."""
        k = self.downsampling
        if k == 1:
            return self.slow_run(known, steps)
        # Interpolation needs a sample at or beyond the last one.
        return upsample(self.slow_run(known, (steps - 2) // k + 2), k, steps, self.alignment)

    def high(self, known: Signals, steps: int, low: Tensor) -> Tensor:
        """Return `steps` samples of the high band, given the low one."""
        before, history = known.y.split(self.ny, dim=-1)
        u = self._rows(known.u)
        if self.conditioned:
            whole = torch.cat([before, low], dim=1)
            u = concat_inputs(u, conditioning(whole, self.slope_scale[0], driven=self.nu > 0))
        y = rollout(self.fast, history, steps, u)
        if not self.filter_output:
            return y
        # A zero-phase filter would let an input act on earlier samples.
        pair = self.pair.one_way() if self.nu else self.pair
        # The filter begins in the history, so that it has settled at the first prediction.
        return pair.highpass(torch.cat([history, y], dim=1))[:, history.shape[1] :]

    def slow_in_training(self, known: Signals, steps: int) -> Tensor:
        """Return the low band at its rate after the warm-up of a training window."""
        return self.slow_run(self._bands(known) if self.own_warmup else known, steps)

    def high_in_training(self, known: Signals, steps: int) -> Tensor:
        """Return the high band, given the slow network's low band, without a gradient for that."""
        known = self._bands(known) if self.own_warmup else known
        low = known.y[:, :0, : self.ny]
        if self.conditioned:
            # The fast network may be trained in float64 when the slow one is not.
            dtype = next(as_module(self.slow).parameters()).dtype
            with torch.no_grad():
                low = self.low(known.map(lambda signal: signal.to(dtype)), steps).to(low.dtype)
        return self.high(known, steps, low)


def _mean_before(u: Tensor, k: int, offset: int) -> Tensor:
    """Return the mean of the k inputs up to every k-th sample from `offset` < k on.

    The low band's sample n + k, and with it the interpolation from n on, must not depend on inputs
    after n. Before the first sample, the first input is assumed.
    """
    before = u[:, :1].expand(-1, k - 1 - offset, -1)
    blocks = torch.cat([before, u], dim=1).transpose(1, 2)
    return nn.functional.avg_pool1d(blocks, k).transpose(1, 2)
