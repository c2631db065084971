"""Fit a linear system, as a sum of blocks of one or two poles, by least squares of its error.

A block is x_{t+1} = [[a_1, a_2], [1, 0]] x_t + B u_t, y_t += C x_t, with two real, complex or equal
poles. A first-order block has a_2 = 0 and one state. The form is nearly minimal, the responses of
blocks and their derivatives are filters of second order (`scipy.signal.lfilter`), and the normal
equations of a least-squares fit (Levenberg and Marquardt) follow from products of few signals,
chunk by chunk of the time: an iteration of 40 states and 16,000 samples takes a tenth of a second,
and a million samples need the memory of a chunk. For long records the matrix of the normal
equations is that of every n-th sample, the right-hand side that of all samples.

With the record's inputs the criterion is the output error. With inputs and measured outputs as the
inputs of the predictor, the same code minimises the prediction error. See L. Ljung, System
Identification, 2nd ed., Ch. 7 and 10. The records' initial states are eliminated from the normal
equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array, Flags
from splitband.runtime.deadlines import DeadlineError, check, current

_RADIUS = 1 - 1e-9
"""Largest absolute value of a free pole; 1 is an integrator."""
_SPLIT = 1e-9
"""Least distance of two poles of a block, as a diagonal block with equal poles has no companion
form. Rounding."""

_STEPS = 8
"""Largest number of damped trial steps. Bounds the time."""
_CONVERGED = 0.1
"""Least gain in log-likelihood of an iteration. A parameter without effect gains 1/2 on average:
smaller steps are within the noise."""
_NEGLIGIBLE = 1e-4
"""Least share by which an iteration lowers the RMS error. Bounds the time."""
_CHUNK = 4096
"""Samples of a chunk of derivatives. Bounds the memory, and the time by the cache."""
_WINDOWS = 6
"""Windows of an excerpt of long records. By eye."""
MOST_SAMPLES = 20_000
"""Largest number of samples in the choice of order and delays. Bounds the time."""
_RIDGE = 1e-10
"""Addition to the normal equations, as a share of their diagonal: some directions have no effect.
Rounding."""
_EXACT = 1e-10
"""Smallest RMS of normalised errors. Rounding."""


class Signals(NamedTuple):
    """Inputs `(nu, time)`, outputs `(ny, time)` with 0 in gaps, and where they are `measured`."""

    u: Array
    y: Array
    measured: Array


@dataclass(frozen=True, eq=False)
class Blocks:
    """The parameters of all blocks.

    a : `(blocks, 2)`.
    b : `(blocks, 2, nu)`.
    c : `(blocks, ny, 2)`.
    d : `(ny, nu)`.
    offset : `(ny,)`.
    single : Whether a block has one pole, `(blocks,)`.
    fixed : Whether a block's poles are given, `(blocks,)`.
    direct : Whether an input has feedthrough, `(nu,)`.
    constant : Whether the last input is the constant 1, for fixed blocks alone.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    offset: Array
    single: Flags
    fixed: Flags
    direct: Flags
    constant: bool = False

    @property
    def kept(self) -> Flags:
        """Return a mask of the blocks' states, `(blocks, 2)`: one of first order has one."""
        return np.stack([np.ones(len(self.a), bool), ~self.single], axis=1)

    @property
    def order(self) -> int:
        """Return the number of poles."""
        return int(self.kept.sum())

    @cached_property
    def free(self) -> Flags:
        """Return a mask of the parameters among `values`."""
        ny, states = len(self.offset), self.kept
        of_b = np.repeat(states[:, :, None], len(self.direct), axis=2)
        if self.constant:
            of_b[:, :, -1] &= self.fixed[:, None]
        parts = (
            states & ~self.fixed[:, None],
            of_b,
            np.repeat(states[:, None], ny, axis=1),
            np.repeat(self.direct[None], ny, axis=0),
            np.ones(ny, bool),
        )
        return np.concatenate([part.ravel() for part in parts])

    @property
    def linear(self) -> Flags:
        """Return a mask of the parameters linear in the output, for given poles and C."""
        linear = self.free.copy()
        a, _, c, *_ = self.parts(np.arange(len(linear)))
        linear[a] = linear[c] = False
        return linear

    @property
    def values(self) -> Array:
        """Return all numbers as one vector."""
        parts = self.a, self.b, self.c, self.d, self.offset
        return np.concatenate([part.ravel() for part in parts])

    def moved(self, step: Array) -> Blocks:
        """Return the system with `step` added to `values`."""
        a, b, c, d, offset = self.parts(self.values + step)
        return replace(self, a=a, b=b, c=c, d=d, offset=offset)

    def parts(self, values: npt.NDArray[Any]) -> list[Any]:
        """Return `values` in the shapes of a, b, c, d and offset."""
        shapes = self.a, self.b, self.c, self.d, self.offset
        cuts = np.cumsum([part.size for part in shapes])[:-1]
        return [v.reshape(o.shape) for v, o in zip(np.split(values, cuts), shapes, strict=True)]

    def stable(self, limit: float = 1.0) -> bool:
        """Return whether all free poles are stable, and complex ones smaller than `limit`."""
        free = ~self.fixed
        first, second = self.a[free, 0] / _RADIUS, self.a[free, 1] / _RADIUS**2
        complex_ = self.a[free, 0] ** 2 + 4 * self.a[free, 1] < 0
        inside = (abs(second) < 1) & (abs(first) < 1 - second)
        return bool((inside & (~complex_ | (-self.a[free, 1] < limit**2))).all())

    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D, without the second states of first-order blocks."""
        states = self.kept.ravel()
        companions = [np.array([row, [1.0, 0.0]]) for row in self.a]
        a = scipy.linalg.block_diag(*companions)[np.ix_(states, states)]
        b = self.b.reshape(-1, self.b.shape[2])[states]
        c = self.c.transpose(1, 0, 2).reshape(len(self.offset), -1)[:, states]
        return a, b, c, self.d

    def simulate(self, run: Signals, first: Array) -> Array:
        """Return the outputs `(ny, time)` from the initial states `(blocks, 2)` on."""
        y = self.d @ run.u + self.offset[:, None]
        for row, b, c, x in zip(self.a, self.b, self.c, first, strict=True):
            y += c @ _states(row, b @ run.u, x)
        return y

    def chunks(self, run: Signals, first: Array) -> Iterator[tuple[slice, Array, Array]]:
        """Yield chunks of time with the states and their derivatives.

        The states are `(blocks, 2, chunk)`, their derivatives `(blocks, 2, 4 + 2 nu, chunk)`: by a,
        by b and by the initial states of the block. The derivatives are the filtered states, inputs
        and impulse, as a force on one of the states acts one and two samples late.
        """
        nu, time = run.u.shape
        of_u, of_b = slice(2, 2 + nu), slice(2 + nu, 2 + 2 * nu)
        before = np.zeros((len(self.a), 3 + nu, 2))  # memories of the filters, and last outputs
        last, now_x = before.copy(), first
        for begin in range(0, time, _CHUNK):
            here = slice(begin, min(begin + _CHUNK, time))
            u = run.u[:, here]
            impulse = np.zeros((1, u.shape[1]))
            impulse[0, 0] = begin == 0
            states = np.empty((len(self.a), 2, u.shape[1]))
            derivatives = np.empty((len(self.a), 2, 4 + 2 * nu, u.shape[1]))
            after = np.empty_like(now_x)
            for i, (row, (one, two)) in enumerate(zip(self.a, derivatives, strict=True)):
                forced = self.b[i] @ u
                states[i] = x = _states(row, forced, now_x[i])
                after[i] = row @ x[:, -1] + forced[0, -1], x[0, -1] + forced[1, -1]
                forces = np.vstack([x, u, impulse])
                now, before[i] = scipy.signal.lfilter([1.0], [1.0, *-row], forces, zi=before[i])
                whole = np.hstack([last[i], now])
                last[i] = whole[:, -2:]
                late, later = whole[:, 1:-1], whole[:, :-2]
                one[: 2 + nu], two[: 2 + nu] = late[:-1], later[:-1]
                one[of_b] = row[1] * later[of_u]
                two[of_b] = late[of_u] - row[0] * later[of_u]
                one[-2], two[-2] = now[-1], late[-1]
                one[-1], two[-1] = row[1] * late[-1], now[-1] - row[0] * late[-1]
            now_x = after
            yield here, states, derivatives


def _states(a: Array, forced: Array, first: Array) -> Array:
    """Return both states of a block for forces `(2, time)` on them, `(2, time)`."""
    time = forced.shape[1]
    # The first state obeys a recursion of second order: x1' = a1 x1 + a2 x2 + f1, x2' = x1 + f2.
    into = np.empty(time)
    into[0] = first[0]
    if time > 1:
        into[1:] = forced[0, :-1]
        into[1] += a[1] * first[1]
        into[2:] += a[1] * forced[1, :-2]
    x = np.empty((2, time))
    x[0] = scipy.signal.lfilter([1.0], [1.0, -a[0], -a[1]], into)
    x[1, 0] = first[1]
    x[1, 1:] = x[0, :-1] + forced[1, :-1]
    return x


def blocks_of(  # noqa: PLR0913
    a: Array,
    c: Array,
    direct: Sequence[bool],
    integrators: int = 0,
    chain: bool = False,
    b: Array | None = None,
    d: Array | None = None,
) -> Blocks:
    """Return the blocks of a system with the poles of A.

    a, c : `(states, states)` and `(ny, states)`.
    direct : Whether an input has feedthrough, `nu` flags.
    integrators : Number of poles set to 1: the nearest real ones.
    chain : Whether two integrators are a chain, one after the other.
    b, d : `(states, nu)` and `(ny, nu)`; by default zero.
    """
    ny, nu = len(c), len(direct)
    poles, vectors = np.linalg.eig(a)
    order = np.argsort(abs(poles - 1), kind="stable")
    real = [i for i in order if poles[i].imag == 0]
    pairs = [i for i in order if poles[i].imag > 0]
    # By block: the row of `Blocks.a`, the basis, and whether the poles are given.
    blocks = list[tuple[tuple[float, float], Array, bool]]()
    if chain and (pairs or len(real) > 1):
        near = len(real) > 1 and not (pairs and abs(poles[pairs[0]] - 1) < abs(poles[real[1]] - 1))
        taken = [real.pop(0), real.pop(0)] if near else [pairs.pop(0)]
        blocks.append(((2.0, -1.0), _second_order(poles[taken], vectors[:, taken])[1], True))
        integrators -= 2
    while integrators > 0 and (real or pairs):
        i = real.pop(0) if real else pairs.pop(0)
        if poles[i].imag:  # a pair becomes an integrator and another real pole, or two integrators
            two = integrators > 1
            blocks.append(((1.0 if two else poles[i].real, 0.0), vectors[:, [i]].imag, two))
            integrators -= two
        blocks.append(((1.0, 0.0), vectors[:, [i]].real, True))
        integrators -= 1
    twos = [*([i] for i in pairs), *(real[i : i + 2] for i in range(0, len(real) - 1, 2))]
    blocks += [(*_second_order(poles[two], vectors[:, two]), False) for two in twos]
    if len(real) % 2:
        blocks.append(((poles[real[-1]].real, 0.0), vectors[:, [real[-1]]].real, False))
    rows, bases, fixed = zip(*blocks, strict=True)
    sizes = [basis.shape[1] for basis in bases]
    of_b, of_c = np.zeros((len(rows), 2, nu)), np.zeros((len(rows), ny, 2))
    for i, basis in enumerate(bases):
        of_c[i, :, : sizes[i]] = c @ basis
    if b is not None:
        into = np.linalg.lstsq(np.hstack(bases), b, rcond=None)[0]
        for i, part in enumerate(np.split(into, np.cumsum(sizes)[:-1])):
            of_b[i, : sizes[i]] = part
    kinds = np.array(sizes) == 1, np.array(fixed), np.array(direct, bool)
    through = np.zeros((ny, nu)) if d is None else d
    return Blocks(np.array(rows), of_b, of_c, through, np.zeros(ny), *kinds)


def _second_order(poles: Array, vectors: Array) -> tuple[tuple[float, float], Array]:
    """Return row and basis of the block of one complex pole, or of two real ones."""
    if len(poles) == 1:
        pole, v = poles[0], vectors[:, 0]
        row, basis = (2 * pole.real, -(abs(pole) ** 2)), np.stack([v.real, v.imag], axis=1)
        modes = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
    else:
        p, q = poles.real
        if abs(p - q) < _SPLIT:
            q -= _SPLIT
        row, basis, modes = (p + q, -p * q), vectors.real, np.diag([p, q])
    begin = np.ones(2)  # initial vector of the companion form
    return row, basis @ np.stack([begin, modes @ begin - row[0] * begin], axis=1)


@dataclass(frozen=True, eq=False)
class Solution:
    """Fitted blocks.

    blocks : The system.
    first : Initial states by record, `(blocks, 2)`.
    errors : Errors by record, `(ny, time)`, 0 in gaps.
    scale : RMS error by output, `(ny,)`.
    """

    blocks: Blocks
    first: tuple[Array, ...]
    errors: tuple[Array, ...]
    scale: Array

    @property
    def cost(self) -> float:
        """Return the sum over outputs of the logarithm of the RMS error."""
        return float(np.log(np.maximum(self.scale, _EXACT)).sum())

    def matrices(self, step: Array | None = None) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D without the constant input, after a `step` of the values."""
        blocks = self.blocks if step is None else self.blocks.moved(step)
        a, b, c, d = blocks.matrices()
        return (a, b[:, :-1], c, d[:, :-1]) if blocks.constant else (a, b, c, d)


