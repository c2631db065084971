"""Choose the order of a linear model and its integrators by held-out simulation error.

The records are cut into segments. The model without a segment follows from the model of all samples
by one step of the normal equations without the segment. It simulates the record from its own
initial state, and its error in the segment is held out. The smallest order with an error at most
one standard error above the least is chosen (L. Breiman et al., Classification and Regression
Trees, 1984, Sec. 3.4).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from splitband.linear.refinement import (
    Signals,
    Solution,
    begun,
    blocks_of,
    by_segment,
    followed,
    length,
    linear_solution,
    refined,
    segments,
    solved,
    total,
)
from splitband.linear.subspace import Subspace, filled, most_rows, stable, subspace
from splitband.linear.uncertainty import NORMAL, uncertainty_of
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError, current

SEGMENTS = 10
"""Number of segments, over all records. Bounds the time."""
_MOST, _MOST_FOR_SEVERAL = 40, 60
"""Largest order for one output and for several. The largest published benchmark needs 44."""
_SAMPLES_EACH = 6
"""Fewest samples per parameter. Checked by halving and doubling."""
_STRIDES = (1, 4, 16, 64)
"""Numbers of averaged samples in subspace estimates of slow systems. Bounds the time."""
ITERATIONS = 12
"""Largest number of iterations of a refinement; half for a large candidate. Bounds the time."""
_MISSES = 4
"""Number of orders in a row without a gain at the end of the search. Bounds the time."""
_MOST_REDUCED = 8
"""Largest order for reduction pole by pole. With wandering inputs, a subspace has a pole near 1 in
the place of a pair, which no refinement corrects: the linear model of the demo then has half as
much again of error. Checked by halving and doubling."""
_NEAR = 0.7
"""Least candidate order above 8, as a share of the order by singular values. Bounds the time."""
_ALWAYS = 3
"""Largest order of the candidates in every search: nonlinear systems continue best with few poles.
Without these orders five of 44 records lose 13 to 65 % of fit, one gains."""
_ORDERS = (*range(1, 9), *range(10, 26, 2), 28, 32, 36, 40, 44, 48, 54, 60)
"""Candidate orders. Bounds the time."""
_MOST_AVERAGED = 8
"""Largest order from averaged samples, for slow systems. See docs/developers/rules.md."""
_TOLERANCE = 0.01
"""Negligible difference of the logarithms of held-out errors. Checked by halving and doubling.
"""
_NEGLIGIBLE = 1e-6
"""Smallest held-out RMS error, in standard deviations of the output. Rounding."""
_DIVERGED = 1e30
"""Upper limit of mean squared errors."""
_DAMPED = 1e-6
"""Damping of the step to the model without a segment. Rounding."""
_SLOW = 15.0
"""Least time constant of a possible integrator: the longest record divided by this number. Checked
by halving and doubling."""
_DECAYED = 3.0
"""Least decay of a vibration over the longest record, in e-foldings: a slower one is not
distinguishable from a sustained vibration, and would respond to all later inputs. Without a limit,
3 of 30 records of `benchmarks.driven` lost 14 to 110 % of fit, and none gained."""


@dataclass(frozen=True, eq=False)
class OrderCandidate:
    """A fitted model.

    solution : The model.
    power : Held-out mean squared error by segment and output, NaN without measurements.
    integrators : Number of poles fixed at 1.
    """

    solution: Solution
    power: Array
    integrators: int = 0

    @property
    def order(self) -> int:
        """Return the number of poles."""
        return self.solution.blocks.order

    @property
    def error(self) -> float:
        """Return the held-out RMS error, a geometric mean over the outputs."""
        power = np.nanmean(self.power, axis=0) + _NEGLIGIBLE**2
        return float(np.exp(0.5 * np.log(power).mean()))

    def as_good_as(self, other: OrderCandidate) -> bool:
        """Return whether this candidate is worse by at most one standard error of the difference.

        The comparison is of logarithms, with equal weights of the outputs.
        """
        floor = _NEGLIGIBLE**2
        worse = 0.5 * np.nanmean(np.log((self.power + floor) / (other.power + floor)), axis=1)
        error = float(worse.std(ddof=1)) / np.sqrt(len(worse)) if len(worse) > 1 else 0.0
        return bool(worse.mean() <= max(error, _TOLERANCE))


@dataclass(eq=False)
class OrderSearch:
    """The search for the order of a model of some outputs.

    runs : The records, normalised.
    direct : Whether an input has feedthrough, `nu` flags.
    integrators : The number of integrators, or None to choose it.
    most : Largest order.
    values : Singular values of the data, once computed.
    errors : Held-out RMS error by order.
    """

    runs: Sequence[Signals]
    direct: Sequence[bool]
    integrators: int | None = None
    most: int | None = None
    values: Array = field(default_factory=lambda: np.zeros(0))
    errors: dict[int, float] = field(default_factory=dict)
    _subspaces: list[Subspace] = field(default_factory=list)
    _grid: dict[int, float] = field(default_factory=dict)
    _starts: dict[int, Solution | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Compute the subspaces."""
        ny, nu = len(self.runs[0].y), len(self.runs[0].u)
        samples = sum(float(run.measured.sum()) for run in self.runs) / ny
        largest = int((samples / _SAMPLES_EACH - nu - 1) * ny / (nu + ny))
        largest = max(min(largest, _MOST if ny == 1 else _MOST_FOR_SEVERAL), 1)
        self.most = largest if self.most is None else min(self.most, largest)
        self._subspaces = [*_subspaces(self.runs, self.most)]
        if self._subspaces:
            self.values = self._subspaces[0].values

    @property
    def shown(self) -> int:
        """Return the order by singular values (D. Bauer, Automatica 37, 2001, SVC)."""
        size = np.arange(max(len(self.values) - 1, 0))
        ny, samples = len(self.runs[0].y), length(self.runs)
        penalty = (2 * ny + len(self.direct)) * np.log(samples) / samples
        return int(np.argmin(self.values[size] ** 2 + size * penalty)) if len(size) else 0

    @property
    def limit(self) -> float:
        """Return the largest absolute value of a complex pole."""
        return float(np.exp(-_DECAYED / max(run.u.shape[1] for run in self.runs)))

    def of_order(self, order: int, larger: OrderCandidate | None = None) -> OrderCandidate | None:
        """Return the refined model of this order, possibly from a `larger` one, reduced."""
        if self.integrators:
            return self._with_integrators(order, self.integrators)
        iterations = ITERATIONS if order <= _MOST_AVERAGED else ITERATIONS // 4
        return self._refined(self.start_of(order, larger), self.runs, iterations)

    def _refined(
        self, begin: Solution | None, runs: Sequence[Signals], iterations: int, integrators: int = 0
    ) -> OrderCandidate | None:
        if begin is None:
            return None
        at = refined(begin, runs, iterations, self.limit)
        return OrderCandidate(at, held_out(at, runs), integrators)

    def on_all(self, chosen: OrderCandidate, runs: Sequence[Signals]) -> Solution:
        """Return the chosen model, refined on whole records; `self.runs` may be an excerpt.

        Slow poles, not visible in an excerpt, come from a subspace of averaged samples, and
        integrators have to hold out on whole records.
        """
        blocks = chosen.solution.blocks
        fitted = with_constant(runs) if blocks.constant else runs
        if length(runs) == length(self.runs):
            return refined(chosen.solution, fitted, ITERATIONS, self.limit)
        at = begun(blocks, fitted)
        if current().over:
            return at
        with suppress(DeadlineError):
            at = linear_solution(blocks, fitted)
            whole = OrderSearch(runs, self.direct, self.integrators, chosen.order)
            if not blocks.constant:
                at = min(at, whole.start_of(chosen.order) or at, key=lambda at: at.cost)
            at = refined(at, fitted, ITERATIONS // 2, whole.limit)
            if not blocks.constant or self.integrators is not None:
                return at
            free = whole.of_order(chosen.order)
            refit = OrderCandidate(at, held_out(at, fitted), chosen.integrators)
            if free and not (refit.as_good_as(free) and whole.lasts(refit, free)):
                return free.solution
        return at

    def first(self) -> OrderCandidate:
        """Return the first guess: the model of the order with the best information criterion."""
        self._grid = dict(sorted(self._criteria()))
        least = max(self.integrators or 0, 1)
        order = min(self._grid, key=lambda n: self._grid[n], default=least)
        return self.of_order(order) or self.of_order(least) or self._constant()

    def best(self) -> OrderCandidate:
        """Return the model of the chosen order, from the best by BIC to smaller ones."""
        first = self.first()
        if not (grid := self._grid):
            return first
        order, by_order = first.order, {first.order: first}

        def attempt(n: int) -> OrderCandidate:
            if n not in by_order and not current().over:
                larger = by_order.get(min((m for m in by_order if m > n), default=n))
                if (new := self.of_order(n, larger)) is not None:
                    by_order[n] = new
            # The smallest order as good as the best.
            least = min(by_order.values(), key=lambda c: c.error)
            return by_order[min(m for m, c in by_order.items() if c.as_good_as(least))]

        small = [n for n in grid if n <= min(order, _ALWAYS)]
        near = [n for n in grid if n > order][:1] + [n for n in grid if n == self.shown]
        for n in (order, *near, *small[::-1]):
            best = attempt(n)
        for n in reversed([n for n in grid if n < best.order]):
            best = attempt(n)
            if best.order != n:
                break
        if self.integrators is None:
            best = self.integrating(best)
        self.errors = {n: by_order[n].error for n in sorted(by_order)}
        return best

    def integrating(self, free: OrderCandidate, fixed: int | None = None) -> OrderCandidate:
        """Return the model with integrators in place of the slowest poles, if as good held out.

        Unless the order is `fixed`, it may have fewer poles, or more: a fit without an actual
        integrator often misses other poles, too. Orders are tried until a larger one is no better,
        with as many integrators as slow poles, and with one more.
        """
        longest = max(run.u.shape[1] for run in self.runs)
        poles = np.linalg.eigvals(free.solution.blocks.matrices()[0])
        slow = int((abs(1 - poles) < _SLOW / longest).sum())
        fits, least = [free], free
        for count in range(1, min(slow, len(self.runs[0].y)) + 2 if slow else 1):
            smaller, largest = None, min(least.order, _MOST_AVERAGED) + 1
            for order in range(count, largest + 1) if fixed is None else [fixed] * (fixed >= count):
                larger = None if current().over else self._with_integrators(order, count)
                if larger is not None:
                    fits.append(larger)
                    least = min(fits, key=lambda c: c.error)
                    if smaller is not None and smaller.as_good_as(least):
                        break
                    smaller = larger
        good = [c for c in fits if c.as_good_as(least)]
        chosen = min(good, key=lambda c: (c.order, -c.integrators))
        return chosen if self.lasts(chosen, free) else free

    def lasts(self, chosen: OrderCandidate, free: OrderCandidate) -> bool:
        """Return whether the slowest pole certainly decays little over the record.

        If the upper limit of its decay exceeds `_DECAYED`, an apparent integrator may be a
        nonlinearity or chance, and would drift in a longer simulation. Several integrators are
        judged by the held-out error alone: a free fit often misses all of them.
        """
        if chosen.integrators != 1 or current().over:
            return True
        same = free if free.order == chosen.order else self.of_order(chosen.order)
        if same is None:
            return True
        longest = max(run.u.shape[1] for run in self.runs)
        estimate = uncertainty_of(same.solution, self.runs, same.solution.matrices, longest)
        pole, error = estimate.poles[0], estimate.pole_errors[0, 2]
        return bool(pole.imag != 0 or not longest * (1 - abs(pole) + NORMAL * error) > _DECAYED)

    def _constant(self) -> OrderCandidate:
        """Return a model of one pole without a subspace, for records with few samples."""
        ny = len(self.runs[0].y)
        at = linear_solution(blocks_of(np.array([[0.5]]), np.ones((ny, 1)), self.direct), self.runs)
        return OrderCandidate(at, held_out(at, self.runs))

    def _criteria(self) -> Iterator[tuple[int, float]]:
        """Yield orders with the information criteria (BIC) of the subspace's poles.

        The order by singular values comes first, then small orders, and larger ones near the first.
        """
        assert self.most is not None
        ny, least, misses = len(self.runs[0].y), np.inf, 0
        samples = sum(float(run.measured.sum()) for run in self.runs) / ny
        shown = self.shown
        others = (n for n in _ORDERS if n <= self.most and (n <= 8 or n >= _NEAR * shown))
        for order in dict.fromkeys([*([shown] if 0 < shown <= self.most else []), *others]):
            if (start := self.start_of(order)) is None:
                return
            scale = np.maximum(start.scale, _NEGLIGIBLE)
            parameters = order * (ny + len(self.direct))
            criterion = float(2 * samples * np.log(scale).sum() + parameters * np.log(samples))
            yield order, criterion
            misses = 0 if criterion < least else misses + 1
            least = min(least, criterion)
            if current().over or (misses >= _MISSES and order >= shown):
                return

    def start_of(self, order: int, larger: OrderCandidate | None = None) -> Solution | None:
        """Return the best model with stable poles of a subspace, or of a reduced model."""
        if order not in self._starts:
            self._starts[order] = self._fitted(self._matrices(order))
        if larger is None or larger.order > _MOST_REDUCED:
            return self._starts[order]
        a, _, c, _ = larger.solution.blocks.matrices()
        reduced = self._fitted(reductions(a, c, larger.order - order))
        both = [at for at in (self._starts[order], reduced) if at is not None]
        return min(both, key=lambda at: at.cost, default=None)

    def _fitted(self, tried: Iterable[tuple[Array, Array]]) -> Solution | None:
        """Return the best model of pairs A and C, by linear least squares."""
        starts = (
            linear_solution(blocks_of(stable(a, self.limit), c, self.direct), self.runs)
            for a, c in tried
        )
        return min(starts, key=lambda at: at.cost, default=None)

    def _matrices(self, order: int) -> Iterator[tuple[Array, Array]]:
        """Yield pairs A and C of this order; of averaged samples for small orders only."""
        for space in self._subspaces:
            if order <= space.largest and (space.stride == 1 or order <= _MOST_AVERAGED):
                yield space.matrices(order)

    def _with_integrators(self, order: int, count: int) -> OrderCandidate | None:
        """Return the refined model with `count` poles at 1 and a constant flow."""
        runs, direct = with_constant(self.runs), [*self.direct, False]
        starts = []
        for a, c in self._matrices(order):
            for chain in (False, True):
                if (not chain and count <= len(c)) or (chain and 1 < count <= len(c) + 1):
                    blocks = replace(
                        blocks_of(stable(a, self.limit), c, direct, count, chain), constant=True
                    )
                    if blocks.fixed.any():
                        starts.append(linear_solution(blocks, runs))
        begin = min(starts, key=lambda at: at.cost, default=None)
        return self._refined(begin, runs, ITERATIONS, count)


def with_constant(runs: Sequence[Signals]) -> list[Signals]:
    """Return the records with 1 as a further input."""
    return [run._replace(u=np.vstack([run.u, np.ones((1, run.u.shape[1]))])) for run in runs]


def reductions(a: Array, c: Array, fewer: int) -> Iterator[tuple[Array, Array]]:
    """Yield A and C without every real pole, or every pair; complex poles go in pairs."""
    poles, vectors = np.linalg.eig(a)
    modes, basis = scipy.linalg.cdf2rdf(poles, vectors)
    for dropped in itertools.combinations(range(len(poles)), fewer) if fewer <= 2 else ():
        if poles[[*dropped]].sum().imag == 0:
            rest = np.delete(np.arange(len(poles)), dropped)
            yield np.asarray(modes[np.ix_(rest, rest)]), np.asarray(c @ basis[:, rest])


def held_out(solution: Solution, runs: Sequence[Signals]) -> Array:
    """Return the mean squared errors of held-out segments, `(segments, ny)`."""
    blocks, cut = solution.blocks, segments(runs, SEGMENTS)
    parts = by_segment(solution, runs, blocks.free, cut)
    whole, powers = total(parts), []
    for part, (record, begin, end) in zip(parts, cut, strict=True):
        step, states = solved(whole.plus(part, -1.0), _DAMPED, whole)
        if begin == 0:  # the initial state depends on this segment alone
            states |= followed(part, step, _DAMPED, whole)
        move, first = np.zeros(len(blocks.free)), states[record]
        move[blocks.free] = step
        for _ in range(6):
            moved = blocks.moved(move)
            if moved.stable():
                break
            move, first = move / 2, first / 2
        run = Signals(*(signal[:, :end] for signal in runs[record]))
        with np.errstate(over="ignore", invalid="ignore"):
            y = moved.simulate(run, solution.first[record] + first.reshape(-1, 2))
            left = ((run.y - y) * run.measured)[:, begin:]
            measured = run.measured[:, begin:].sum(axis=1)
            power = (left**2).sum(axis=1) / np.maximum(measured, 1)
        power = np.minimum(np.nan_to_num(power, nan=_DIVERGED, posinf=_DIVERGED), _DIVERGED)
        powers.append(np.where(measured > 0, power, np.nan))
    return np.array(powers)


def _subspaces(runs: Sequence[Signals], most: int) -> Iterator[Subspace]:
    """Yield the subspaces of the records at several rates."""
    ny, nu = len(runs[0].y), len(runs[0].u)
    records = [(np.where(run.measured > 0, run.y, np.nan).T, run.u.T) for run in runs]
    samples = sum(run.u.shape[1] for run in runs)
    for stride in _STRIDES:
        count = samples // stride
        fits = min(count // (3 * (ny + nu)), most_rows(count, len(runs), ny + nu))
        rows = min(most // ny + 2, 42) if stride == 1 else 12
        rows = min(max(rows, 10), fits, 60)
        if rows < 2 or (stride > 1 and rows < 8):
            return
        space = subspace(records, rows, stride)
        if space is None and stride == 1:
            whole = [(np.apply_along_axis(filled, 0, y), u) for y, u in records]
            space = subspace(whole, rows, stride)
        if space is not None:
            yield space
        if current().over:
            return
