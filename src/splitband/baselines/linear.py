"""Fit a linear output-error model from the known inputs to the measured channels.

A naive baseline (see `baselines.naive`) for records with inputs; for a linear system with white
measurement noise no other model does better. Its state at the beginning of a history is estimated
from that history. See L. Ljung, System Identification, 2nd ed., Sec. 4.2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.delays import candidates, check_delays, delayed
from splitband.baselines.naive import LONGEST, known, recent, units
from splitband.baselines.origins import origins, pays
from splitband.baselines.states import States
from splitband.metrics import spread
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import OverError, check, current
from splitband.runtime.options import saved

ORDERS = (1, 2, 3, 4, 6, 8)
"""Numbers of poles that are tried. By eye; which of them is taken is decided over rolling
origins."""
ROUNDS = 20
"""Iterations that look for a denominator, at most; the search goes on from the best one. By eye."""
CONVERGED = 1e-9
"""The iteration ends where no coefficient changes by more than this, far above rounding. By eye."""
FARTHEST_POLE = 0.9999
"""Largest absolute value of a pole: a record hardly tells a slower decay from growth. By eye."""
_RANK = 1e-10
"""Singular values below this share of the largest one are cut: they are those of rounding."""
_DECAYED_SHARE = 0.1
"""A response to the initial state below this share of its peak is taken to have died out.
By eye."""


@saved
@dataclass(frozen=True, eq=False)
class OutputError:
    """Model each channel by y = (B u + C δ) / A + offset; use `fit`.

    A, B and C are polynomials of the delay operator, δ is the unit impulse at index 0: C δ / A is
    the response to the initial state.

    Attributes
    ----------
    channels : The model of each channel.
    mean, scale : Mean and standard deviation of the inputs, for their normalisation, `(nu,)`.
    delays : Dead time of each input in samples, `nu` of them.
    """

    channels: tuple[Channel, ...]
    mean: Array
    scale: Array
    delays: tuple[int, ...]

    def __post_init__(self) -> None:
        """Check what may come from a file."""
        check_delays(self.delays, len(self.mean))

    @classmethod
    def fit(
        cls,
        y: Array,
        u: Array,
        others: Sequence[tuple[Array, Array]] = (),
        most: int | None = None,
    ) -> OutputError:
        """Fit to the first samples of a record, by least squares of the simulation error.

        Each channel has a model of its own. Its poles are stable, and more of them have to pay for
        themselves on held-out samples (`baselines.origins`). Of a long record the
        last samples are fitted, see `naive.recent`. Where an input acts late, a model with that
        delay is fitted, too, and the one with the lower Bayesian information criterion is taken.
        After the deadline of `runtime.deadlines` no more orders and no delays are tried.

        Parameters
        ----------
        y : `(train, ny)`; NaN is what was not measured.
        u : Inputs of the same samples, `(train, nu)`.
        others : `y` and `u` of further records of the same system. Together they may have as many
            samples in the fit as the first record. Each has an initial state of its own.
        most : Poles of each channel at most, for a model without delays.
        """
        together = np.concatenate([u, *(inputs for _, inputs in others)])
        mean, scale = together.mean(axis=0), spread(together)
        records = [(seen, (inputs - mean) / scale) for seen, inputs in ((y, u), *others)]
        at_once = cls(_fit_channels(records, most), mean, scale, (0,) * len(mean))
        if most is not None or current().over:
            return at_once
        delays = candidates(records)
        begin, shifted = max(delays), [(seen, delayed(x, delays)) for seen, x in records]
        # Fitted from the first sample on whose inputs are known, with a state of its own there.
        acted = [(seen[begin:], x[begin:]) for seen, x in shifted]
        if not begin or np.isnan(acted[0][0]).all(axis=0).any():
            return at_once
        channels = _fit_channels(acted)
        first, x = _after(shifted[0][0], begin), shifted[0][1]
        begun = [
            c._replace(c=_initial(c, part, x)) for c, part in zip(channels, first.T, strict=True)
        ]
        late = cls(tuple(begun), mean, scale, delays)
        samples = sum(np.count_nonzero(~np.isnan(seen)) for seen, _ in acted) / y.shape[1]
        return min(at_once, late, key=lambda model: model.criterion(samples))

    def simulate(self, u: Array) -> Array:
        """Simulate the training record from its first sample on, `(time, ny)`.

        `u` are its inputs, `(time, nu)`, for as many samples as wanted.
        """
        scaled = self._scaled(u)
        return np.stack([channel.simulate(scaled) for channel in self.channels], axis=1)

    def continued(self, u: Array, y: Array, before: Array | None = None) -> Array:
        """Simulate a record from a state that is estimated from its first samples, `(time, ny)`.

        Parameters
        ----------
        u : Inputs from the first sample on, `(time, nu)`.
        y : The first samples, `(any time, ny)`, NaN in gaps.
        before : Where the record may go on from the training record, the inputs since the first
            sample of that, `(any time, nu)`, empty where both begin together. What the model says
            of the training record's state is corrected by as much as `y` demands. None: the
            state is only known to be one of those that the training record had.
        """
        since = u if before is None else np.concatenate([before, u])
        scaled, late = self._scaled(since), max(self.delays)
        if before is not None:
            y = _after(y, late - len(before))  # before these samples the inputs are not known
        elif len(y) >= 2 * late:
            y = _after(y, late)
        found = []
        for channel, seen in zip(self.channels, y.T, strict=True):
            states, expected = channel.states, before is not None
            begun = channel if expected else channel._replace(c=states.mean)
            y_sim = begun.simulate(scaled)[len(since) - len(u) :]
            left = seen - y_sim[: len(seen)]
            found.append(y_sim + states.correction(left, len(u), channel.a, expected))
        return np.stack(found, axis=1)

    def transfer_function(self, output: int, input_: int) -> tuple[Array, Array]:
        """Return numerator and denominator from an input to an output, in powers of z."""
        channel, late = self.channels[output], self.delays[input_]
        b = channel.b[input_] / self.scale[input_]
        return b, np.append(channel.a, np.zeros(late))

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of the deviations from `mean` and the offsets, delays included.

        The states are those of each channel in observer form, then the delayed inputs.
        """
        orders = [len(channel.a) - 1 for channel in self.channels]
        ny, nu, own = len(self.channels), len(self.mean), sum(orders)
        size = own + sum(self.delays)
        a, b = np.zeros((size, size)), np.zeros((size, nu))
        c, d = np.zeros((ny, size)), np.zeros((ny, nu))
        # What acts on the channels: an input, or the last of its delayed values.
        acts = np.zeros((nu, size + nu))
        at = own
        for j, late in enumerate(self.delays):
            if late:
                a[at + 1 : at + late, at : at + late - 1] = np.eye(late - 1)
                b[at, j] = 1.0
                at += late
            acts[j, at - 1 if late else size + j] = 1 / self.scale[j]
        first = 0
        for i, (channel, order) in enumerate(zip(self.channels, orders, strict=True)):
            rows = slice(first, first + order)
            a[rows, rows] = np.eye(order, k=1)
            a[rows, first] -= channel.a[1:]
            driven = (channel.b[:, 1:] - channel.b[:, :1] * channel.a[1:]).T @ acts
            direct = channel.b[:, 0] @ acts
            a[rows] += driven[:, :size]
            b[rows] += driven[:, size:]
            c[i], d[i] = direct[:size], direct[size:]
            c[i, first] += 1.0
            first += order
        return a, b, c, d

    def criterion(self, samples: float) -> float:
        """Return the Bayesian information criterion of a fit to so many samples of each channel."""
        tiny = np.finfo(np.float64).tiny
        return sum(
            2 * samples * np.log(max(channel.states.error, tiny))
            + (channel.a.size + channel.b.size + channel.c.size) * np.log(samples)
            for channel in self.channels
        )

    def _scaled(self, u: Array) -> Array:
        """Return the delayed and normalised inputs."""
        return (delayed(u, self.delays) - self.mean) / self.scale

    def __str__(self) -> str:
        orders = "+".join(str(len(channel.a) - 1) for channel in self.channels)
        poles = f"{orders} pole{'s' * (orders != '1')}"
        inputs = f"{len(self.mean)} input{'s' * (len(self.mean) != 1)}"
        return f"{poles}, {inputs} and an offset"


