"""A linear model from the known inputs to the measured channels: the output-error model.

A naive baseline (see `baselines.naive`) for records with inputs; for a linear system with white
measurement noise no other model does better. It is simulated from the beginning of the record and
needs no measured samples but those it was fitted to. See L. Ljung, System Identification, 2nd ed.,
Sec. 4.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.naive import known, recent, units
from splitband.metrics import spread

Array = npt.NDArray[np.float64]

ORDERS = (1, 2, 3, 4, 6, 8)
"""Numbers of poles that are tried."""
WORTH_POLES = 0.1
"""By how much the held-out error of more poles must be lower: what a few samples prefer by less
is chance, and more poles than a system has may drift far away beyond the record."""
ROUNDS = 20
"""Iterations that look for a denominator, at most; the search goes on from the best one."""
CONVERGED = 1e-9
"""The iteration ends where no coefficient changes by more than this."""
FARTHEST_POLE = 0.9999
"""Largest absolute value of a pole: a record hardly tells a slower decay from growth."""
_CUTS = (0.6, 0.7, 0.8, 0.9)
"""Shares of the samples that are fitted, to see how well the model forecasts the others."""
_RANK = 1e-10
"""Singular values below this share of the largest one are cut."""
_BRIEF = 1e-3
"""The same for an initial state, which a few samples hardly tell."""
_GONE = 0.1
"""A response to the initial state below this share of its peak is taken to have died out."""


@dataclass(frozen=True, eq=False)
class OutputError:
    """y = (B u + C δ) / A + offset for each channel; use `fit`.

    A, B and C are polynomials of the delay operator, δ is the unit impulse at index 0: C δ / A is
    the response to the initial state.

    Attributes
    ----------
    channels : The model of each.
    mean, scale : By which the inputs are brought to mean 0 and deviation 1, `(nu,)`.
    """

    channels: tuple[Channel, ...]
    mean: Array
    scale: Array

    @classmethod
    def fit(cls, y: Array, u: Array) -> OutputError:
        """Fit to the first samples of a record, by least squares of the simulation error.

        Each channel has a model of its own. Its poles are stable, and as few as forecast held-out
        samples about as well as any number of them, over several cuts of `y`. Of a long record the
        last samples are fitted, see `naive.recent`.

        Parameters
        ----------
        y : `(train, ny)`; NaN is what was not measured.
        u : Inputs of the same samples, `(train, nu)`.
        """
        mean, scale = u.mean(axis=0), spread(u)
        scaled = (u - mean) / scale
        return cls(tuple(_fit_channel(channel, scaled) for channel in y.T), mean, scale)

    def simulate(self, u: Array, y: Array | None = None) -> Array:
        """The record from its first sample on, `(time, ny)`, under the inputs `u` `(time, nu)`.

        Of another record of the system, `y` `(any time, ny)` are its first samples, NaN in gaps:
        they tell its initial state.
        """
        scaled = (u - self.mean) / self.scale
        channels = self.channels
        if y is not None:
            channels = tuple(
                channel.begun_with(of_channel, scaled)
                for channel, of_channel in zip(channels, y.T, strict=True)
            )
        return np.stack([channel.simulate(scaled) for channel in channels], axis=1)

    def __str__(self) -> str:
        orders = "+".join(str(len(channel.a) - 1) for channel in self.channels)
        return f"{orders} pole(s), {len(self.mean)} input(s) and an offset"


class Channel(NamedTuple):
    """A `(n + 1,)`, B `(nu, n + 1)`, C `(n,)` and the offset of `OutputError`."""

    a: Array
    b: Array
    c: Array
    offset: float

    def simulate(self, u: Array) -> Array:
        """From index 0 on, `(time,)`."""
        forced = sum(scipy.signal.lfilter(b, self.a, x) for b, x in zip(self.b, u.T, strict=True))
        return np.asarray(forced + scipy.signal.lfilter(self.c, self.a, _impulse(u)) + self.offset)

    def begun_with(self, y: Array, u: Array) -> Channel:
        """With the initial state, C, that fits the first samples `y` `(any time,)` best."""
        rest = self._replace(c=np.zeros_like(self.c)).simulate(u[: len(y)])
        answers = scipy.signal.lfilter([1.0], self.a, _impulse(u[: len(y)]))
        basis = np.stack([_delayed(answers, k) for k in range(len(self.c))], axis=1)
        rows = known(y)
        c = np.linalg.lstsq(basis[rows], (y - rest)[rows], rcond=_BRIEF)[0]
        return self._replace(c=np.asarray(c, dtype=np.float64))


def _fit_channel(y: Array, u: Array) -> Channel:
    """The model of one channel, fitted with the channel scaled to its range."""
    offset, scale = units(y)
    y = (y - offset) / scale
    begin, end = recent(y[:, None])
    a = _denominator(end[:, 0], u[begin:])
    coefficients = _solved(a, y, u, begin)[0]
    b, c = coefficients[: -len(a)].reshape(u.shape[1], -1), coefficients[-len(a) : -1]
    return Channel(a, scale * b, scale * c, offset + scale * float(coefficients[-1]))


def _denominator(y: Array, u: Array) -> Array:
    """The denominator A, of the lowest order that forecasts held-out samples well."""
    most = max((len(known(y)) // 3 - u.shape[1] - 1) // (2 + u.shape[1]), 1)
    errors = {order: _held_out(y, u, order) for order in ORDERS if order <= most}
    enough = (1 + WORTH_POLES) ** 2 * min(errors.values())
    order = next(order for order, error in errors.items() if error <= enough)
    return _refined(_of_order(y, u, order), y, u)


def _held_out(y: Array, u: Array, order: int) -> float:
    """Mean squared error of the forecasts of held-out samples, over several cuts."""
    errors, rows = [], known(y)
    for share in _CUTS:
        later = rows[max(int(share * len(rows)), 1) :]
        if len(later):
            a = _of_order(y[: later[0]], u[: later[0]], order)
            fitted = np.where(np.arange(len(y)) < later[0], y, np.nan)
            errors.append((y - _solved(a, fitted, u)[1])[later] ** 2)
    return float(np.mean(np.concatenate(errors))) if errors else 0.0


def _of_order(y: Array, u: Array, order: int) -> Array:
    """The denominator of this order that fits best, out of those that are tried."""
    return min(_tried(y, u, order), key=lambda at: at[0])[1]


def _tried(y: Array, u: Array, order: int) -> Iterator[tuple[float, Array]]:
    """Mean squared errors and denominators, by the iteration of Steiglitz and McBride (1965).

    Output, inputs and offset are filtered by 1/A, and the next A is fitted to the filtered signals
    by least squares. Gaps of y are filled by the simulation of the model before, by straight lines
    at first. It ends early where the denominator does not change any more.
    """
    whole = np.interp(np.arange(len(y)), known(y), y[known(y)])
    a = np.append(1.0, np.zeros(order))
    for _ in range(ROUNDS):
        passed = scipy.signal.lfilter([1.0], a, whole)
        past = np.stack([_delayed(passed, k) for k in range(1, order + 1)], axis=1)
        constant = scipy.signal.lfilter([1.0], a, np.ones(len(y)))
        explained = np.hstack([-past, _driven(a, u), constant[:, None]])
        fitted = np.linalg.lstsq(explained, passed, rcond=_RANK)[0]
        before, a = a, _stable(np.append(1.0, fitted[:order]))
        simulated = _solved(a, y, u)[1]
        whole = np.where(np.isnan(y), simulated, y)
        yield float(np.nanmean((y - simulated) ** 2)), a
        if abs(a - before).max() <= CONVERGED:
            return


def _refined(a: Array, y: Array, u: Array) -> Array:
    """The denominator nearby that fits best."""

    def left(moved: Array) -> Array:
        simulated = _solved(_stable(np.append(1.0, moved)), y, u)[1]
        return np.nan_to_num(y - simulated)

    minimum = scipy.optimize.least_squares(left, a[1:], x_scale="jac", max_nfev=20)
    return _stable(np.append(1.0, minimum.x))


def _solved(a: Array, y: Array, u: Array, begin: int = 0) -> tuple[Array, Array]:
    """B, C and offset that fit y from `begin` on best, given A, and the simulation with them."""
    rows = known(y)
    rows = rows[rows >= begin]
    basis = np.hstack([_driven(a, u), np.ones((len(u), 1))])
    fitted = basis[rows]
    # Where the response to the initial state has died out before `begin`, the samples do not
    # determine C, which is set to 0.
    of_c = slice(-len(a), -1)
    gone = abs(fitted[:, of_c]).max(axis=0) < _GONE * abs(basis[:, of_c]).max(axis=0)
    fitted[:, of_c] = np.where(gone, 0.0, fitted[:, of_c])
    coefficients = np.linalg.lstsq(fitted, y[rows], rcond=_RANK)[0]
    return coefficients.astype(np.float64), np.asarray(basis @ coefficients)


def _driven(a: Array, u: Array) -> Array:
    """Regressors `(time, ...)` of the coefficients of B, input by input, and of C."""
    order = len(a) - 1
    passed = scipy.signal.lfilter([1.0], a, np.hstack([u, _impulse(u)[:, None]]), axis=0).T
    return np.stack(
        [_delayed(x, k) for x in passed[:-1] for k in range(order + 1)]
        + [_delayed(passed[-1], k) for k in range(order)],
        axis=1,
    )


def _impulse(u: Array) -> Array:
    return np.asarray(np.arange(len(u)) == 0, dtype=np.float64)


def _delayed(x: Array, samples: int) -> Array:
    return np.concatenate([np.zeros(samples), x[: len(x) - samples]])


def _stable(a: Array) -> Array:
    """With poles outside of the unit circle mirrored into it, to `FARTHEST_POLE` at most."""
    poles = np.roots(a)
    size = abs(poles)
    if (size <= FARTHEST_POLE).all():
        return a
    inside = np.minimum(np.where(size > 1, 1 / np.maximum(size, 1), size), FARTHEST_POLE)
    a = np.real(np.poly(np.where(size > 0, poles * inside / np.maximum(size, 1e-300), 0)))
    # Of nearly equal poles rounding leaves few digits, and may put them outside again.
    while (largest := abs(np.roots(a)).max(initial=0.0)) > 1:
        a = a * (0.999 / largest) ** np.arange(len(a))
    return a
