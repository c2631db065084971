"""Say how sure a forecast is: an interval around it for each horizon.

Not in the paper. Forecasts of known samples show how large a method's errors are and how they grow
with the horizon. The horizon of the forecast is usually longer than theirs, and errors of
neighbouring samples are correlated, so that the law of growth is seldom certain. Therefore the
interval averages over several laws, each weighted by how well it explains the errors (Bayesian
model averaging).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.options import saved

Array = npt.NDArray[np.float64]

PRIOR = {"constant": 0.25, "random walk": 0.35, "drift": 0.2, "saturating": 0.2}
"""How probable each growth law is before an error has been seen."""
ONSETS = 2.0 ** np.arange(-10, 3)
"""Horizons at which an error has grown to twice its first variance, in training records."""
SATURATIONS = 2.0 ** np.arange(-5, 0)
"""Horizons over which the growth of a bounded error dies out, in training records."""
FEWEST = 2.0
"""Independent errors that are assumed at least: Student's quantile for one is four times that."""
FARTHEST = 16
"""Of the horizons whose intervals are computed, in training records; straight on from there."""
PARTS, BOUNDED = 4, 1.1
"""A channel is bounded where its variance is at most `BOUNDED` times the mean of `PARTS` parts'
own: what wanders or drifts varies more in the whole than in a part."""


@dataclass(frozen=True)
class Interval:
    """Give the half-widths of the interval around a forecast, by horizon.

    Attributes
    ----------
    horizon : For which they are given, samples after the forecast's first, from 0 on; straight
        lines in between and on from the last two.
    half_width : By horizon and channel, in the record's unit.
    most : By channel: what they cannot exceed where the record is bounded, else None.
    share : Of the samples that should lie inside, 0 to 1.
    """

    horizon: tuple[int, ...]
    half_width: tuple[tuple[float, ...], ...]
    most: tuple[float | None, ...]
    share: float = 0.9

    def widened(self, change: Array) -> Interval:
        """Return it at least as wide as errors of the size of `change` `(time, ny)` call for.

        Their deviation at a horizon is the root of their mean square up to it.
        """
        if not len(change):
            return self
        deviation = np.sqrt(np.cumsum(change**2, axis=0) / np.arange(1, len(change) + 1)[:, None])
        least = _quantile(self.share) * deviation[np.minimum(self.horizon, len(change) - 1)]
        widths = np.maximum(self.half_width, least)
        return replace(self, half_width=tuple(tuple(map(float, row)) for row in widths))

    def half_widths(self, steps: int) -> Array:
        """Return the half-widths of the first `steps` samples of a horizon, `(steps, ny)`."""
        wanted = np.arange(steps)
        beyond = np.maximum(wanted - self.horizon[-1], 0)
        rows = []
        for widths, most in zip(np.transpose(self.half_width), self.most, strict=True):
            slope = (widths[-1] - widths[-2]) / (self.horizon[-1] - self.horizon[-2])
            half = np.interp(wanted, self.horizon, widths) + max(slope, 0.0) * beyond
            rows.append(half if most is None else np.minimum(half, most))
        return np.transpose(rows)

    def coverage(self, errors: Array) -> float:
        """Return the share of errors `(time, ny)` by horizon that lie inside, 0 to 1.

        NaN was not measured and does not count; it is returned where nothing was.
        """
        return _share(self._inside(errors))

    def coverages(self, errors: Array) -> tuple[float, ...]:
        """Return `coverage` of each channel by itself."""
        return tuple(_share(channel) for channel in self._inside(errors).T)

    def _inside(self, errors: Array) -> Array:
        """Return 1 where an error lies inside and 0 where not; NaN stays."""
        inside = abs(errors) <= self.half_widths(len(errors))
        return np.where(np.isnan(errors), np.nan, inside)


def _share(inside: Array) -> float:
    known = inside[~np.isnan(inside)]
    return float(known.mean()) if len(known) else np.nan


