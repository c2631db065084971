"""Choose the filter pair from the training samples: cut-off, order and down-sampling.

The paper sets them by hand. No network is trained.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from splitband.filters import Band, ComplementaryPair
from splitband.filters.resampling import check_downsampling
from splitband.filters.spectrum import periodogram
from splitband.metrics import spread
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.errors import InputError

ORDERS = (1, 2)
"""Order 2 is chosen only where order 1 is not acceptable: its held-out errors are no lower, and on
the simulated pendulum (iii) and on (vi) higher (0.31 and 0.17, 0.35 and 0.28)."""
MOST_DOWNSAMPLING = 10
"""Largest down-sampling factor of the low band. Convention: `scipy.signal.decimate` advises a
second stage above 13."""
LEAST_WARMUP = 10
"""Smallest number of warm-up samples of the down-sampled low band. By eye."""
LEAST_PASSED = 0.5
"""Smallest share of the power in the low band. Checked by halving and doubling."""
MOST_LOST = 0.15
"""Largest share of the power lost to the overlap of the bands and to the ends of warm-ups.
By eye."""
MOST_ALIASED = 1e-3
"""Largest share of the power beyond the Nyquist frequency of the down-sampled low band. Checked by
halving and doubling."""
LEFT_BY_NETWORK = 0.02
"""Expected error of a network conditioned on the simulator, as a share of the power. From held-out
errors of hybrids on (v) and (vi), with the simulator in the low band (docs/developers/rules.md)."""
WORTH_USING = 0.5
"""Largest error of a usable simulator in its band, as a share of the power there. By eye."""
_CUTOFFS = 24
"""Number of candidate cut-offs, evenly spaced on a logarithmic scale. Bounds the time."""
_WARMUPS = 40
"""Number of warm-ups over which the error at their ends is averaged. Bounds the time."""
_NYQUIST_MARGIN = 0.8
"""Highest cut-off, as a share of the Nyquist frequency of the down-sampled low band. Convention, of
`scipy.signal.decimate` and MATLAB's `decimate`."""


@dataclass(frozen=True)
class CutoffCandidate:
    """A candidate filter pair.

    cutoff : In Hz.
    order : Of each Butterworth filter.
    downsampling : The largest k for the low band and a warm-up of `LEAST_WARMUP` samples.
    passed : Share of the power after the low-pass filter or, with a simulator, after the filter of
        its band. The filter is not steep: the share on this side of the cut-off differs.
    loss : Criterion, as a share of the power, see `choose` and `choose_with_simulator`.
    """

    cutoff: float
    order: int
    downsampling: int
    passed: float
    loss: float


@dataclass(frozen=True)
class Choice:
    """The chosen filter pair and the reason for it.

    cutoff, order, downsampling : See `CutoffCandidate`.
    reason : Reason of the choice, in words.
    loss : Meaning of `CutoffCandidate.loss`, in words.
    candidates : All candidates, including the chosen one.
    simulator_helps : Whether the simulator's band is usable; None without a simulator.
    """

    cutoff: float
    order: int
    downsampling: int
    reason: str
    loss: str
    candidates: tuple[CutoffCandidate, ...]
    simulator_helps: bool | None = None

    @property
    def expected(self) -> float:
        """Return the loss of the chosen pair."""
        mine = self.cutoff, self.order
        return next(c.loss for c in self.candidates if (c.cutoff, c.order) == mine)


