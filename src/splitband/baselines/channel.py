"""Fit the output-error model of one channel: y = (B u + C δ) / A + offset.

The number of poles is chosen on held-out samples (`baselines.origins`). For given poles the other
parameters are linear; the poles are found by the Steiglitz-McBride iteration (1965), then refined.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.common import LONGEST, known, recent, units
from splitband.baselines.origins import is_better, origins
from splitband.baselines.states import States
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError, check
from splitband.runtime.options import saved

ORDERS = (1, 2, 3, 4, 6, 8)
"""Numbers of poles that are tried. By eye; forecasts from rolling origins decide between them."""
ROUNDS = 20
"""Most Steiglitz-McBride iterations; the best denominator is then refined. By eye."""
CONVERGED = 1e-9
"""The iteration ends when no coefficient changes by more than this, far above rounding. By eye."""
FARTHEST_POLE = 0.9999
"""Largest absolute value of a pole: a slower decay can hardly be told from growth. By eye."""
_RANK = 1e-10
"""Singular values below this share of the largest one are rounding errors and are cut."""
_DECAYED_SHARE = 0.1
"""A response to the initial state counts as decayed below this share of its peak. By eye."""


@saved
class Channel(NamedTuple):
    """Hold the model of one channel.

    Attributes
    ----------
    a, b, c, offset : A `(n + 1,)`, B `(nu, n + 1)`, C `(n,)` and the offset of `OutputError`.
    states : States in the training records, in the coordinates of C.
    """

    a: Array
    b: Array
    c: Array
    offset: float
    states: States

    def simulate(self, u: Array) -> Array:
        """Simulate the channel from index 0 on, `(time,)`."""
        forced = sum(scipy.signal.lfilter(b, self.a, x) for b, x in zip(self.b, u.T, strict=True))
        return np.asarray(forced + scipy.signal.lfilter(self.c, self.a, _impulse(u)) + self.offset)

    def canonical(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of the observer canonical form, whose initial state is `c`."""
        n = len(self.a) - 1
        a = np.eye(n, k=1)
        a[:, 0] -= self.a[1:]
        b = (self.b[:, 1:] - self.b[:, :1] * self.a[1:]).T
        return a, b, np.eye(1, n), self.b[:, 0][None]


class _Part(NamedTuple):
    """Hold a part of a record: one channel `(time,)`, NaN in gaps, and the inputs `(time, nu)`."""

    y: Array
    u: Array


def fit_channels(
    records: Sequence[tuple[Array, Array]], most: int | None = None
) -> tuple[Channel, ...]:
    """Fit a model with at most `most` poles to each channel.

    `records` holds `y` and the normalised `u` of each record.
    """
    return tuple(
        _fit_channel([_Part(y[:, i], u) for y, u in records], most)
        for i in range(records[0][0].shape[1])
    )


