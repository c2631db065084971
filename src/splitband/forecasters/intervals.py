"""Calibrate an interval around a forecast, whose width depends on the horizon.

Not in the paper. The method is split conformal prediction (J. Lei et al., 2018): the half-width is
a quantile of the errors of held-out forecasts. As errors grow with the horizon, they are divided by
a power of it first (a normalised score: V. Vovk et al., 2005). Correlated errors, as those of
neighbouring samples are, count as few independent ones, and few errors mean a wider interval:
Student's quantile for their number widens it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy

from splitband.forecasters.prediction import Prediction
from splitband.runtime.arrays import Array, Flags, check_shape
from splitband.runtime.errors import InputError

EXPONENTS = np.linspace(0, 1, 11)
"""Candidate exponents of the growth of errors with the horizon, from 0 (constant) to 1 (a drift).
Power laws were chosen among laws of growth on 44 development records (docs/developers/rules.md)."""
FEWEST = 2.0
"""Smallest number of independent errors that is assumed; with 1, Student's quantile would be
twice as large. By eye."""
CHANCE, SLACK = 0.05, 0.3
"""An interval is narrow or wide where so many samples outside, or so few, have less than this
chance (a convention), and where their number is off by more than this share of those that may be
outside, below which it matters little: by eye."""
PARTS, BOUNDED = 4, 1.1
"""A signal that does not wander is bounded: its variance is at most `BOUNDED` times the mean
variance of its `PARTS` parts. One that wanders varies more as a whole than in a part. By eye; the
limit for bounded channels makes intervals narrower on development records
(docs/developers/rules.md)."""


Misfit = Literal["", "narrow", "wide"]
"""How an interval does not fit errors; empty where it may."""


@dataclass(frozen=True)
class Interval:
    """Hold the half-widths of the interval around a forecast: `first * horizon ** exponent`.

    first : By channel: half-width at the first forecast sample, in the record's unit.
    exponent : By channel.
    most : By channel: upper limit of the half-width if the channel is bounded, else None.
    share : Of the samples that should lie inside, 0 to 1: the `level` of a prediction.
    """

    first: tuple[float, ...]
    exponent: tuple[float, ...]
    most: tuple[float | None, ...]
    share: float = 0.9

    def widened(self, size: Array) -> Interval:
        """Return it as wide, on average, as normal errors of this RMS `(time, ny)` need."""
        if not len(size):
            return self
        needed = _quantile(self.share) * np.sqrt(np.mean(size**2, axis=0))
        first = np.maximum(self.first, needed / self._growth(len(size)).mean(axis=0))
        return replace(self, first=tuple(map(float, first)))

    def half_widths(self, steps: int) -> Array:
        """Return the half-widths at the first `steps` samples of a forecast, `(steps, ny)`."""
        most = [np.inf if most is None else most for most in self.most]
        return np.minimum(self._growth(steps) * self.first, most)

    def around(self, prediction: Prediction) -> Prediction:
        """Return the prediction with this interval."""
        y, half = prediction.y, self.half_widths(len(prediction))
        return replace(prediction, lower=y - half, upper=y + half, level=self.share)

    def _growth(self, steps: int) -> Array:
        """Return the half-widths divided by the first one, `(steps, ny)`, without the limit."""
        return np.asarray(np.arange(1.0, steps + 1)[:, None] ** np.array(self.exponent))

    def coverage(self, *errors: Array) -> float:
        """Return the share of measured errors of forecasts that lie inside, 0 to 1.

        `errors` : Of each forecast, by horizon, `(time, ny)`.
        """
        return _share(*self._inside(errors))

    def coverages(self, *errors: Array) -> tuple[float, ...]:
        """Return the coverage of each channel."""
        inside, every = self._inside(errors)
        return tuple(map(_share, inside.T, every.T))

    def _inside(self, errors: Sequence[Array]) -> tuple[Flags, Array]:
        """Return which errors lie inside, and the errors, of all forecasts together."""
        inside = [abs(each) <= self.half_widths(len(each)) for each in errors]
        return np.concatenate(inside), np.concatenate(errors)

    def misfits(self, *errors: Array, distinct: int | None = None) -> tuple[Misfit, ...]:
        """Return whether the interval is too narrow or too wide for errors, for each channel.

        Correlated errors count as fewer: their number over the autocorrelation time of their sizes.
        `distinct` : See `HeldOut`.
        """
        every = [abs(each) / self.half_widths(len(each)) for each in errors]
        sizes = np.concatenate(every)
        found = list[Misfit]()
        for i, coverage in enumerate(self.coverages(*errors)):
            known = ~np.isnan(sizes[:, i])
            mean = sizes[known, i].mean() if known.any() else 0.0
            spread = [each[:, i] - mean for each in every]
            varies = any(each[~np.isnan(each)].any() for each in spread)
            independent = _independent(spread, distinct) if varies else FEWEST
            count, outside = max(independent, FEWEST), 1 - self.share
            excess, at = (1 - coverage) / outside - 1, count * (1 - coverage)
            few = scipy.special.betainc(count - at, at + 1, self.share)  # binomial distributions
            many = scipy.special.betainc(at, count - at + 1, outside) if at else 1.0
            narrow, wide = many < CHANCE and excess > SLACK, few < CHANCE and excess < -SLACK
            found.append("narrow" if narrow else "wide" if wide else "")
        return tuple(found)


def _share(inside: Flags, errors: Array) -> float:
    known = inside[~np.isnan(errors)]
    return float(known.mean()) if len(known) else np.nan


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Hold the errors of held-out forecasts, from which the interval of any level follows.

    errors : Of forecasts from several origins, `(time, ny)` each, by horizon; NaN where nothing was
        measured.
    largest, deviation, bounded : By channel, `(ny,)` each: the largest absolute value, the standard
        deviation over the training record, and whether it does not wander there (see `BOUNDED`).
    distinct : Number of distinct samples of forecasts from many origins, all as long, which
        overlap or leave some out; None for forecasts that all end with the longest one.
    doubt : RMS by horizon, `(time, ny)`, of what is known to be uncertain beside these errors: the
        interval is at least as wide as it requires. None without.
    """

    errors: tuple[Array, ...]
    largest: Array
    deviation: Array
    bounded: Flags
    doubt: Array | None = None
    distinct: int | None = None
    _known: dict[float, Interval] = field(default_factory=dict, init=False, repr=False)

    def check(self, ny: int) -> None:
        """Raise ValueError unless they are of `ny` channels."""
        for each in (*self.errors, *([] if self.doubt is None else [self.doubt])):
            check_shape("held-out errors", each, None, ny)
        for name in ("largest", "deviation", "bounded"):
            check_shape(name, vars(self)[name], ny)

    @property
    def ahead(self) -> int | None:
        """Return the length of forecasts from many origins; None for others."""
        return None if self.distinct is None else len(self.errors[0])

    @classmethod
    def of(cls, errors: Sequence[Array], y: Array, distinct: int | None = None) -> HeldOut:
        """Return errors with statistics of the training record `y`."""
        known = ~np.isnan(np.concatenate(errors)) if errors else np.empty((0, 1))
        if not known.any(axis=0).all():
            raise InputError("errors must have a sample at least, in every channel")
        bounded = np.array([_is_bounded(channel) for channel in y.T])
        largest, deviation = np.nanmax(abs(y), axis=0), np.nanstd(y, axis=0)
        return cls(tuple(errors), largest, deviation, bounded, distinct=distinct)

    def interval(self, share: float) -> Interval:
        """Return the interval that should hold `share` of the samples, 0 to 1; it is cached."""
        if not 0 < share < 1:
            raise InputError(f"share must lie between 0 and 1, got {share}")
        if share in self._known:
            return self._known[share]
        # Rounding errors remain even where a forecast is exact.
        least = 16 * np.finfo(np.float64).eps * self.largest
        by_channel = [[e[:, i] for e in self.errors] for i in range(len(least))]
        laws = [_law(errors, share, self.distinct) for errors in by_channel]
        first = [max(size, float(floor)) for (size, _), floor in zip(laws, least, strict=True)]
        # Without skill the error is the difference of two independent signals: sqrt(2) times wider.
        without_skill = np.sqrt(2) * _quantile(share) * self.deviation
        most = tuple(
            max(float(limit), size) if bounded else None
            for limit, size, bounded in zip(without_skill, first, self.bounded, strict=True)
        )
        found = Interval(tuple(first), tuple(exponent for _, exponent in laws), most, share)
        self._known[share] = found if self.doubt is None else found.widened(self.doubt)
        return self._known[share]

    def around_mean(self, share: float) -> Array:
        """Return half-widths `(ny,)` around the mean: as wide an interval says nothing."""
        return np.asarray(_quantile(share) * self.deviation)