@dataclass(frozen=True, eq=False)
class Equations:
    """The normal equations N step = g of a part of the samples.

    n, g : `(values, values)` and `(values,)`, of the parameters.
    states : By record, the rows of N and g for initial states: products with the parameters,
        products of states, and g.
    """

    n: Array
    g: Array
    states: Mapping[int, tuple[Array, Array, Array]]

    def plus(self, other: Equations, sign: float = 1.0) -> Equations:
        """Return the sum of both equations; with the sign -1, the difference."""
        states = {**self.states}
        for record, parts in other.states.items():
            mine: Sequence[Any] = states.get(record, (0.0, 0.0, 0.0))
            cross, square, g = (a + sign * b for a, b in zip(mine, parts, strict=True))
            states[record] = cross, square, g
        return Equations(self.n + sign * other.n, self.g + sign * other.g, states)


def evaluated(blocks: Blocks, runs: Sequence[Signals], first: Sequence[Array]) -> Solution:
    """Return the errors of a system."""
    errors = [
        (run.y - blocks.simulate(run, x)) * run.measured for run, x in zip(runs, first, strict=True)
    ]
    power: Any = sum((left**2).sum(axis=1) for left in errors)
    count: Any = sum(run.measured.sum(axis=1) for run in runs)
    scale = np.sqrt(power / np.maximum(count, 1))
    return Solution(blocks, tuple(first), tuple(errors), scale)


