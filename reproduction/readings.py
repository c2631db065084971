"""Readings of the paper's text on system (i): what a run may have done where the text is open."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from reproduction.settings import LEARNING_BASED, in_hz
from splitband.data import Record
from splitband.data.named import double_mass_spring
from splitband.filters import ComplementaryPair
from splitband.filters.resampling import Alignment

Array = npt.NDArray[np.float64]
COLUMN = LEARNING_BASED["i"]
Start = Literal["odd", "zeros"]


@dataclass(frozen=True)
class Filtering:
    """How the training signal is split into its bands.

    Attributes
    ----------
    cutoff : w, in the unit of the paper's table.
    start : Of the filters at both ends: `"odd"` as in SciPy, `"zeros"` as in torchaudio.
    clamp : Whether what is filtered is cut off at -1 and 1, torchaudio's default.
    remainder : The high band is y - L(y), otherwise H(y).
    samples : How many are filtered at once; the training part, or the whole record.
    own_warmup : Each warm-up is filtered by itself, as the package does.
    """

    cutoff: float = COLUMN.cutoff
    start: Start = "odd"
    clamp: bool = False
    remainder: bool = True
    samples: int = COLUMN.train
    own_warmup: bool = False

    def pair(self, sampling_rate: float) -> ComplementaryPair:
        """Return the two filters."""
        cutoff = in_hz(self.cutoff, sampling_rate)
        return ComplementaryPair.butterworth(
            cutoff, sampling_rate, COLUMN.order, zero_phase=True, start=self.start
        )

    def bands(self, record: Record, samples: int | None = None) -> Record:
        """Return the low and the high band of the first `samples` as a record of two channels."""
        pair, y = self.pair(record.sampling_rate), record.y[: samples or self.samples]
        low = self._clamped(pair.lowpass(y))
        high = y - low if self.remainder else self._clamped(pair.highpass(y))
        return Record(np.hstack([low, high]), record.sampling_time, columns=("low", "high"))

    def _clamped(self, y: Array) -> Array:
        return np.clip(y, -1.0, 1.0) if self.clamp else y


@dataclass(frozen=True)
class Resampling:
    """How the low band is down-sampled and up-sampled.

    Attributes
    ----------
    k : The factor.
    mean : A sample of the low band is the mean of k, otherwise the first of them.
    align : Of the up-sampling; `"paper"` is torch's `align_corners=False`, which is where the means
        lie, and half a sample late for every k-th sample of k = 2.
    """

    k: int = COLUMN.downsampling
    mean: bool = False
    align: Alignment = "time"


@dataclass(frozen=True)
class Training:
    """How the networks are trained.

    Attributes
    ----------
    summed : One loss of the sum of both bands, otherwise one of each.
    low_warmup : The low band warms up on so many times the paper's samples; the free run begins
        after them.
    twice : The last sample of the warm-up is fed twice, as in the authors' later code.
    weights : Initial ones: torch's, orthogonal ones onto the state, or torch's with zero biases.
    fixed : What is the same in all runs: nothing, the initial weights, or the order of windows.
    changes : Of the paper's settings.
    """

    summed: bool = False
    low_warmup: int = 1
    twice: bool = False
    weights: Literal["torch", "orthogonal", "zero biases"] = "torch"
    fixed: Literal["", "weights", "order"] = ""
    changes: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Reading:
    """One way to read what the paper says of system (i).

    Attributes
    ----------
    variance : Of the noise.
    large_low : GRU 1, the larger network, has the low band.
    hp_alone : "+HP" filters the prediction without its history in front.
    filtering, resampling, training : See there.
    """

    variance: float = 0.01
    large_low: bool = False
    hp_alone: bool = False
    filtering: Filtering = Filtering()
    resampling: Resampling = Resampling()
    training: Training = Training()

    def record(self, draw: int) -> Record:
        """Return system (i) with a draw of the noise."""
        return double_mass_spring(noise_variance=self.variance, seed=draw)


def _trained(**changes: Any) -> Reading:
    return Reading(training=Training(**changes))


def _filtered(**changes: Any) -> Reading:
    return Reading(filtering=Filtering(**changes))


BASE = "nearest"
"""Noise of deviation 0.1 and not of variance 0.1, and the training signal filtered as a whole."""

_TORCHAUDIO = Filtering(start="zeros", clamp=True, remainder=False)
_LETTER = Reading(filtering=_TORCHAUDIO, resampling=Resampling(align="paper"))
_FALLING = {"milestones": ((200, 1e-4),)}
_ONE_CYCLE = {"learning_rate": 1e-2, "one_cycle": True, "clip": 1.0}

PRINTED = "noise of variance 0.1, as printed"
FALLING_RATE = "rate 1e-4 from epoch 200 on"
"""With which the free run's error settles over the epochs."""

