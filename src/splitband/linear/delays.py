"""Estimate delays by input and output: the first sample of the impulse response.

The dead time of a held input is one sample less, as its effect is one sample late by itself. A
delay of many samples would cost a linear model as many states and a network as long a memory.
Shifting the input by its delay avoids both. A first estimate is the first significant lag of the
cross-correlation of whitened signals (Box and Jenkins, Time Series Analysis, Ch. 12). The delay
near it with the least error of linear models of low order follows. This delay is accepted only if
a model of any order without delay has a larger held-out error, or more poles on the same samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.linear.refinement import (
    MOST_SAMPLES,
    Signals,
    blocks_of,
    linear_solution,
    refined,
    windows,
)
from splitband.linear.selection import OrderSearch
from splitband.linear.subspace import filled, stable, subspace
from splitband.metrics import spread
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import current
from splitband.runtime.errors import InputError

LONGEST_DELAY = 100_000
"""Longest delay in samples in a file: bounds the memory of a stream."""
_PAST = 12
"""Order of the whitening models. Checked by halving and doubling."""
_SIGNIFICANT = 5.5
"""Least correlation of an input with effect, in standard deviations of correlations without effect.
Checked by halving and doubling."""
_OF_LARGEST = (0.35, 0.7, 1.0)
"""Candidates are the first lags with these shares of the largest correlation: inputs with constant
pieces are correlated by chance, so the first significant lag may be early. Checked by
halving and doubling."""
_ARX_PAST = 30
"""Past samples by signal in the ARX model for earlier lags. Checked by halving and doubling."""
_ARX_ROWS = 8000
"""Samples of a record in this model, evenly spaced in longer records. Bounds time and memory."""
_CHANCE = 1e-6
"""Probability of significance without effect. Checked by halving and doubling."""
_EFFECT = 0.02
"""Least share of the other regressors' residual explained by tested regressors, as models are only
nearly right. Checked by halving and doubling."""
_SHARE = 0.4
"""Longest delay in the search, as a share of the longest record. Checked by
halving and doubling."""
FEWEST_MOVES = 3.0
"""Fewest moves of an input for an estimate: the response to one or two may be chance. By eye."""
_ALIKE = 1.05
"""Largest held-out error of a model with delay, as a multiple of the error of a model without delay
and with more poles. By eye."""
SHORTEST = 2
"""Shortest first estimate in samples; shorter ones become 0, as many systems respond one sample
late. Checked by halving and doubling."""
_ROWS = 10
"""Block rows of the subspace models in comparisons of delays. Bounds the time."""
_EXACT = 1e-6
"""RMS error of an exact model, in standard deviations. Rounding."""
_DELAY_ORDERS = (1, 2, 4)
"""Orders of the models in comparisons of delays. Bounds the time."""


def check_delays(delays: Sequence[int], inputs: int) -> None:
    """Check the number and range of delays, possibly from a file; raises ValueError."""
    if len(delays) != inputs:
        raise InputError(f"delays must be those of {inputs} inputs, got {len(delays)}")
    for delay in delays:
        whole("delays", delay, 0, LONGEST_DELAY)


def delayed(u: Array, delays: Sequence[int], rows: slice = slice(None)) -> Array:
    """Return rows of inputs `(time, nu)`, delayed in samples, held before the record."""
    if not any(delays):
        return u[rows]
    taken = np.arange(len(u))[rows, None] - np.asarray(delays)
    return np.asarray(np.take_along_axis(u, np.maximum(taken, 0), axis=0))


def measured_part(y: Array, u: Array) -> tuple[Array, Array]:
    """Return outputs and inputs, `(time, n)`, from the first measured sample on.

    In earlier rows the state is not observable, as in `Units.run`.
    """
    begin = int(np.isfinite(y).any(axis=1).argmax())
    return y[begin:], u[begin:]


@dataclass(frozen=True, eq=False)
class Units:
    """Means and standard deviations of the signals of all records."""

    y_mean: Array
    y_scale: Array
    u_mean: Array
    u_scale: Array

    @classmethod
    def of(cls, records: Sequence[tuple[Array, Array]]) -> Units:
        """Return the units of records; the scale of a constant signal is 1."""
        y = np.concatenate([y for y, _ in records])
        u = np.concatenate([u for _, u in records])
        return cls(np.nanmean(y, axis=0), spread(y), np.nanmean(u, axis=0), spread(u))

    def run(self, y: Array, u: Array, delays: Sequence[int], rows: slice | None = None) -> Signals:
        """Return some rows of a record with delayed inputs, for a fit.

        By default they begin where all delayed inputs are known. In earlier rows the state is not
        observable: a fast one would have to begin far away for a later effect.
        """
        late = max(delays, default=0)
        rows = rows or slice(late if late < len(y) // 2 else 0, len(y))
        outputs = ((y[rows] - self.y_mean) / self.y_scale).T
        inputs = (delayed(u, delays, rows) - self.u_mean) / self.u_scale
        measured = (~np.isnan(outputs)).astype(np.float64)
        run = Signals(inputs.T, np.where(measured > 0, outputs, 0.0), measured)
        return Signals(*(np.ascontiguousarray(signal) for signal in run))

    def outputs(self, some: Sequence[int]) -> Units:
        """Return the units of some outputs."""
        return replace(self, y_mean=self.y_mean[[*some]], y_scale=self.y_scale[[*some]])


class Delays(NamedTuple):
    """Delays by output and input in samples, `(ny, nu)`.

    taken : Delays accepted on held-out samples, else 0.
    doubted : Rejected delays with the best fit, else 0.
    errors : Standard errors of the accepted delays, else 0: by the curvature of the likelihood of
        models of low order over the neighbouring delays.
    """

    taken: npt.NDArray[np.int_]
    doubted: npt.NDArray[np.int_]
    errors: Array


def delays_of(records: Sequence[tuple[Array, Array]]) -> Delays:
    """Estimate the delays of records."""
    records = [measured_part(y, u) for y, u in records]
    units = Units.of(records)
    lags_by_output = candidates(records)
    chosen = np.zeros((len(lags_by_output), len(lags_by_output[0])), int)
    doubted, errors = np.zeros_like(chosen), np.zeros(chosen.shape)
    for k, of_inputs in enumerate(lags_by_output):
        if any(lags not in ((), (0,)) for lags in of_inputs) and not current().over:
            best, of_best, shown = _compared(
                [(y[:, [k]], u) for y, u in records], units.outputs([k]), of_inputs
            )
            (chosen if shown else doubted)[k] = best
            errors[k] = np.where(shown, of_best, 0.0)
    acts = np.array([[bool(lags) for lags in of_inputs] for of_inputs in lags_by_output])
    # Without an effect on an output, the delay of an input is the least one at the other outputs.
    least = np.where(acts, chosen, np.iinfo(int).max).min(axis=0)
    return Delays(np.where(acts, chosen, np.where(acts.any(axis=0), least, 0)), doubted, errors)


def input_delays(records: Sequence[tuple[Array, Array]]) -> tuple[int, ...]:
    """Return the least delay by input in samples, from pairs of y and u, `(time, n)`."""
    return tuple(delays_of(records).taken.min(axis=0).tolist())


def _compared(
    records: Sequence[tuple[Array, Array]], units: Units, lags: Sequence[tuple[int, ...]]
) -> tuple[list[int], list[float], bool]:
    """Return the delays of one output's inputs with the best fit of models of low order.

    And their standard errors, and whether a model without delays has a larger held-out error, or
    more poles.
    """
    plain = [units.run(y, u, [0] * len(lags), slice(None)) for y, u in records]
    cuts = windows(plain, MOST_SAMPLES // 2)
    samples = sum(int(plain[i].measured[:, begin:end].sum()) for i, begin, end in cuts)
    longest = max(len(y) for y, _ in records) // 2

    def runs_of(delays: Sequence[int], late: int) -> list[Signals]:
        """Return the windows with delayed inputs, from the sample `late` on."""
        half = [late if late < len(y) // 2 else 0 for y, _ in records]
        rows = [(i, slice(max(a, half[i]), b)) for i, a, b in cuts]
        return [units.run(*records[i], delays, of) for i, of in rows if of.start < of.stop]

    @cache
    def of_delays(*delays: int) -> float:
        return _low_order_cost(runs_of(delays, max(delays)), samples)

    def cost(j: int, others: tuple[int, ...], delay: int) -> float:
        return of_delays(*others[:j], delay, *others[j + 1 :])

    best, errors = [of_input[-1] if of_input else 0 for of_input in lags], [0.0] * len(lags)
    for j, of_input in enumerate(lags):
        if of_input not in ((), (0,)):
            with_delay = partial(cost, j, tuple(best))
            best[j], errors[j] = _one_delay(with_delay, of_input, longest, samples)
    if not any(best):
        return best, errors, True
    moving = [bool(np.ptp(u) > 0) for u in np.hstack([run.u for run in plain])]
    # The delayed model has a low order, as in the search for delays: if its fit is far worse than
    # that of a high order, the delays have no evidence.
    both = ((best, _DELAY_ORDERS[-1]), ([0] * len(best), None))
    searches = (OrderSearch(runs_of(delays, max(best)), moving, most=most) for delays, most in both)
    late, at_once = (search.integrating(search.first()) for search in searches)
    simpler = late.order < at_once.order and late.error < _ALIKE * at_once.error
    return best, errors, simpler or not at_once.as_good_as(late)


def _one_delay(
    cost: Callable[[int], float], first: Sequence[int], longest: int, samples: int
) -> tuple[int, float]:
    """Return the delay of the least `cost`, a negative log-likelihood per sample, and its error."""
    best, little = min((*first, 0), key=cost), np.log(samples) / (2 * samples)
    for step in (8, 4, 2, 1):
        while not current().over:
            near = [d for d in (best - step, best + step) if 0 <= d <= longest]
            closer = min(near, key=cost)
            if cost(closer) >= cost(best):
                break
            best = closer
    # Of delays with as good a fit, the longest is the beginning of the input's effect.
    least = cost(best)
    while best < longest and cost(best + 1) < least + little and not current().over:
        best += 1
    # A delay has to explain more than a further parameter.
    if best == 0 or cost(0) < least + little:
        return 0, 0.0
    curvature = samples * (cost(best - 1) + cost(best + 1) - 2 * cost(best))
    return best, 1 / np.sqrt(curvature) if curvature > 0 else np.nan


def _low_order_cost(runs: Sequence[Signals], samples: int) -> float:
    """Return the information criterion of the best model of a low order, per sample."""
    space = subspace([(np.where(r.measured > 0, r.y, np.nan).T, r.u.T) for r in runs], _ROWS)
    if space is None:
        return np.inf
    nu, costs = len(runs[0].u), []
    for order in _DELAY_ORDERS:
        a, c = space.matrices(order)
        at = refined(linear_solution(blocks_of(stable(a), c, [True] * nu), runs), runs, 3)
        left = float(np.log(np.maximum(at.scale, _EXACT)).sum())
        costs.append(left + order * (1 + nu) * np.log(samples) / (2 * samples))
    return min(costs)


def candidates(records: Sequence[tuple[Array, Array]]) -> list[list[tuple[int, ...]]]:
    """Return candidate delays, `[output][input]`.

    They are (0,) for a delay of fewer than `SHORTEST` samples, and empty without a significant
    effect.
    """
    ny, nu = records[0][0].shape[1], records[0][1].shape[1]
    delays: list[list[tuple[int, ...]]] = [[()] * nu for _ in range(ny)]
    longest = int(_SHARE * max(len(y) for y, _ in records))
    records = [(y, u) for y, u in records if len(y) > 4 * _PAST]
    if longest < 2 * _PAST or not records:
        return delays
    for j in range(nu):
        inputs = [u[:, j] for _, u in records]
        if moves(inputs) < FEWEST_MOVES:
            continue
        of_input = _whitener(inputs)
        white = [_through(of_input, x) for x in inputs]
        for k in range(ny if not current().over else 0):
            outputs = [_through(of_input, filled(y[:, k])) for y, _ in records]
            of_output = _whitener(outputs)
            left = [_through(of_output, x) for x in outputs]
            # Whitening a slow output under noise may remove an input's effect, too.
            lags = _first_lags(white, left, longest) or _first_lags(white, outputs, longest)
            if lags and lags[0] >= SHORTEST and _acts_before(records, k, j, lags):
                lags = [0]
            if lags:
                delays[k][j] = tuple(dict.fromkeys(lags)) if lags[0] >= SHORTEST else (0,)
    return delays


def _acts_before(
    records: Sequence[tuple[Array, Array]], output: int, input_: int, lags: Sequence[int]
) -> bool:
    """Return whether an input has an effect at much earlier lags: the F test of a long ARX model.

    Lightly damped systems respond at once, but correlate most after many samples.
    """
    rows = []
    nu = records[0][1].shape[1]
    samples = sum(len(y) for y, _ in records)
    past = min(_ARX_PAST, samples // (10 * (nu + 1)))
    lag = max(2, (min(lags) + 1) // 2)  # the first estimate is late by some samples
    # Tested lags, spread evenly over the much earlier ones, and lags with a possible effect.
    tested = np.unique(np.linspace(0, lag - 1, min(lag, _ARX_PAST)).astype(int))
    near = np.arange(-_ARX_PAST // 4, past + 1)
    later = np.unique(np.concatenate([candidate + near for candidate in lags]))
    later = later[later >= lag]
    for y, u in records:
        begin = max(past, int(later.max(initial=0)))
        if len(y) <= begin + 1:
            continue
        index = np.arange(begin, len(y), max((len(y) - begin) // _ARX_ROWS, 1))[:, None]
        beside = [u[index - np.arange(past + 1), i] for i in range(nu) if i != input_]
        measured = [y[index - np.arange(1, past + 1), i] for i in range(y.shape[1])]
        of_input = [u[index - later, input_], u[index - tested, input_]]
        row = np.hstack([*beside, *measured, np.ones((len(index), 1)), *of_input, y[index, output]])
        rows.append(row[~np.isnan(row).any(axis=1)])
    if not rows:
        return False
    data, others = np.concatenate(rows), -1 - len(tested)
    return explains(data[:, others:-1], data[:, -1:], data[:, :others])


def explains(tested: Array, targets: Array, others: Array) -> bool:
    """Return whether tested regressors explain targets beside others: an F test, and `_EFFECT`."""
    data = np.hstack([others, tested, targets])
    count, both = tested.shape[1], others.shape[1] + tested.shape[1]
    freedom = len(data) - both
    if freedom < both:
        return False
    size = np.linalg.norm(data, axis=0)
    r: Array = np.asarray(np.linalg.qr(data / np.where(size > 0, size, 1.0), mode="r"))
    explained = (r[both - count : both, both:] ** 2).sum(axis=0)
    left = np.maximum((np.triu(r[both:, both:]) ** 2).sum(axis=0), 1e-18 * freedom)
    significant = scipy.special.fdtri(count, freedom, 1 - _CHANCE) * count / freedom
    return bool((explained > max(_EFFECT, significant) * left).any())


def moves(inputs: Sequence[Array]) -> float:
    """Return the number of moves of an input: its squared changes, in units of the largest."""
    changes = np.concatenate([np.diff(u) for u in inputs]) ** 2
    return float(changes.sum() / max(changes.max(initial=0.0), 1e-300))


def _whitener(signals: Sequence[Array]) -> Array:
    """Return the coefficients of an autoregressive model, `(1 + _PAST,)`."""
    products = np.zeros(_PAST + 1)
    for signal in signals:
        x = signal - signal.mean()
        products += [x[: len(x) - lag] @ x[lag:] for lag in range(_PAST + 1)]
    products[0] = products[0] * (1 + 1e-6) + 1e-300
    return np.append(1.0, -scipy.linalg.solve_toeplitz(products[:-1], products[1:]))


def _through(whitener: Array, x: Array) -> Array:
    """Return the whitened signal; the first samples, without a past, are 0."""
    white = scipy.signal.lfilter(whitener, [1.0], x - x.mean())
    white[:_PAST] = 0.0
    return np.asarray(white)


def _first_lags(inputs: Sequence[Array], outputs: Sequence[Array], longest: int) -> list[int]:
    """Return the first lags from 0 on with significant correlations."""
    total = np.zeros(2 * longest + 1)
    lags = np.arange(-longest, longest + 1)
    for u, y in zip(inputs, outputs, strict=True):
        whole = scipy.signal.correlate(y, u, method="fft")
        within = abs(lags) < len(u)
        total[within] += whole[len(u) - 1 + lags[within]] / np.sqrt(len(u) - abs(lags[within]))
    usual, size = np.median(abs(total)) / 0.6745, abs(total[longest:])
    if size.max() <= max(_SIGNIFICANT * usual, 1e-300):
        return []
    least = [max(share * size.max(), _SIGNIFICANT * usual) for share in _OF_LARGEST]
    return [int(np.argmax(size >= limit)) for limit in least]