def equations(solution: Solution, runs: Sequence[Signals], free: Flags) -> Equations:
    """Return the normal equations of all samples for the entries `free` of the values."""
    whole = [(i, 0, run.u.shape[1]) for i, run in enumerate(runs)]
    return total(by_segment(solution, runs, free, whole))


def length(runs: Sequence[Signals]) -> int:
    """Return the number of samples of all records."""
    return sum(run.u.shape[1] for run in runs)


def windows(runs: Sequence[Signals], most: int) -> list[tuple[int, int, int]]:
    """Return record, first and last sample + 1 of windows with about `most` samples in all.

    Shorter records are returned whole. Of longer ones, half of the windows are evenly spaced, and
    half have the largest deviations of the inputs.
    """
    if length(runs) <= most:
        return [(i, 0, run.u.shape[1]) for i, run in enumerate(runs)]
    cuts = segments(runs, _WINDOWS * length(runs) // most)
    moves = np.array([runs[i].u[:, begin:end].std(axis=1).sum() for i, begin, end in cuts])
    moves[np.linspace(0, len(cuts) - 1, _WINDOWS // 2).astype(int)] = np.inf
    excerpt = list[tuple[int, int, int]]()
    for i, begin, end in (cuts[k] for k in np.sort(np.argsort(-moves, kind="stable")[:_WINDOWS])):
        joined = excerpt and excerpt[-1][0] == i and excerpt[-1][2] == begin
        excerpt.append((i, excerpt.pop()[1] if joined else begin, end))
    return excerpt


def total(parts: Sequence[Equations]) -> Equations:
    """Return the sum of normal equations."""
    return reduce(Equations.plus, parts)


def segments(runs: Sequence[Signals], count: int) -> list[tuple[int, int, int]]:
    """Return record, first and last sample + 1 of about `count` segments with measured samples."""
    time = length(runs)
    bounds = []
    for i, run in enumerate(runs):
        edges = np.linspace(0, run.u.shape[1], max(round(count * run.u.shape[1] / time), 1) + 1)
        cuts = pairwise(edges.astype(int).tolist())
        bounds += [(i, a, b) for a, b in cuts if run.measured[:, a:b].any()]
    return bounds


def by_segment(
    solution: Solution,
    runs: Sequence[Signals],
    free: Flags,
    cuts: Sequence[tuple[int, int, int]],
) -> list[Equations]:
    """Return the normal equations by segment: a record, a first and a last sample + 1.

    For long records, raises DeadlineError after the deadline; short ones, such as an excerpt, need
    a result.
    """
    blocks, long = solution.blocks, length(runs) > 2 * MOST_SAMPLES
    count, size, parameters = 2 * len(blocks.a), len(blocks.values), int(free.sum())
    # The places of the numbers in the equations; -1 for fixed numbers.
    place = np.full(size + count, -1)
    place[:size][free], place[size:] = np.arange(parameters), parameters + np.arange(count)
    a, b, c, d, offset = blocks.parts(place[:size])
    own = np.hstack([a, b.reshape(len(a), -1), place[size:].reshape(-1, 2)]).ravel()
    weight = 1 / np.maximum(solution.scale, _EXACT) ** 2
    n = np.zeros((len(cuts), parameters + count, parameters + count))
    g = np.zeros((len(cuts), parameters + count))
    for record in {record: None for record, _, _ in cuts}:
        run = runs[record]
        for chunk, states, responses in blocks.chunks(run, solution.first[record]):
            if long:
                check()
            constant = np.ones((1, states.shape[2]))
            for k, w in enumerate(weight):
                columns = np.concatenate([own, c[:, k].ravel(), d[k], offset[[k]]])
                one, two = blocks.c[:, k].T[:, :, None, None]
                through = one * responses[:, 0]
                through += two * responses[:, 1]
                rows = np.concatenate([*through, *states, run.u[:, chunk], constant])[columns >= 0]
                columns = columns[columns >= 0]
                if not run.measured[k, chunk].all():
                    rows *= run.measured[k, chunk]
                errors = solution.errors[record][k, chunk]
                for i, (of, begin, end) in enumerate(cuts):
                    here = slice(max(begin - chunk.start, 0), max(end - chunk.start, 0))
                    if of == record and here.start < min(here.stop, len(errors)):
                        part = rows[:, here]
                        n[i][np.ix_(columns, columns)] += w * (part @ part.T)
                        g[i][columns] += w * (part @ errors[here])
    by_part = []
    for (record, _, _), own_n, own_g in zip(cuts, n, g, strict=True):
        inner = own_n[parameters:, :parameters], own_n[parameters:, parameters:], own_g[parameters:]
        by_part.append(
            Equations(own_n[:parameters, :parameters], own_g[:parameters], {record: inner})
        )
    return by_part


def solved(
    system: Equations, damping: float, usual: Equations | None = None
) -> tuple[Array, dict[int, Array]]:
    """Return the steps of parameters and initial states; `usual` are equations of more samples."""
    like = system if usual is None else usual
    n, g, inner = system.n.copy(), system.g.copy(), {}
    for record, (cross, square, slope) in system.states.items():
        both = _solve(square, np.column_stack([cross, slope]), damping, like.states[record][1])
        n -= cross.T @ both[:, :-1]
        g -= cross.T @ both[:, -1]
        inner[record] = both
    step = _solve(n, g, damping, like.n)
    return step, {i: both[:, -1] - both[:, :-1] @ step for i, both in inner.items()}


def followed(system: Equations, step: Array, damping: float, usual: Equations) -> dict[int, Array]:
    """Return the best steps of initial states for a given step of the parameters."""
    return {
        i: _solve(square, slope - cross @ step, damping, usual.states[i][1])
        for i, (cross, square, slope) in system.states.items()
    }


def _solve(n: Array, g: Array, damping: float, like: Array) -> Array:
    """Solve N x = g, with the share `damping + _RIDGE` of the diagonal of `like` added to N."""
    diagonal = np.diag(like)
    size = np.sqrt(np.maximum(diagonal, 1e-24 * max(diagonal.max(initial=0.0), 1e-270)))
    scaled = n / size / size[:, None]
    scaled[np.diag_indices_from(scaled)] += damping + _RIDGE
    towards = (g.T / size).T
    try:
        solution = np.linalg.solve(scaled, towards)
    except np.linalg.LinAlgError:
        solution = np.linalg.lstsq(scaled, towards, rcond=None)[0]
    return np.asarray((solution.T / size).T)


def stepped(
    solution: Solution, runs: Sequence[Signals], free: Flags, system: Equations, damping: float
) -> Solution:
    """Return the solution after one damped step."""
    step, states = solved(system, damping)
    whole = np.zeros(len(free))
    whole[free] = step
    first = [x + states[i].reshape(x.shape) for i, x in enumerate(solution.first)]
    with np.errstate(over="ignore", invalid="ignore"):
        return evaluated(solution.blocks.moved(whole), runs, first)


def refined(at: Solution, runs: Sequence[Signals], iterations: int, limit: float = 1.0) -> Solution:
    """Return the locally best system, or the best so far at the deadline."""
    samples = sum(float(run.measured.sum()) for run in runs) / len(at.scale)
    damping, free = 1e-4, at.blocks.free
    for _ in range(iterations):
        if current().over:
            break
        try:
            system = equations(at, runs, free)
        except DeadlineError:
            break
        for _ in range(_STEPS):
            new = stepped(at, runs, free, system, damping)
            better = new.blocks.stable(limit) and np.isfinite(new.scale).all()
            if better and new.cost < at.cost:
                break
            damping = max(damping * 10, 1e-6)
        else:
            return at
        gain, at = at.cost - new.cost, new
        damping = max(damping / 10, 1e-12)
        if gain < max(_CONVERGED / samples, _NEGLIGIBLE):
            break
    return at


def begun(blocks: Blocks, runs: Sequence[Signals]) -> Solution:
    """Return the unchanged system with initial states fitted to the records' first samples."""
    samples, free = MOST_SAMPLES // len(runs) + 1, np.zeros(len(blocks.values), bool)
    some = [Signals(*(signal[:, :samples] for signal in run)) for run in runs]
    at = evaluated(blocks, some, [np.zeros((len(blocks.a), 2)) for _ in runs])
    return evaluated(blocks, runs, stepped(at, some, free, equations(at, some, free), 0.0).first)


def linear_solution(blocks: Blocks, runs: Sequence[Signals]) -> Solution:
    """Return the system with B, D, offset and initial states by linear least squares."""
    first = [np.zeros((len(blocks.a), 2)) for _ in runs]
    at = evaluated(blocks, runs, first)
    return stepped(at, runs, blocks.linear, equations(at, runs, blocks.linear), 0.0)