@saved
@dataclass(frozen=True, eq=False)
class HeldOut:
    """Keep how far forecasts of known samples were off: the interval of any level follows.

    Attributes
    ----------
    errors : Of forecasts from different samples on, `(time, ny)` each, by horizon; NaN where
        nothing was measured.
    samples : Of the training record.
    largest, deviation, bounded : Of its channels, `(ny,)` each: the largest absolute value, the
        standard deviation, and whether they keep to one level and one spread.
    """

    errors: tuple[Array, ...]
    samples: int
    largest: Array
    deviation: Array
    bounded: npt.NDArray[np.bool_]
    _known: dict[float, Interval] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check what may come from a file."""
        channels = {np.shape(each)[1:] for each in self.errors}
        channels |= {np.shape(each) for each in (self.largest, self.deviation, self.bounded)}
        if len(channels) != 1 or not isinstance(self.samples, int) or self.samples < 1:
            raise ValueError("held-out errors must be those of one record's channels")

    @classmethod
    def of(cls, errors: Sequence[Array], y: Array) -> HeldOut:
        """Return the errors with what counts of the training record.

        Parameters
        ----------
        errors : See the attribute; all of them end with the same sample.
        y : The training record, `(time, ny)`, NaN in gaps.
        """
        known = ~np.isnan(np.concatenate(errors)) if errors else np.empty((0, 1))
        if not known.any(axis=0).all():
            raise ValueError("errors must have a sample at least, in every channel")
        bounded = np.array([_is_bounded(channel) for channel in y.T])
        return cls(tuple(errors), len(y), np.nanmax(abs(y), axis=0), np.nanstd(y, axis=0), bounded)

    def interval(self, share: float) -> Interval:
        """Return the interval that should hold `share` of the samples, 0 to 1; found once."""
        if share not in self._known:
            self._known[share] = self._interval(share)
        return self._known[share]

    def _interval(self, share: float) -> Interval:
        if not 0 < share < 1:
            raise ValueError(f"share must lie between 0 and 1, got {share}")
        points = 12 * int(np.ceil(np.log10(self.samples))) + 16
        horizon = np.unique(np.round(np.geomspace(1, FARTHEST * self.samples, points))) - 1
        # Rounding errors remain even where a forecast is exact.
        floor = 16 * np.finfo(np.float64).eps * self.largest
        of_channels = [
            np.maximum(
                _half_widths([e[:, i] for e in self.errors], self.samples, horizon, share), least
            )
            for i, least in enumerate(floor)
        ]
        # The difference of two independent signals of the same deviation is this much wider.
        apart = float(np.sqrt(2)) * _quantile(share)
        most = tuple(
            max(apart * float(deviation), widths[0]) if bounded else None
            for deviation, bounded, widths in zip(
                self.deviation, self.bounded, of_channels, strict=True
            )
        )
        half_width = tuple(tuple(map(float, row)) for row in np.transpose(of_channels))
        return Interval(tuple(map(int, horizon)), half_width, most, share)


def _quantile(share: float) -> float:
    """Return the quantile of a normal distribution: +- this many deviations hold `share`."""
    return float(scipy.special.ndtri(0.5 + share / 2))


def _is_bounded(channel: Array) -> bool:
    """Return whether a channel `(time,)` keeps to one level and spread; NaN was not measured."""
    parts = [part[~np.isnan(part)] for part in np.array_split(channel, PARTS)]
    within = [float(np.var(part)) for part in parts if len(part)]
    return float(np.nanvar(channel)) <= BOUNDED * float(np.mean(within))


def _growth(horizon: Array) -> tuple[Array, Array]:
    """Return how large errors are at a horizon (in training records), over their first size.

    One row for each law, and the logarithm of its prior probability. A random walk's variance
    grows by the horizon, a drift's by its square, a saturating one's by
    1 - exp(-horizon / saturation), as that of an autoregressive process does.
    """
    onset = ONSETS[:, None]
    variances = {
        "constant": np.ones((1, len(horizon))),
        "random walk": 1 + horizon / onset,
        "drift": 1 + (horizon / onset) ** 2,
        "saturating": np.concatenate(
            [1 + t / onset * (1 - np.exp(-horizon / t)) for t in SATURATIONS]
        ),
    }
    prior = [np.full(len(rows), PRIOR[law] / len(rows)) for law, rows in variances.items()]
    return np.sqrt(np.concatenate([*variances.values()])), np.log(np.concatenate(prior))


def _half_widths(errors: Sequence[Array], train: int, horizon: Array, share: float) -> Array:
    """Return the half-widths of one channel at each `horizon` `(n,)`, from its errors `(time,)`."""
    known = [np.flatnonzero(~np.isnan(of_one)) for of_one in errors]
    sizes = abs(np.concatenate([e[at] for e, at in zip(errors, known, strict=True)]))
    if not sizes.any():
        return np.zeros(len(horizon))
    at = np.concatenate(known)
    weights, independent = _information(errors)
    growth, log_prior = _growth((at + 1) / train)
    scaled = sizes / growth
    # Laplace's distribution, so that a few large errors do not decide; its scale is the most likely
    # one for each law.
    enough = weights.sum()
    log_likelihood = -np.log(growth) @ weights - enough * np.log(scaled @ weights / enough)
    posterior = scipy.special.softmax(log_prior + log_likelihood)
    # A few errors may all be small by chance. Student's quantile allows for that, the normal one
    # does not.
    normal = _quantile(share)
    student = scipy.special.stdtrit(max(independent, FEWEST), 0.5 + share / 2)
    deviation = np.quantile(scaled, share, axis=1) / normal * float(student) / normal
    ahead = deviation[:, None] * _growth((horizon + 1) / train)[0]
    return _mixture_quantile(posterior, ahead, share)


def _information(errors: Sequence[Array]) -> tuple[Array, float]:
    """Return what each known error is worth, and how many independent ones there are in all.

    Forecasts from different samples on overlap and share what they have in common, and errors of
    neighbouring samples are alike: `independent` is the number of distinct samples over the
    autocorrelation time. A growth law is told by errors at horizons far apart, which add something
    even so: those of one forecast between a horizon and twice that are worth one independent error
    at least.
    """
    octaves = [np.log2(np.arange(len(e)) + 1).astype(int) for e in errors]
    known = [~np.isnan(e) for e in errors]
    octave = np.concatenate(octaves)
    filled = np.nan_to_num(np.concatenate(errors))
    count = np.bincount(octave, np.concatenate(known))
    mean_square = np.bincount(octave, filled**2) / np.maximum(count, 1)
    size = np.sqrt(np.where(mean_square > 0, mean_square, 1.0))
    time = _autocorrelation_time(
        [np.nan_to_num(e) / size[o] for e, o in zip(errors, octaves, strict=True)]
    )
    distinct = max(k.sum() for k in known) / sum(k.sum() for k in known)
    worth = [
        np.maximum(1 / time, 1 / np.maximum(np.bincount(o, k), 1)[o])[k]
        for k, o in zip(known, octaves, strict=True)
    ]
    return distinct * np.concatenate(worth), max(k.sum() for k in known) / time


def _autocorrelation_time(errors: Sequence[Array]) -> float:
    """Return samples that count as one: 1 + twice the sum of the autocorrelation, or of its square.

    The first, up to its first zero, is for errors that keep their sign. The second is for those
    that keep their size while the sign changes, as where a phase is off: the squares of Gaussian
    errors, which tell their size, have that autocorrelation. The larger one counts. About zero,
    not about the mean: an offset is one error, however many samples show it.
    """
    most = max(map(len, errors))
    products = np.zeros(most)
    for of_one in errors:
        correlated = scipy.signal.correlate(of_one, of_one, mode="full", method="fft")
        products[: len(of_one)] += correlated[len(of_one) - 1 :]
    correlation = products / products[0]
    until = int(np.argmax(np.append(correlation, -1.0) < 0))
    return float(1 + 2 * max(correlation[1:until].sum(), (correlation[1:] ** 2).sum()))


def _mixture_quantile(posterior: Array, deviation: Array, share: float) -> Array:
    """Return what holds `share` of normal errors of deviations `(law, n)`, by bisection, `(n,)`.

    Laws of a probability below 1e-6 are left out.
    """
    probable = posterior > 1e-6
    posterior, deviation = posterior[probable], deviation[probable]
    low, high = np.zeros(deviation.shape[1]), 2 * _quantile(share) * deviation.max(axis=0)
    for _ in range(50):
        middle = (low + high) / 2
        inside = posterior @ (2 * scipy.special.ndtr(middle / deviation) - 1)
        low, high = np.where(inside < share, middle, low), np.where(inside < share, high, middle)
    return high
