"""Fit sinusoids that may decay and a trend to a record by least squares.

A strong baseline (see `baselines.common`): the free response of a linear system, and its response
to sinusoids, are sums of such sinusoids and of exponentials.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitband.baselines.common import known, recent, units
from splitband.baselines.modes import Modes
from splitband.baselines.trend import Shape, described, find
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

MOST_SINUSOIDS = 10
"""Largest number of sinusoids of a channel by default. By eye."""
STRONG_EVIDENCE = 6.0
"""Margin of the BIC by which decaying sinusoids must be better than undamped ones. Where two
undamped sinusoids beat more slowly than the record is long, decaying ones may be worse by this
margin: the pair describes a decay within the record, but grows again after it. Chosen on the
simulated pendulum (ii), then tested on 360 drawn records (docs/results/rules.md)."""


@saved
@dataclass(frozen=True, eq=False)
class HarmonicRegression:
    """Describe each channel by sinusoids, an offset and a trend; use `HarmonicRegression.fit`.

    Attributes
    ----------
    channels : The sinusoids of each channel.
    begin : Index of the first fitted sample, from which on they decay.
    """

    channels: tuple[Modes, ...]
    begin: int = 0

    @classmethod
    def fit(cls, y: Array, sinusoids: int | None = None, damped: bool = True) -> HarmonicRegression:
        """Fit `y` `(time, ny)`, each channel separately, NaN in gaps.

        A trend is kept if it lowers the held-out error (`trend.find`). Sinusoids are added one by
        one at the peak of the residual's spectrum, and all are then refined by least squares. By
        default the Bayesian information criterion (BIC) sets their number, at most
        `MOST_SINUSOIDS`. With `damped`, they may decay like free vibrations of a driven system, if
        the BIC improves. The last `common.LONGEST` samples of a long record are fitted.
        """
        begin, y = recent(y)
        return cls(tuple(_fit_channel(channel, sinusoids, damped) for channel in y.T), begin)

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples from `start` on, `(steps, ny)`."""
        index = start - self.begin + np.arange(steps)
        return np.stack([modes.predict(index) for modes in self.channels], axis=1)

    def __str__(self) -> str:
        counts = "+".join(str(len(modes.frequencies)) for modes in self.channels)
        decaying = sum(int((modes.dampings > 0).sum()) for modes in self.channels)
        some = f", {decaying} of them decaying," if decaying else ""
        trends = described([modes.shape for modes in self.channels])
        return f"{counts} sinusoid{'s' * (counts != '1')}{some} and an offset{trends}"


def _fit_channel(y: Array, sinusoids: int | None, damped: bool) -> Modes:
    """Fit one channel, scaled to its range, and return the result in its units."""
    offset, scale = units(y)
    scaled = (y - offset) / scale
    trend = find(scaled)
    shape = trend.shape if trend else None
    best = _greedy(scaled, sinusoids, 0.0, shape)
    if damped and (best.beat_slowly or not best.exact(scaled)):
        decaying = _sustained(_greedy(scaled, sinusoids, 0.3 / len(y), shape), scaled)
        needed = -STRONG_EVIDENCE if best.beat_slowly else STRONG_EVIDENCE
        if best.information(scaled) - decaying.information(scaled) > needed:
            best = decaying
    return best.in_units(offset, scale)


def _greedy(y: Array, sinusoids: int | None, damping: float, shape: Shape | None) -> Modes:
    """Add sinusoids one by one, each with the initial `damping`; zero stays zero."""
    n = len(known(y))
    most = min(
        MOST_SINUSOIDS if sinusoids is None else sinusoids, max((n - 2) // (4 if damping else 3), 0)
    )
    modes = best = Modes.none(y, shape).refined(y)
    for _ in range(most):
        if sinusoids is None and modes.exact(y):
            break
        modes = modes.with_another(y, damping)
        if sinusoids is not None or modes.information(y) < best.information(y):
            best = modes
    return best


def _sustained(modes: Modes, y: Array) -> Modes:
    """Set each damping to zero if that lowers the BIC, the slowest decay first."""
    for i in np.argsort(modes.dampings):
        kept = np.where(np.arange(len(modes.dampings)) == i, 0.0, modes.dampings)
        without = modes._replace(dampings=kept).refined(y)
        if without.information(y) < modes.information(y):
            modes = without
    return modes