def choose(
    y: Array,
    sampling_rate: float,
    warmup: int,
    cutoff: float | None = None,
    order: int | None = None,
    downsampling: int | None = None,
) -> Choice:
    """Choose the filter pair of a split model, without a simulator.

    The lowest cut-off wins with half of the power in the low band and a loss of at most
    `MOST_LOST`. Power is lost to band overlap (2 |L H|, undistorted in neither band) and to errors
    at the ends of filtered warm-ups. A lower cut-off allows more down-sampling, so that the
    low-band network predicts fewer samples.

    `y` are the training samples; constant channels do not count. Given values of cut-off, order and
    down-sampling are kept. Raises ValueError for constant samples without a given cut-off, and for
    given values against the Nyquist condition.
    """
    y = y[:, _varying(y)]
    spectrum = periodogram(y, sampling_rate)
    power = spectrum.shares()
    candidates = []
    for f, pair in _pairs(y, sampling_rate, warmup, cutoff, order, downsampling):
        gain, _ = pair.response(spectrum.frequencies)
        k = downsampling or _downsampling(power * gain**2, spectrum.frequencies, f, warmup)
        both = float(np.sum(2 * power * gain * (1 - gain)))
        lost = both + _distortion(y, warmup, pair)
        candidates.append(CutoffCandidate(f, pair.order, k, float(np.sum(power * gain**2)), lost))
    able = [c for c in candidates if c.passed >= LEAST_PASSED]
    if good := [c for c in able if c.loss <= MOST_LOST]:
        best = min(good, key=lambda c: (c.order, c.cutoff))
        rule = "lowest acceptable cut-off"
    elif able:
        best = min(able, key=lambda c: c.loss)
        rule = "every cut-off loses much power, this one the least"
    else:
        best = max(candidates, key=lambda c: c.passed)
        rule = "no cut-off leaves half of the power in the low band"
    facts = (
        f"{100 * spectrum.share_below(best.cutoff):.0f} % of the power lies below it, "
        f"{100 * best.loss:.0f} % is lost to band overlap and edge effects"
    )
    reason = f"{'as given' if cutoff is not None else rule}: {facts}"
    loss = "share of the power in both bands, or lost at ends"
    return Choice(best.cutoff, best.order, best.downsampling, reason, loss, tuple(candidates))


def choose_with_simulator(  # noqa: PLR0913
    y: Array,
    y_sim: Array,
    sampling_rate: float,
    warmup: int,
    cutoff: float | None = None,
    order: int | None = None,
    downsampling: int | None = None,
    simulator_band: Band = "low",
) -> Choice:
    """Choose the filter pair of a hybrid model, with the simulator in `simulator_band`.

    The pair minimises the expected error of the hybrid: the simulator's error after its filter,
    plus the network's expected error (`LEFT_BY_NETWORK`) in the other band. Both filters run one
    way, as in the model. A simulator with too large an error in its own band (`WORTH_USING`) is
    better left out.

    Parameters as for `choose`; `y_sim` is aligned with `y`, and calibrated if the model's is.
    """
    varying = _varying(y)
    scale = spread(y)[varying]
    y, wrong = y[:, varying], (y - y_sim)[:, varying] / scale
    spectrum, errors = periodogram(y / scale, sampling_rate), periodogram(wrong, sampling_rate)
    total = float(spectrum.density[1:].sum()) or 1.0
    power, error = (s.density.sum(axis=1) / total for s in (spectrum, errors))
    power[0] = error[0] = 0.0
    below = simulator_band == "low"
    # A high-pass filter removes an offset.
    offset = float(np.mean(wrong.mean(axis=0) ** 2)) if below else 0.0
    candidates, wrongness = [], {}
    for f, pair in _pairs(y, sampling_rate, warmup, cutoff, order, downsampling):
        response = pair.one_way().response(spectrum.frequencies)[0 if below else 1]
        gain, rest = abs(response) ** 2, abs(1 - response) ** 2
        low = power * (gain if below else rest)
        k = downsampling or _downsampling(low, spectrum.frequencies, f, warmup)
        passed, wrong_own = float(np.sum(gain * power)), float(np.sum(gain * error)) + offset
        left = wrong_own + LEFT_BY_NETWORK * float(np.sum(rest * power))
        candidates.append(CutoffCandidate(f, pair.order, k, passed, left))
        wrongness[f, pair.order] = wrong_own / (passed or 1.0)
    lowest = min(c.order for c in candidates)
    best = min((c for c in candidates if c.order == lowest), key=lambda c: c.loss)
    other = min(candidates, key=lambda c: c.loss)
    best = other if other.loss < best.loss / 2 else best
    share = wrongness[best.cutoff, best.order]
    helps = share < WORTH_USING
    rule = "as given" if cutoff is not None else "least expected error"
    side = "up to" if below else "from"
    reason = (
        f"{rule}: {'below' if below else 'above'} {best.cutoff:.3g} Hz the simulator misses "
        f"{100 * share:.0f} % of the power, {'above' if below else 'below'} it a network is "
        f"expected to miss {100 * LEFT_BY_NETWORK:.0f} %"
        if helps
        else f"no band of the simulator is worth using: {side} {best.cutoff:g} Hz it is wrong by "
        f"{100 * share:.0f} % of the power"
    )
    loss, listed = "expected error, as a share of the power", tuple(candidates)
    return Choice(best.cutoff, best.order, best.downsampling, reason, loss, listed, helps)