READINGS: dict[str, Reading] = {
    BASE: Reading(),
    PRINTED: Reading(variance=0.1),
    "variance 0.1, each warm-up filtered by itself: as in Table 1": Reading(
        0.1, filtering=Filtering(own_warmup=True)
    ),
    "each warm-up filtered by itself": _filtered(own_warmup=True),
    "all 1,000 samples filtered at once": _filtered(samples=1000),
    "high band H(y), not y - L(y)": _filtered(remainder=False),
    "filters start from zero": _filtered(start="zeros", remainder=False),
    "filters start from zero, clamped": Reading(filtering=_TORCHAUDIO),
    "the functions that the text names": _LETTER,
    "the functions that the text names, variance 0.1": replace(_LETTER, variance=0.1),
    "GRU 1 in the low band": Reading(large_low=True),
    "one loss of the sum": _trained(summed=True),
    "low band warmed up on k times as long": _trained(low_warmup=2),
    "last warm-up sample fed twice": _trained(twice=True),
    "up-sampled as torch does": Reading(resampling=Resampling(align="paper")),
    "means of k samples, up-sampled as torch does": Reading(
        resampling=Resampling(mean=True, align="paper")
    ),
    "orthogonal weights": _trained(weights="orthogonal"),
    "zero biases": _trained(weights="zero biases"),
    "the same initial weights in each run": _trained(fixed="weights"),
    "the same order of windows in each run": _trained(fixed="order"),
    FALLING_RATE: _trained(changes=_FALLING),
    "rate 3e-3": _trained(changes={"learning_rate": 3e-3}),
    "one cycle of the rate to 1e-2, clipped": _trained(changes=_ONE_CYCLE),
    "1,000 epochs": _trained(changes={"epochs": 1000}),
    # The rate moves most; so it is put together with others.
    "rate 1e-4 from epoch 200 on, 1e-5 from 250 on": _trained(
        changes={"milestones": ((200, 1e-4), (250, 1e-5))}
    ),
    "rate 1e-4 from epoch 100 on": _trained(changes={"milestones": ((100, 1e-4),)}),
    "rate 1e-4 from 200 on, low band warmed up on k times as long": _trained(
        low_warmup=2, changes=_FALLING
    ),
    "rate 1e-4 from 200 on, variance 0.1": Reading(0.1, training=Training(changes=_FALLING)),
    "rate 1e-4 from 200 on, the functions that the text names": replace(
        _LETTER, training=Training(changes=_FALLING)
    ),
    "rate 1e-4 from 200 on, GRU 1 in the low band": Reading(
        large_low=True, training=Training(changes=_FALLING)
    ),
}
"""Of split GRU, each differing from the first in what it says."""

GRU_READINGS: dict[str, Reading] = {
    "300 epochs": _trained(changes={"epochs": 300}),
    PRINTED: Reading(variance=0.1),
    "2,000 epochs, rate 1e-4 from 1,500 on": _trained(changes={"milestones": ((1500, 1e-4),)}),
    "2,000 epochs, the same initial weights": _trained(fixed="weights"),
    "2,000 epochs, the same order of windows": _trained(fixed="order"),
}
"""Of the single GRU."""

HP_READINGS: dict[str, Reading] = {
    "prediction filtered alone": Reading(hp_alone=True),
    FALLING_RATE: _trained(changes=_FALLING),
    "the functions that the text names": replace(_LETTER, hp_alone=True),
}
"""Of split GRU with its output filtered."""

_VARIED: dict[str, Reading] = {
    **{f"w = {w:g}": _filtered(cutoff=w) for w in (0.2, 0.5)},
    **{f"k = {k}": Reading(resampling=Resampling(k=k)) for k in (5, 10)},
}
ABLATIONS: dict[str, Reading] = _VARIED | {
    f"{name}, {FALLING_RATE}": replace(reading, training=Training(changes=_FALLING))
    for name, reading in _VARIED.items()
}
"""The paper's two ablations; w = 0.4 and k = 2 are the reading itself."""
