"""Define models learned from a record alone: one network, or several on their bands."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import torch
from torch import Tensor, nn

from splitband.data import Record
from splitband.filters import ComplementaryPair
from splitband.filters.resampling import check_downsampling, downsample, upsample
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
from splitband.models.stepping import SteppedRecurrent, SteppedSplit
from splitband.networks import Cell, rollout


class Recurrent(Model):
    """Run one network on the whole band: the baseline (paper, Sec. 4.1).

    Parameters
    ----------
    cell : The network.
    feedthrough : The step to a sample knows the inputs of that sample, too: the cell has twice the
        model's inputs, see `base.with_next_input`. The paper has no inputs.
    """

    def __init__(self, cell: Cell, feedthrough: bool = False) -> None:
        super().__init__(cell.ny, inputs_of(cell, 0, feedthrough))
        self.cell, self.feedthrough = cell, feedthrough

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the network's free run."""
        return {"network": self._simulate(known, steps)}

    def stepped(self) -> SteppedRecurrent:
        """See `Model`."""
        return SteppedRecurrent(self)

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce the record."""
        return [Task("network", as_module(self.cell), record, record.y, self._simulate)]

    def _simulate(self, known: Signals, steps: int) -> Tensor:
        u = with_next_input(known.u) if self.feedthrough and known.u is not None else known.u
        return rollout(self.cell, known.y, steps, u)


class Split(Model):
    """Add networks, each on its band (paper, Sec. 4.2): "split GRU" and "split GRU + HP".

    A network of a slower band lives on the low-passed, down-sampled signal; its free run is
    up-sampled, and those of all bands are added. The paper has two bands and no conditioning.

    The warm-up is filtered by itself, in training as in simulation: a prediction cannot depend on
    later samples through the zero-phase filter, and the networks learn to start from a history
    whose ends are distorted (docs/deviations.md).

    Known inputs act on nothing before them: the step of a slower band from a sample to the next,
    k samples later, knows the inputs up to the former, as the mean of each k.

    Parameters
    ----------
    networks : From the slowest band to the fastest, two at least.
    pairs : Where one band ends and the next begins, by rising cut-off; for two bands just the pair.
    downsampling : k of each band but the fastest: its network sees every k-th sample. One number
        is for all of them.
    filter_output : High-pass the fastest network's output too, the paper's "+HP"; with known inputs
        one way only.
    conditioned : Each network but the slowest receives what the slower bands predict, value and
        slope of each channel, as known inputs behind its own; it has 2 ny more of them.
    feedthrough : As for `Recurrent`, of the networks that see every sample.

    Raises
    ------
    ValueError
        When the numbers of networks, pairs and factors, the networks' channels or the order of
        the cut-offs do not fit, and when a down-sampled signal cannot carry its band (Nyquist).
    """

    slope_scale: Tensor

    def __init__(
        self,
        networks: Sequence[Cell],
        pairs: ComplementaryPair | Sequence[ComplementaryPair],
        downsampling: int | Sequence[int] = 2,
        filter_output: bool = False,
        conditioned: bool = False,
        feedthrough: bool = False,
    ) -> None:
        slower = len(networks) - 1
        if slower < 1:
            raise ValueError(f"networks must be two at least, got {len(networks)}")
        factors = (
            [downsampling] * slower
            if isinstance(downsampling, int)
            else [int(k) for k in downsampling]
        )
        at_once = feedthrough and factors[:1] == [1]  # for a band at the full rate
        super().__init__(networks[0].ny, inputs_of(networks[0], 0, at_once))
        self.networks = nn.ModuleList(as_module(network) for network in networks)
        self.pairs = [pairs] if isinstance(pairs, ComplementaryPair) else [*pairs]
        self.downsampling = factors
        self.filter_output, self.conditioned = filter_output, conditioned
        self.feedthrough = feedthrough
        self.register_buffer("slope_scale", torch.ones(slower, self.ny, dtype=torch.float64))
        if not len(self.pairs) == len(factors) == slower:
            raise ValueError(
                f"{len(networks)} networks need {slower} pair(s) and downsampling factor(s), "
                f"got {len(self.pairs)} and {len(factors)}"
            )
        self._check_channels(networks)
        self._check_bands()

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the bands from slow to fast, each at the full rate (paper, Eq. 13)."""
        return self._bands(len(self.networks), known, steps)

    def tasks(self, record: Signals) -> list[Task]:
        """Reproduce each band of the record, the slowest first (paper, Eq. 12).

        A band is what the low-pass filters of its two ends leave, so that all bands add up to the
        record at its ends too; away from them the fastest is H(y).
        """
        return [
            Task(
                name,
                as_module(self._network(band)),
                record,
                self._band_of(band, record.y),
                partial(self._in_training, band),
                self._factor(band),
            )
            for band, name in enumerate(self._names())
        ]

    def stepped(self) -> SteppedSplit:
        """See `Model`: of two bands, and whose filters need no samples to come."""
        if len(self.pairs) > 1:
            raise ValueError(f"a split model of {len(self.networks)} bands cannot be stepped")
        if self.filter_output and not self.nu and self.pairs[-1].zero_phase:
            raise ValueError(
                "a split model whose output is filtered forwards and backwards cannot be stepped"
            )
        return SteppedSplit(self)

    def adapt_to(self, records: Sequence[Record], normalize: bool = True) -> None:
        """Take the units from the training records, those of the slopes too."""
        super().adapt_to(records, normalize)
        seen = [self.normalised(record).y for record in records]
        for i, pair in enumerate(self.pairs):
            low = [pair.lowpass(y) for y in seen]
            self.slope_scale[i].copy_(slope_scale(low, driven=self.nu > 0))

    def _in_training(self, band: int, known: Signals, steps: int) -> Tensor:
        """Return `steps` samples of a band at its rate, the slower bands being as they are."""
        slower = None
        if self.conditioned and band:
            with torch.no_grad():
                samples = (steps - 1) * self._factor(band) + 1
                slower = _sum(self._bands(band, known, samples))
        return self._simulate(band, known, steps, slower)

    def _bands(self, count: int, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the `count` slowest bands, each at the full rate."""
        lengths = [steps] * count
        for band in range(count - 1, 0, -1):
            lengths[:band] = [max(lengths[band - 1], self._told_for(band, lengths[band]))] * band
        bands: dict[str, Tensor] = {}
        for band, name in enumerate(self._names()[:count]):
            slower = _sum({n: part[:, : lengths[band - 1]] for n, part in bands.items()})
            bands[name] = self._at_full_rate(band, known, lengths[band], slower)
        return {name: part[:, :steps] for name, part in bands.items()}

    def _told_for(self, band: int, steps: int) -> int:
        """Return samples of the slower bands that `steps` samples of a band depend on."""
        if not self.conditioned or self.nu:
            return steps
        # To the last sample of the band, and one more for the slope there.
        k = self._factor(band)
        return ((steps - 2) // k + 1) * k + 2

    def _at_full_rate(self, band: int, known: Signals, steps: int, slower: Tensor | None) -> Tensor:
        k = self._factor(band)
        if k == 1:
            return self._simulate(band, known, steps, slower)
        # Interpolation needs a sample at or beyond the last one.
        return upsample(self._simulate(band, known, (steps - 2) // k + 2, slower), k, length=steps)

    def _simulate(self, band: int, known: Signals, steps: int, slower: Tensor | None) -> Tensor:
        """Return `steps` samples of a band at its rate, the first of them right after the warm-up.

        `slower` is what the slower bands predict from there on, at the full rate.
        """
        k, warmup = self._factor(band), known.y.shape[1]
        offset = warmup % k
        history = self._band_of(band, known.y)
        u = known.u
        if u is not None:
            at_once = self.feedthrough and k == 1
            u = with_next_input(u) if at_once else _mean_before(u, k, offset)
        if self.conditioned and slower is not None:
            whole = torch.cat([self.pairs[band - 1].lowpass(known.y), slower], dim=1)
            scale = self.slope_scale[band - 1]
            given = conditioning(whole, scale, k, offset, driven=self.nu > 0)
            u = concat_inputs(u, given)
        y = rollout(self._network(band), downsample(history, k, offset), steps, u)
        if not self.filter_output or band < len(self.pairs):
            return y
        # Run forward and backward, the filter would let an input act on earlier samples.
        pair = self.pairs[-1].one_way() if self.nu else self.pairs[-1]
        # The filter begins in the history, so that it has settled at the first prediction.
        return pair.highpass(torch.cat([history, y], dim=1))[:, warmup:]

    def _band_of(self, band: int, y: Tensor) -> Tensor:
        """Return the share of a signal that is a band's."""
        upper = self.pairs[band].lowpass(y) if band < len(self.pairs) else y
        return upper - self.pairs[band - 1].lowpass(y) if band else upper

    def _network(self, band: int) -> Cell:
        return self.networks[band]  # type: ignore[return-value]

    def _factor(self, band: int) -> int:
        return self.downsampling[band] if band < len(self.downsampling) else 1

    def _names(self) -> list[str]:
        between = [f"band {i}" for i in range(2, len(self.networks))]
        return ["low band", *between, "high band"]

    def _check_channels(self, networks: Sequence[Cell]) -> None:
        more = 2 * self.ny if self.conditioned else 0
        wanted = [
            (
                self.ny,
                self.nu * (2 if self.feedthrough and self._factor(band) == 1 else 1)
                + (more if band else 0),
            )
            for band in range(len(networks))
        ]
        given = [(network.ny, network.nu) for network in networks]
        if given != wanted:
            raise ValueError(
                f"the networks' (ny, nu) must be {wanted}"
                f"{', with 2 ny inputs for the slower bands' if self.conditioned else ''}, "
                f"got {given}"
            )

    def _check_bands(self) -> None:
        cutoffs = [pair.cutoff for pair in self.pairs if pair.cutoff is not None]
        if any(b <= a for a, b in pairwise(cutoffs)):
            raise ValueError(f"cut-offs must rise from pair to pair, got {cutoffs} Hz")
        for k, pair in zip(self.downsampling, self.pairs, strict=True):
            if pair.cutoff is not None:
                check_downsampling(k, pair.cutoff, pair.sampling_rate)


def _mean_before(u: Tensor, k: int, offset: int) -> Tensor:
    """Return the mean input of the k samples that end with every k-th one from `offset` on.

    A band's sample n + k, and with it what is interpolated from n on, must depend on no input
    after n. Before the first sample the input is taken to have been the same.

    Parameters
    ----------
    u : `(batch, time, nu)`.
    k, offset : The band's down-sampling and first sample, `offset < k`.
    """
    before = u[:, :1].expand(-1, k - 1 - offset, -1)
    blocks = torch.cat([before, u], dim=1).transpose(1, 2)
    return nn.functional.avg_pool1d(blocks, k).transpose(1, 2)


def _sum(parts: dict[str, Tensor]) -> Tensor | None:
    return torch.stack([*parts.values()]).sum(dim=0) if parts else None