def _varying(y: Array) -> Flags:
    """Return a mask of the varying channels; all channels if none varies."""
    varying = np.ptp(y, axis=0) > 0
    return varying if varying.any() else ~varying


def _pairs(
    y: Array,
    sampling_rate: float,
    warmup: int,
    cutoff: float | None,
    order: int | None,
    downsampling: int | None,
) -> list[tuple[float, ComplementaryPair]]:
    """Return candidate cut-offs in Hz, from three cycles per record on, and their pairs."""
    orders = [order] if order is not None else [n for n in ORDERS if _shortest(n) <= warmup] or [1]
    design = partial(ComplementaryPair.butterworth, sampling_rate=sampling_rate)
    pairs = [] if cutoff is None else [(cutoff, design(cutoff, order=n)) for n in orders]
    check_downsampling(1 if downsampling is None else downsampling, cutoff or 0.0, sampling_rate)
    if pairs:
        return pairs
    if not np.ptp(y, axis=0).any():
        raise InputError("the training samples are constant: there is no band to split off")
    highest = _NYQUIST_MARGIN * sampling_rate / 2 / (downsampling or 2)
    lowest = min(3 * sampling_rate / len(y), highest / 2)
    cutoffs = [float(f"{value:.3g}") for value in np.geomspace(lowest, highest, _CUTOFFS)]
    for f, n in product(cutoffs, orders):
        # At a low cut-off, rounding makes filters of high order unstable: `design` raises.
        with suppress(ValueError):
            pairs.append((f, design(f, order=n)))
    return pairs or [(cutoffs[-1], design(cutoffs[-1], order=orders[0]))]


def _downsampling(low: Array, frequencies: Array, cutoff: float, warmup: int) -> int:
    """Return the largest k with the cut-off and nearly all power below its Nyquist frequency."""
    nyquist = frequencies[-1]
    for k in range(max(2, min(MOST_DOWNSAMPLING, warmup // LEAST_WARMUP)), 1, -1):
        aliased = float(np.sum(low[frequencies > nyquist / k]))
        if cutoff <= _NYQUIST_MARGIN * nyquist / k and aliased < MOST_ALIASED:
            return k
    return 2 if cutoff <= _NYQUIST_MARGIN * nyquist / 2 else 1


def _shortest(order: int) -> int:
    """Return the minimum number of samples for zero-phase filtering, with its padding."""
    return 3 * (order + 1) + 1


def _distortion(y: Array, warmup: int, pair: ComplementaryPair) -> float:
    """Return the mean squared error at the end of a filtered warm-up, as a share of the power."""
    warmup = max(warmup, _shortest(pair.order))
    if len(y) < warmup:
        return 0.0
    begins = np.unique(np.linspace(0, len(y) - warmup, _WARMUPS).astype(int))
    index = begins[:, None] + np.arange(warmup)
    wrong = (pair.lowpass(y[index]) - pair.lowpass(y)[index])[:, -max(1, warmup // 10) :]
    return float(np.mean((wrong / spread(y)) ** 2))