def _quantile(share: float) -> float:
    """Return the number of standard deviations of a normal distribution that hold `share`."""
    return float(scipy.special.ndtri(0.5 + share / 2))


def _is_bounded(channel: Array) -> bool:
    """Return whether a channel `(time,)`, NaN in gaps, does not wander (see `BOUNDED`)."""
    parts = [part[~np.isnan(part)] for part in np.array_split(channel, PARTS)]
    within = [float(np.var(part)) for part in parts if len(part)]
    return float(np.nanvar(channel)) <= BOUNDED * float(np.mean(within))


def _law(errors: Sequence[Array], share: float, distinct: int | None) -> tuple[float, float]:
    """Return the first half-width and the exponent of one channel, from its errors `(time,)`.

    The exponent a maximises the likelihood of errors e at horizons h with Laplace's distribution of
    scale b h^a, which is robust to a few large errors. The likeliest b is the mean of |e| / h^a,
    and with it the likeliest a minimises a mean(log h) + log(mean(|e| / h^a)).
    """
    known = [np.flatnonzero(~np.isnan(of_one)) for of_one in errors]
    sizes = abs(np.concatenate([e[at] for e, at in zip(errors, known, strict=True)]))
    if not sizes.any():
        return 0.0, 0.0
    horizon = np.log(np.concatenate(known) + 1.0)
    unlikely = [
        a * horizon.mean() + np.log(np.mean(sizes * np.exp(-a * horizon))) for a in EXPONENTS
    ]
    exponent = float(EXPONENTS[np.argmin(unlikely)])
    independent = _independent(errors, distinct)
    # Few errors may all be small by chance; Student's quantile allows for that.
    student = float(scipy.special.stdtrit(max(independent, FEWEST), 0.5 + share / 2))
    score = float(np.quantile(sizes * np.exp(-exponent * horizon), share))
    return score * student / _quantile(share), exponent


def _independent(errors: Sequence[Array], distinct: int | None) -> float:
    """Return how many independent errors there are in those of several forecasts, `(time,)` each.

    Forecasts overlap, and each sample counts once: those of the longest one, or the `distinct` ones
    of forecasts that are all as long.
    """
    known, longest = max(int((~np.isnan(e)).sum()) for e in errors), max(map(len, errors))
    once = 1.0 if distinct is None else distinct / longest
    return float(once * known / _autocorrelation_time(errors))


def _autocorrelation_time(errors: Sequence[Array]) -> float:
    """Return the number of samples per independent one: 1 + twice the sum of the autocorrelation.

    The sum ends at the first zero. The mean is not removed: an offset counts as one error, however
    many samples show it.
    """
    products = np.zeros(max(map(len, errors)))
    for of_one in map(np.nan_to_num, errors):
        correlated = scipy.signal.correlate(of_one, of_one, mode="full", method="fft")
        products[: len(of_one)] += correlated[len(of_one) - 1 :]
    correlation = products / products[0]
    until = int(np.argmax(np.append(correlation, -1.0) < 0))
    return float(1 + 2 * correlation[1:until].sum())