def _fit_channel(records: Sequence[_Part], most: int | None) -> Channel:
    """Fit the model of one channel, scaled to its range."""
    offset, scale = units(np.concatenate([part.y for part in records]))
    first, *others = [part._replace(y=(part.y - offset) / scale) for part in records]
    parts = [_recent(part, LONGEST // len(others)) for part in others]
    begin, _ = recent(first.y[:, None])
    a = _denominator([_recent(first), *parts], most)
    # Only the end of the first record is fitted, but its initial state is that at its beginning.
    whole = [first._replace(y=np.where(np.arange(len(first.y)) < begin, np.nan, first.y)), *parts]
    fitted, simulated = _solved(a, whole)
    order, nu = len(a) - 1, first.u.shape[1]
    b, c = fitted[: nu * len(a)].reshape(nu, -1), fitted[nu * len(a) : nu * len(a) + order]
    constant = float(fitted[-1])
    ends = np.cumsum([len(part.y) for part in whole])[:-1]
    runs = np.split(simulated - constant, ends)
    errors = np.split(_joined(whole) - simulated, ends)
    pairs = [(run, part.u) for run, part in zip(runs, whole, strict=True)]
    states = States.of(a, b, pairs, errors).scaled(scale)
    return Channel(a, scale * b, scale * c, offset + scale * constant, states)


def _recent(part: _Part, longest: int | None = None) -> _Part:
    """Return the part without the samples that `common.recent` drops at its beginning."""
    if not len(known(part.y)):
        return part
    begin, end = recent(part.y[:, None], longest)
    return _Part(end[:, 0], part.u[begin:])


def _joined(parts: Sequence[_Part]) -> Array:
    return np.concatenate([part.y for part in parts])


def _denominator(parts: Sequence[_Part], most: int | None) -> Array:
    """Return the denominator A; a higher order must lower the held-out error."""
    nu = parts[0].u.shape[1]
    enough_samples = max((len(known(_joined(parts))) // 3 - nu - 1) // (2 + nu), 1)
    most = enough_samples if most is None else min(most, enough_samples)
    best, errors = ORDERS[0], dict[int, Array]()
    with suppress(DeadlineError):  # at the deadline, take the best order so far
        for order in (order for order in ORDERS if order <= most):
            errors[order] = _held_out(parts, order)
            if is_better(errors[order], errors[best]):
                best = order
    return _refined(_of_order(parts, best), parts)


def _held_out(parts: Sequence[_Part], order: int) -> Array:
    """Return the held-out RMSE of the forecast from each origin."""
    y, errors = _joined(parts), []
    for ends in zip(*map(_ends, parts), strict=True):
        check()
        begun = [part._replace(y=np.where(np.arange(len(part.y)) < end, part.y, np.nan))
                 for part, end in zip(parts, ends, strict=True)]  # fmt: skip
        later = np.isnan(_joined(begun)) & ~np.isnan(y)
        if later.any():
            cut = [_Part(part.y[:end], part.u[:end])
                   for part, end in zip(parts, ends, strict=True)]  # fmt: skip
            simulated = _solved(_of_order(cut, order), begun)[1]
            errors.append(np.sqrt(np.mean((y - simulated)[later] ** 2)))
    return np.array(errors)


def _ends(part: _Part) -> list[int]:
    """Return the index of the first held-out sample from each origin; `len(y)` without one."""
    rows = np.append(known(part.y), len(part.y))
    return [int(rows[min(origin, len(rows) - 1)]) for origin in origins(len(rows) - 1)]


def _of_order(parts: Sequence[_Part], order: int) -> Array:
    """Return the denominator of this order with the least error over all iterations."""
    return min(_tried(parts, order), key=lambda at: at[0])[1]


def _tried(parts: Sequence[_Part], order: int) -> Iterator[tuple[float, Array]]:
    """Yield mean squared errors and denominators of the Steiglitz-McBride iteration (1965).

    Output, inputs and offset are filtered by 1/A, and the next A is fitted to the filtered signals
    by least squares. Gaps of y are filled by linear interpolation at first, then by the simulation
    of the previous model. The iteration ends early when the denominator has converged.
    """
    y = _joined(parts)
    whole = np.concatenate([_filled(part.y) for part in parts])
    ends = np.cumsum([len(part.y) for part in parts])[:-1]
    a = np.append(1.0, np.zeros(order))
    driven = _driven(a, parts)
    for _ in range(ROUNDS):
        passed = [scipy.signal.lfilter([1.0], a, part) for part in np.split(whole, ends)]
        past = np.concatenate([_delayed(part, order + 1)[:, 1:] for part in passed])
        constant = np.concatenate(
            [scipy.signal.lfilter([1.0], a, np.ones(len(part))) for part in passed]
        )
        explained = np.hstack([-past, driven, constant[:, None]])
        fitted = np.linalg.lstsq(explained, np.concatenate(passed), rcond=_RANK)[0]
        before, a = a, stable(np.append(1.0, fitted[:order]))
        driven = _driven(a, parts)
        simulated = _weighed(driven, order + 1, parts)[1]
        whole = np.where(np.isnan(y), simulated, y)
        yield float(np.nanmean((y - simulated) ** 2)), a
        if abs(a - before).max() <= CONVERGED:
            return


def _filled(y: Array) -> Array:
    """Fill gaps by linear interpolation."""
    rows = known(y)
    return np.interp(np.arange(len(y)), rows, y[rows]) if len(rows) else np.zeros_like(y)


def _refined(a: Array, parts: Sequence[_Part]) -> Array:
    """Return the locally optimal denominator."""
    y = _joined(parts)

    def left(moved: Array) -> Array:
        simulated = _solved(stable(np.append(1.0, moved)), parts)[1]
        return np.nan_to_num(y - simulated)

    minimum = scipy.optimize.least_squares(left, a[1:], x_scale="jac", max_nfev=20)
    return stable(np.append(1.0, minimum.x))


def _solved(a: Array, parts: Sequence[_Part]) -> tuple[Array, Array]:
    """Return B, C of each part and the offset that are optimal for A, and the simulation."""
    return _weighed(_driven(a, parts), len(a), parts)


def _weighed(driven: Array, size: int, parts: Sequence[_Part]) -> tuple[Array, Array]:
    """Return the same as `_solved`, given the regressors `driven` and the length of A, `size`."""
    y = _joined(parts)
    rows = known(y)
    basis = np.hstack([driven, np.ones((len(y), 1))])
    fitted = basis[rows]
    of_c = slice(parts[0].u.shape[1] * size, -1)
    fitted[:, of_c] = _determined(basis[:, of_c], rows)
    coefficients = np.linalg.lstsq(fitted, y[rows], rcond=_RANK)[0]
    return coefficients.astype(np.float64), np.asarray(basis @ coefficients)


def _determined(free: Array, rows: npt.NDArray[np.int_]) -> Array:
    """Return the measured rows of the responses to an initial state.

    Responses that have decayed before the first measured sample, and so do not determine the
    state, are set to 0.
    """
    gone = abs(free[rows]).max(axis=0) < _DECAYED_SHARE * abs(free).max(axis=0)
    return np.where(gone, 0.0, free[rows])


def initial_state(channel: Channel, y: Array, u: Array) -> Array:
    """Return the best C for a channel `(time,)` that may begin with NaN."""
    left = y - channel._replace(c=np.zeros_like(channel.c)).simulate(u)
    free, rows = _free(channel.a, u), known(y)
    return np.asarray(np.linalg.lstsq(_determined(free, rows), left[rows], rcond=_RANK)[0])


def _free(a: Array, u: Array) -> Array:
    """Return the responses to each coefficient of C, `(time, n)`."""
    response = scipy.signal.lfilter([1.0], a, _impulse(u))
    return _delayed(response, len(a) - 1)


def _driven(a: Array, parts: Sequence[_Part]) -> Array:
    """Return the regressors `(time, ...)` of B, input by input, and of each part's C."""
    forced, free = [], []
    for _, u in parts:
        passed = scipy.signal.lfilter([1.0], a, u, axis=0).T
        forced.append(np.hstack([_delayed(x, len(a)) for x in passed]))
        free.append(_free(a, u))
    # A shortcut for a single part, the usual case: block_diag is slow.
    of_states = free[0] if len(free) == 1 else scipy.linalg.block_diag(*free)
    return np.hstack([np.concatenate(forced), of_states])


def _impulse(u: Array) -> Array:
    return np.asarray(np.arange(len(u)) == 0, dtype=np.float64)


def _delayed(x: Array, delays: int) -> Array:
    """Return a signal delayed by 0, 1, ... samples, `(time, delays)`."""
    return np.asarray(scipy.linalg.toeplitz(x, np.zeros(delays)))


def stable(a: Array) -> Array:
    """Mirror unstable poles at the unit circle, and limit all to `FARTHEST_POLE`."""
    poles = np.roots(a)
    size = abs(poles)
    if (size <= FARTHEST_POLE).all():
        return a
    inside = np.minimum(np.where(size > 1, 1 / np.maximum(size, 1), size), FARTHEST_POLE)
    a = np.real(np.poly(np.where(size > 0, poles * inside / np.maximum(size, 1e-300), 0)))
    # Rounding may move nearly equal poles outside the unit circle again.
    while (largest := abs(np.roots(a)).max(initial=0.0)) > 1:
        a = a * (0.999 / largest) ** np.arange(len(a))
    return a