@saved
class Channel(NamedTuple):
    """Hold the model of one channel.

    Attributes
    ----------
    a, b, c, offset : A `(n + 1,)`, B `(nu, n + 1)`, C `(n,)` and the offset of `OutputError`.
    states : Those in the training records, in the coordinates of C.
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


class _Part(NamedTuple):
    """Hold a stretch of a record: a channel `(time,)`, NaN in gaps, and the inputs `(time, nu)`."""

    y: Array
    u: Array


def _fit_channels(
    records: Sequence[tuple[Array, Array]], most: int | None = None
) -> tuple[Channel, ...]:
    return tuple(
        _fit_channel([_Part(y[:, i], u) for y, u in records], most)
        for i in range(records[0][0].shape[1])
    )


def _after(y: Array, begin: int) -> Array:
    """Replace the samples before the index `begin` by NaN."""
    return np.where(np.arange(len(y))[:, None] < begin, np.nan, y)


def _fit_channel(records: Sequence[_Part], most: int | None) -> Channel:
    """Fit the model of one channel, scaled to its range."""
    offset, scale = units(np.concatenate([part.y for part in records]))
    first, *others = [part._replace(y=(part.y - offset) / scale) for part in records]
    parts = [_recent(part, LONGEST // len(others)) for part in others]
    begin, _ = recent(first.y[:, None])
    a = _denominator([_recent(first), *parts], most)
    # The initial state is that of the whole of the first record, of which the end is fitted.
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
    """Return the part from the first sample of `naive.recent` on."""
    if not len(known(part.y)):
        return part
    begin, end = recent(part.y[:, None], longest)
    return _Part(end[:, 0], part.u[begin:])


def _joined(parts: Sequence[_Part]) -> Array:
    return np.concatenate([part.y for part in parts])


def _denominator(parts: Sequence[_Part], most: int | None) -> Array:
    """Return the denominator A, of a higher order where that pays on held-out samples."""
    nu = parts[0].u.shape[1]
    enough_samples = max((len(known(_joined(parts))) // 3 - nu - 1) // (2 + nu), 1)
    most = enough_samples if most is None else min(most, enough_samples)
    best, errors = ORDERS[0], dict[int, Array]()
    with suppress(OverError):  # the best of the orders so far is what there is then
        for order in (order for order in ORDERS if order <= most):
            errors[order] = _held_out(parts, order)
            if pays(errors[order], errors[best]):
                best = order
    return _refined(_of_order(parts, best), parts)


def _held_out(parts: Sequence[_Part], order: int) -> Array:
    """Return the RMSE of the forecasts of held-out samples, from each origin."""
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
    """Return the best denominator of this order, out of those that are tried."""
    return min(_tried(parts, order), key=lambda at: at[0])[1]


def _tried(parts: Sequence[_Part], order: int) -> Iterator[tuple[float, Array]]:
    """Yield mean squared errors and denominators of the Steiglitz-McBride iteration (1965).

    Output, inputs and offset are filtered by 1/A, and the next A is fitted to the filtered signals
    by least squares. Gaps of y are filled by the simulation of the model before, by straight lines
    at first. It ends early where the denominator does not change any more.
    """
    y = _joined(parts)
    whole = np.concatenate([_filled(part.y) for part in parts])
    ends = np.cumsum([len(part.y) for part in parts])[:-1]
    a = np.append(1.0, np.zeros(order))
    for _ in range(ROUNDS):
        passed = [scipy.signal.lfilter([1.0], a, part) for part in np.split(whole, ends)]
        past = np.concatenate([
            np.stack([_delayed(part, k) for k in range(1, order + 1)], axis=1) for part in passed
        ])  # fmt: skip
        constant = np.concatenate(
            [scipy.signal.lfilter([1.0], a, np.ones(len(part))) for part in passed]
        )
        explained = np.hstack([-past, _driven(a, parts), constant[:, None]])
        fitted = np.linalg.lstsq(explained, np.concatenate(passed), rcond=_RANK)[0]
        before, a = a, _stable(np.append(1.0, fitted[:order]))
        simulated = _solved(a, parts)[1]
        whole = np.where(np.isnan(y), simulated, y)
        yield float(np.nanmean((y - simulated) ** 2)), a
        if abs(a - before).max() <= CONVERGED:
            return


def _filled(y: Array) -> Array:
    """Fill gaps by straight lines."""
    rows = known(y)
    return np.interp(np.arange(len(y)), rows, y[rows]) if len(rows) else np.zeros_like(y)


def _refined(a: Array, parts: Sequence[_Part]) -> Array:
    """Return the locally optimal denominator."""
    y = _joined(parts)

    def left(moved: Array) -> Array:
        simulated = _solved(_stable(np.append(1.0, moved)), parts)[1]
        return np.nan_to_num(y - simulated)

    minimum = scipy.optimize.least_squares(left, a[1:], x_scale="jac", max_nfev=20)
    return _stable(np.append(1.0, minimum.x))


def _solved(a: Array, parts: Sequence[_Part]) -> tuple[Array, Array]:
    """Return the best B, C of each part and offset for a given A, and their simulation."""
    y = _joined(parts)
    rows = known(y)
    basis = np.hstack([_driven(a, parts), np.ones((len(y), 1))])
    fitted = basis[rows]
    of_c = slice(parts[0].u.shape[1] * len(a), -1)
    fitted[:, of_c] = _determined(basis[:, of_c], rows)
    coefficients = np.linalg.lstsq(fitted, y[rows], rcond=_RANK)[0]
    return coefficients.astype(np.float64), np.asarray(basis @ coefficients)


def _determined(free: Array, rows: npt.NDArray[np.int_]) -> Array:
    """Return the measured rows of responses to an initial state, 0 where they do not determine it.

    That is where the response has died out before the first measured sample.
    """
    gone = abs(free[rows]).max(axis=0) < _DECAYED_SHARE * abs(free).max(axis=0)
    return np.where(gone, 0.0, free[rows])


def _initial(channel: Channel, y: Array, u: Array) -> Array:
    """Return C of a channel `(time,)` that is NaN before its first measured sample."""
    left = y - channel._replace(c=np.zeros_like(channel.c)).simulate(u)
    free, rows = _free(channel.a, u), known(y)
    return np.asarray(np.linalg.lstsq(_determined(free, rows), left[rows], rcond=_RANK)[0])


def _free(a: Array, u: Array) -> Array:
    """Return the responses to each coefficient of C, `(time, n)`."""
    response = scipy.signal.lfilter([1.0], a, _impulse(u))
    return np.stack([_delayed(response, k) for k in range(len(a) - 1)], axis=1)


def _driven(a: Array, parts: Sequence[_Part]) -> Array:
    """Return the regressors `(time, ...)` of B, input by input, and of each part's C."""
    order = len(a) - 1
    forced, free = [], []
    for _, u in parts:
        passed = scipy.signal.lfilter([1.0], a, u, axis=0).T
        forced.append([_delayed(x, k) for x in passed for k in range(order + 1)])
        free.append(_free(a, u))
    driven = np.concatenate([np.stack(columns, axis=1) for columns in forced])
    return np.hstack([driven, scipy.linalg.block_diag(*free)])


def _impulse(u: Array) -> Array:
    return np.asarray(np.arange(len(u)) == 0, dtype=np.float64)


def _delayed(x: Array, samples: int) -> Array:
    return np.concatenate([np.zeros(samples), x[: len(x) - samples]])


def _stable(a: Array) -> Array:
    """Mirror poles from outside the unit circle into it, to `FARTHEST_POLE` at most."""
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


def input_delays(records: Sequence[tuple[Array, Array]]) -> tuple[int, ...]:
    """Return the dead time of each input in samples, as the linear model has it.

    `records` are `y` `(time, ny)`, NaN in gaps, and `u` `(time, nu)` of each.
    """
    first, *others = records
    if not any(candidates(records)):
        return (0,) * first[1].shape[1]
    return OutputError.fit(*first, others).delays
