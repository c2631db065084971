"""Estimate the delay of each input at each output: the sample where its impulse response begins.

The dead time of a held input is one sample less, as it acts one sample late by itself. A delay of
many samples would cost a linear model as many states and a network as long a memory.
Shifting the input by its delay avoids both. A first estimate is the first significant lag of the
cross-correlation of whitened signals (Box and Jenkins, Time Series Analysis, Ch. 12); it is then
moved to where the error of linear models of low order is least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from splitband.baselines.refinement import Run, blocks_of, refined
from splitband.baselines.subspace import stable, subspace
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import current
from splitband.runtime.errors import InputError

LONGEST_DELAY = 100_000
"""Longest delay in samples that a file may ask for: bounds the memory of a stream."""
_PAST = 12
"""Order of the models that whiten the signals. By eye."""
_SIGNIFICANT = 5.5
"""Correlation of an input with effect, in standard deviations of those without. By eye."""
_OF_LARGEST = (0.35, 0.7, 1.0)
"""A candidate is the first lag with this share of the largest correlation: as levels that are held
for some samples are correlated by chance, the first significant one may be early. By eye."""
_ARX_PAST = 30
"""Past samples of each signal in the ARX model that tests earlier lags. By eye."""
_ARX_ROWS = 8000
"""Most samples of a record in it. By eye."""
_CHANCE = 1e-6
"""Probability that earlier lags without effect are significant. By eye."""
_EFFECT = 0.03
"""Share of the residual's power that they explain at least, as the model is but nearly right.
By eye."""
_SHARE = 0.4
"""Longest delay that is searched, as a share of the longest record. By eye."""
SHORTEST = 2
"""Shortest first estimate, in samples, that is not taken to be 0: many systems answer one sample
late. By eye."""

_SEARCHED = 20_000
"""Most samples on which delays are compared. By eye."""
_ROWS = 10
"""Block rows of the subspace models that compare delays. By eye."""
_DELAY_ORDERS = (1, 2, 4)
"""Orders of the models that compare delays. By eye."""


def check_delays(delays: Sequence[int], inputs: int) -> None:
    """Check the number and range of delays, which may come from a file; raises ValueError."""
    if len(delays) != inputs:
        raise InputError(f"delays must be those of {inputs} inputs, got {len(delays)}")
    for delay in delays:
        whole("delays", delay, 0, LONGEST_DELAY)


def delayed(u: Array, delays: Sequence[int]) -> Array:
    """Return inputs `(time, nu)`, each delayed in samples; the first value is held before it."""
    if not any(delays):
        return u
    rows = np.arange(len(u))[:, None] - np.asarray(delays)
    return np.asarray(np.take_along_axis(u, np.maximum(rows, 0), axis=0))


@dataclass(frozen=True, eq=False)
class Units:
    """Hold mean and standard deviation of the signals in all records."""

    y_mean: Array
    y_scale: Array
    u_mean: Array
    u_scale: Array

    @classmethod
    def of(cls, records: Sequence[tuple[Array, Array]]) -> Units:
        """Return those of records; the scale of a constant signal is 1."""
        y = np.concatenate([y for y, _ in records])
        u = np.concatenate([u for _, u in records])

        def scale(x: Array) -> Array:
            flat = np.nanmax(x, axis=0) == np.nanmin(x, axis=0)
            return np.where(flat, 1.0, np.nanstd(x, axis=0))

        return cls(np.nanmean(y, axis=0), scale(y), np.nanmean(u, axis=0), scale(u))

    def run(self, y: Array, u: Array, delays: Sequence[int]) -> Run:
        """Return a record with delayed inputs for a fit."""
        outputs = ((y - self.y_mean) / self.y_scale).T
        inputs = (delayed(u, delays) - self.u_mean) / self.u_scale
        measured = (~np.isnan(outputs)).astype(np.float64)
        if 0 < (late := max(delays, default=0)) < len(y) // 2:
            measured[:, :late] = 0.0  # the inputs that act here are not known
        return Run(np.ascontiguousarray(inputs.T), np.where(measured > 0, outputs, 0.0), measured)

    def outputs(self, some: Sequence[int]) -> Units:
        """Return the units of some outputs."""
        return replace(self, y_mean=self.y_mean[[*some]], y_scale=self.y_scale[[*some]])


def delays_of(records: Sequence[tuple[Array, Array]], units: Units | None = None) -> Array:
    """Return the delay of each input at each output in samples, `(ny, nu)`."""
    units = Units.of(records) if units is None else units
    found = candidates(records)
    chosen = np.zeros((len(found), len(found[0])), int)
    for k, of_inputs in enumerate(found):
        if any(lags not in ((), (0,)) for lags in of_inputs) and not current().over:
            chosen[k] = _compared(
                [(y[:, [k]], u) for y, u in records], units.outputs([k]), of_inputs
            )
    acts = np.array([[bool(lags) for lags in of_inputs] for of_inputs in found])
    # Where an input shows no effect, its delay is that at the other outputs.
    least = np.where(acts, chosen, np.iinfo(int).max).min(axis=0)
    return np.where(acts, chosen, np.where(acts.any(axis=0), least, 0))


def input_delays(records: Sequence[tuple[Array, Array]]) -> tuple[int, ...]:
    """Return the least delay of each input in samples.

    `records` are `y` `(time, ny)`, NaN in gaps, and `u` `(time, nu)` of each.
    """
    return tuple(delays_of(records).min(axis=0).tolist())


def _compared(
    records: Sequence[tuple[Array, Array]], units: Units, lags: Sequence[tuple[int, ...]]
) -> list[int]:
    """Return the delays of the inputs of one output with which low orders fit best."""
    records = [(y[:_SEARCHED], u[:_SEARCHED]) for y, u in records]
    samples = sum(int((~np.isnan(y)).sum()) for y, _ in records)
    known: dict[tuple[int, ...], float] = {}
    longest = max(len(y) for y, _ in records) // 2

    def cost(delays: Sequence[int]) -> float:
        key = tuple(delays)
        if key not in known:
            known[key] = _low_order_cost([units.run(y, u, delays) for y, u in records], samples)
        return known[key]

    best = [of_input[-1] if of_input else 0 for of_input in lags]
    for j, of_input in enumerate(lags):
        if of_input not in ((), (0,)):
            best = _one_delay(best, j, of_input, cost, longest, np.log(samples) / (2 * samples))
    return best


def _one_delay(
    begin: list[int],
    j: int,
    of_input: Sequence[int],
    cost: Callable[[Sequence[int]], float],
    longest: int,
    little: float,
) -> list[int]:
    """Return the delays with that of the input `j` where `cost` is least.

    `of_input` are its first estimates, `longest` is the longest delay, and `little` the difference
    that does not count.
    """

    def at(delay: int) -> list[int]:
        return [*begin[:j], delay, *begin[j + 1 :]]

    best = min((*of_input, 0), key=lambda d: cost(at(d)))
    for step in (8, 4, 2, 1):
        while not current().over:
            near = [d for d in (best - step, best + step) if 0 <= d <= longest]
            closer = min(near, key=lambda d: cost(at(d)))
            if cost(at(closer)) >= cost(at(best)):
                break
            best = closer
    # Of delays that explain as much as the best, the longest is where the input acts first.
    least = cost(at(best))
    while best < longest and cost(at(best + 1)) < least + little:
        best += 1
    # A delay explains more than a further parameter.
    return at(0) if cost(at(0)) < least + little else at(best)


def _low_order_cost(runs: Sequence[Run], samples: int) -> float:
    """Return the information criterion of the best model of a low order, per sample."""
    found = subspace([(np.where(r.measured > 0, r.y, np.nan).T, r.u.T) for r in runs], _ROWS)
    costs = []
    for order in _DELAY_ORDERS if found is not None else ():
        assert found is not None
        a, c = found.matrices(order)
        at = refined(blocks_of(stable(a), c, [True] * len(runs[0].u)), runs, 3)
        costs.append(at.cost + order * (1 + len(runs[0].u)) * np.log(samples) / (2 * samples))
    return min(costs, default=np.inf)


def candidates(records: Sequence[tuple[Array, Array]]) -> list[list[tuple[int, ...]]]:
    """Return candidates of the delay of each input at each output, `[output][input]`.

    They are (0,) for an input that acts after fewer than `SHORTEST` samples, and empty for one
    without a significant effect.

    Parameters
    ----------
    records : `y` `(time, ny)`, NaN in gaps, and `u` `(time, nu)` of each.
    """
    ny, nu = records[0][0].shape[1], records[0][1].shape[1]
    found: list[list[tuple[int, ...]]] = [[()] * nu for _ in range(ny)]
    longest = int(_SHARE * max(len(y) for y, _ in records))
    records = [(y, u) for y, u in records if len(y) > 4 * _PAST]
    if longest < 2 * _PAST or not records:
        return found
    for j in range(nu):
        inputs = [u[:, j] for _, u in records]
        if max(map(np.ptp, inputs)) == 0:
            continue
        of_input = _whitener(inputs)
        white = [_through(of_input, x) for x in inputs]
        for k in range(ny):
            outputs = [_through(of_input, filled(y[:, k])) for y, _ in records]
            of_output = _whitener(outputs)
            left = [_through(of_output, x) for x in outputs]
            # A slow output under noise loses an input's effect together with its slowness.
            lags = _first_lags(white, left, longest) or _first_lags(white, outputs, longest)
            if lags and lags[0] >= SHORTEST and _acts_before(records, k, j, lags):
                lags = [0]
            if lags:
                found[k][j] = tuple(dict.fromkeys(lags)) if lags[0] >= SHORTEST else (0,)
    return found


def _acts_before(
    records: Sequence[tuple[Array, Array]], output: int, input_: int, lags: Sequence[int]
) -> bool:
    """Return whether an input has an effect at much earlier lags, beside all that is past.

    This is the F test of a long ARX model. Lightly damped systems correlate most after many
    samples, although they act at once.
    """
    rows, wanted = [], []
    nu = records[0][1].shape[1]
    samples = sum(len(y) for y, _ in records)
    past = min(_ARX_PAST, samples // (10 * (nu + 1)))
    lag = max(2, (min(lags) + 1) // 2)  # the first estimate is late by some samples
    # Lags that are tested, evenly over all that are much earlier, and those that may act.
    tested = np.unique(np.linspace(0, lag - 1, min(lag, _ARX_PAST)).astype(int))
    near = np.arange(-_ARX_PAST // 4, past + 1)
    later = np.unique(np.concatenate([each + near for each in lags]))
    later = later[later >= lag]
    for y, u in records:
        begin = max(past, int(later.max(initial=0)))
        if len(y) <= begin + 1:
            continue
        index = np.arange(begin, len(y))[:, None]
        others = [u[index - np.arange(past + 1), i] for i in range(nu) if i != input_]
        measured = [y[index - np.arange(1, past + 1), i] for i in range(y.shape[1])]
        own = [u[index - tested, input_], u[index - later, input_]]
        row = np.hstack([*own, *others, *measured, np.ones((len(index), 1))])
        whole = ~np.isnan(row).any(axis=1) & ~np.isnan(y[begin:, output])
        rows.append(row[whole][:_ARX_ROWS])
        wanted.append(y[begin:, output][whole][:_ARX_ROWS])
    if not rows:
        return False
    x, target = np.concatenate(rows), np.concatenate(wanted)
    count, freedom = len(tested), len(x) - x.shape[1]
    if freedom < x.shape[1]:
        return False
    scale = np.linalg.norm(x, axis=0)
    x = np.column_stack([x[:, count:], x[:, :count], target]) / np.where(
        np.append(np.roll(scale, -count), 1.0) > 0, np.append(np.roll(scale, -count), 1.0), 1.0
    )
    r = np.asarray(np.linalg.qr(x, mode="r"))[:, -1]
    power, left = float((r[-1 - count : -1] ** 2).sum()) / count, float(r[-1] ** 2) / freedom
    floor = (1e-9 * np.linalg.norm(target)) ** 2
    least = max(scipy.stats.f.isf(_CHANCE, count, freedom), _EFFECT * freedom / count)
    return bool(power > least * max(left, floor))


def filled(y: Array) -> Array:
    """Fill gaps by linear interpolation; a channel without a sample is 0."""
    rows = np.flatnonzero(~np.isnan(y))
    return np.interp(np.arange(len(y)), rows, y[rows]) if len(rows) else np.zeros_like(y)


def _whitener(signals: Sequence[Array]) -> Array:
    """Return the coefficients of an autoregressive model, `(1 + _PAST,)`."""
    products = np.zeros(_PAST + 1)
    for signal in signals:
        x = signal - signal.mean()
        products += [x[: len(x) - lag] @ x[lag:] for lag in range(_PAST + 1)]
    products[0] = products[0] * (1 + 1e-6) + 1e-300
    return np.append(1.0, -scipy.linalg.solve_toeplitz(products[:-1], products[1:]))


def _through(whitener: Array, x: Array) -> Array:
    """Return the whitened signal; its first samples, which lack a past, are 0."""
    white = scipy.signal.lfilter(whitener, [1.0], x - x.mean())
    white[:_PAST] = 0.0
    return np.asarray(white)


def _first_lags(inputs: Sequence[Array], outputs: Sequence[Array], longest: int) -> list[int]:
    """Return the first lags from 0 on with significant correlations; none without one."""
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
    return [int(np.argmax(size >= each)) for each in least]
