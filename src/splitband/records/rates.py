"""Put signals with time stamps of their own on an even grid: jitter, events, several rates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splitband.records.signals import usual_distance
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.errors import InputError

NEAR = 1.75
"""Steps between two samples at most for values between them: a lost sample leaves two. By eye."""
_OFTEN = 0.9
"""Share of steps up to `NEAR` times the median from which on stamps are regular. By eye."""
_SPARSE = 0.5
"""Share of cells with a value below which a column is slower than the others. Most are empty."""


def own_step(seconds: Array) -> float:
    """Return the usual distance of time stamps in s, with the digits that their jitter allows."""
    steps = np.diff(seconds)
    near = steps[steps <= NEAR * np.median(steps)]
    usual = float(near.mean())
    off = float(np.quantile(np.abs(near - usual), 0.9))
    if off > 0.5 * usual:  # events: nine in ten are near
        usual = max(usual, float(np.quantile(steps, 0.9)) / NEAR)
    doubt = max(0.1 * off, 1e-6 * usual)
    plain = (float(f"{usual:.{digits}g}") for digits in (1, 2, 3, 7))
    return next((each for each in plain if abs(each - usual) <= doubt), usual)


def jitter(seconds: Array, step: float) -> float:
    """Return by what share of the step nine in ten of the steps, gaps aside, are off at most."""
    steps = np.diff(seconds)
    near = steps[steps <= NEAR * step]
    return float(np.quantile(np.abs(near - step), 0.9)) / step if len(near) else 1.0


def is_sparse(x: Array) -> bool:
    """Return whether most cells of a column are empty: it is a slower one, or logged on change."""
    return bool(0 < np.isfinite(x).mean() < _SPARSE)


def regular(known: Flags) -> int:
    """Return every how many rows a column has a value; 0 where the distance varies."""
    usual, apart = usual_distance(known), np.diff(np.flatnonzero(known))
    return usual if len(apart) and np.mean(apart == usual) > 0.8 else 0


def is_smooth(x: Array) -> bool:
    """Return whether the neighbours of a sample tell it twice as well as the one before it does.

    What mostly repeats its last value is a command, also where a sweep makes most of its variance.
    """
    between, steps = x[1:-1] - 0.5 * (x[:-2] + x[2:]), np.diff(x)
    return len(x) > 2 and bool(np.median(np.abs(steps)) > 0 and 2 * np.std(between) < np.std(steps))


@dataclass(frozen=True, eq=False)
class Even:
    """An even grid, and how signals at the times `seconds`, `(rows,)`, are brought onto it.

    `near`: distance of two stamps in s up to which the values between them count as measured.
    """

    seconds: Array
    start: float
    step: float
    samples: int
    near: float

    @property
    def times(self) -> Array:
        """Return the times of the grid in s, `(samples,)`."""
        return np.asarray(self.start + self.step * np.arange(self.samples))

    @classmethod
    def of_rows(cls, rows: int) -> Even:
        """Return the grid of rows that are even."""
        return cls(np.arange(float(rows)), 0.0, 1.0, rows, NEAR)

    @classmethod
    def of(
        cls, seconds: Array, signals: Sequence[Array], inputs: int, step: float, near: float
    ) -> Even:
        """Return a grid for signals, from where the last of them, the inputs, are known.

        It lies where most stamps are, to a tenth of a step where they jitter.
        """
        known = [seconds[np.isfinite(x)] for x in signals]
        begin = max([seconds[0], *(s[0] for s in known[len(known) - inputs :])])
        fastest = max(known, key=len)
        turns = np.exp(2j * np.pi * (fastest % step) / step).mean()
        phase = step * np.round(np.angle(turns) / (2 * np.pi), 1 if abs(turns) < 0.9999 else 6)
        if abs(turns) < 0.3:  # events keep no phase
            phase = seconds[0] % step
        first = np.ceil((begin - phase) / step - 0.5)
        count = int(np.floor((seconds[-1] - phase) / step + 0.5) - first) + 1
        start = float(f"{phase + step * first:.12g}") + 0.0  # no negative zero
        return cls(seconds, start, step, count, near)

    def measured(self, x: Array) -> Array:
        """Return samples interpolated between near neighbours, or beside a sample; otherwise NaN.

        A sample is that of at most one time of the grid that it does not lie near to.
        """
        seen, seconds = np.isfinite(x), self.seconds
        own = np.concatenate([[-np.inf], seconds[seen], [np.inf]])
        at = np.searchsorted(own, self.times + 1e-6 * self.step, side="right")
        before, after = self.times - own[at - 1], own[at] - self.times
        beside = (before <= 0.5 * self.step) | (after < 0.5 * self.step)
        values = np.interp(self.times, seconds[seen], x[seen])
        values = np.where(before <= 1e-6 * self.step, x[seen][np.maximum(at - 2, 0)], values)
        return np.where(beside | (before + after <= self.near), values, np.nan)

    def held(self, x: Array) -> Array:
        """Return a held input: its mean over the step that begins; NaN where it is not known."""
        seen = np.isfinite(x)
        own, x, little = self.seconds[seen], x[seen], 1e-6 * self.step
        begin, unknown = self._begin(own)
        end = self.times + self.step
        first, last = (
            np.maximum(np.searchsorted(own, each, side="right") - 1, 0)
            for each in (begin + little, end - little)
        )
        knots = np.concatenate([own, [max(own[-1], self.times[-1]) + 2 * self.step]])
        integral = np.concatenate([[0.0], np.cumsum(x * np.diff(knots))])
        whole = np.interp(end, knots, integral) - np.interp(begin, knots, integral)
        return np.where(unknown, np.nan, np.where(first == last, x[first], whole / (end - begin)))

    def between(self, x: Array) -> Array:
        """Return an input interpolated between its stamps; NaN where it is not known."""
        seen = np.isfinite(x)
        begin, unknown = self._begin(own := self.seconds[seen])
        return np.where(unknown, np.nan, np.interp(begin, own, x[seen]))

    def _begin(self, own: Array) -> tuple[Array, Flags]:
        """Return from when on an input with these stamps is known, and where it is not known.

        That is the time of the grid, or, at the first stamp and after a hole, a stamp up to half a
        step later, as for `measured`: the value from before the hole is not that of the sample.
        """
        steps = np.diff(own)
        usual = float(np.median(steps)) if len(steps) else np.inf
        often = len(steps) > 0 and np.mean(steps <= NEAR * usual) > _OFTEN
        longest = NEAR * max(usual, self.step) if often else np.inf
        at = np.searchsorted(own, self.times + 1e-6 * self.step, "right")
        own = np.concatenate([[-np.inf], own, [np.inf]])
        age, late = self.times - own[at], own[at + 1] - self.times
        old = (age > longest) | np.isinf(age)
        beside = old & (late <= 0.5 * self.step)
        return np.where(beside, own[at + 1], self.times), old & ~beside


def last_of_each(seconds: Array) -> Flags:
    """Return a mask of the last row of each time; the stamps do not decrease."""
    return np.concatenate([np.diff(seconds) > 0, [True]])


def offset_of(first: Array, x: Array, second: Array, z: Array) -> float:
    """Return what to add to the stamps of the second signal so that it repeats the first, in s."""
    from scipy import optimize, signal  # noqa: PLC0415  where clocks differ

    step = max(own_step(first), own_step(second))

    def evenly(s: Array, values: Array) -> Array:
        even = np.interp(np.arange(s[0], s[-1], step), s, values)
        return np.asarray(even - even.mean())

    one, two = evenly(first, x), evenly(second, z)
    lag = int(signal.correlate(one, two, method="fft").argmax()) - (len(two) - 1)
    rough = first[0] - second[0] + lag * step

    def unlike(offset: float) -> float:
        inside = (second + offset >= first[0]) & (second + offset <= first[-1])
        if inside.sum() < 10:
            return np.inf
        beside = np.interp(second[inside] + offset, first, x)
        return float(np.std(beside - z[inside]) / (np.std(z[inside]) or np.inf))

    bounds = rough - 2 * step, rough + 2 * step
    found = optimize.minimize_scalar(
        unlike, bounds=bounds, method="bounded", options={"xatol": 1e-4 * step}
    )
    if not found.fun < 0.3:
        raise InputError("the column that both files have does not show the offset of their clocks")
    return float(found.x)
