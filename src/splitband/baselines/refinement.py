"""Fit the blocks of a linear system by least squares of its error (Levenberg and Marquardt).

With the record's inputs this is the output error. With inputs and measured outputs as the inputs of
the predictor, the same code minimises the prediction error. See L. Ljung, System Identification,
2nd ed., Ch. 7 and 10. The initial states of each record are eliminated from the normal equations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from splitband.baselines.modal import Blocks, Flags, Run
from splitband.runtime.arrays import Array

_STEPS = 8
"""Most attempts to find a step that lowers the error. By eye."""
_CONVERGED = 0.1
"""A fit ends when an iteration raises the log-likelihood by less. A parameter without effect raises
it by 1/2 on average: smaller steps are within the noise."""
_RIDGE = 1e-10
"""Share of their diagonal that the normal equations gain, as some directions change nothing."""
_EXACT = 1e-10
"""RMS of normalised errors below which they are rounding. By eye."""


@dataclass(frozen=True, eq=False)
class Solution:
    """Hold fitted blocks.

    Attributes
    ----------
    blocks : The system.
    first : Initial states of each record, `(blocks, 2)` each.
    errors : Errors of each record, `(ny, time)`, 0 in gaps.
    scale : RMS error of each output, `(ny,)`.
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
    """Hold the normal equations N step = g of a part of the samples.

    Attributes
    ----------
    n, g : `(values, values)` and `(values,)`, of the parameters.
    states : By record, the rows of N and g for its initial states: products with the parameters,
        with each other, and g.
    """

    n: Array
    g: Array
    states: Mapping[int, tuple[Array, Array, Array]]

    def plus(self, other: Equations, sign: float = 1.0) -> Equations:
        """Return the equations of both parts; with the sign -1, without those of the other."""
        states = {**self.states}
        for record, parts in other.states.items():
            mine = states.get(record, tuple(np.zeros_like(part) for part in parts))
            states[record] = (
                mine[0] + sign * parts[0],
                mine[1] + sign * parts[1],
                mine[2] + sign * parts[2],
            )
        return Equations(self.n + sign * other.n, self.g + sign * other.g, states)


def evaluated(blocks: Blocks, runs: Sequence[Run], first: Sequence[Array]) -> Solution:
    """Return the errors of a system."""
    errors, total, count = [], np.zeros(len(blocks.offset)), np.zeros(len(blocks.offset))
    for run, x in zip(runs, first, strict=True):
        left = (run.y - blocks.simulate(run, x)) * run.seen
        errors.append(left)
        total += (left**2).sum(axis=1)
        count += run.seen.sum(axis=1)
    scale = np.sqrt(total / np.maximum(count, 1))
    return Solution(blocks, tuple(first), tuple(errors), scale)


def equations(solution: Solution, runs: Sequence[Run], free: Flags) -> Equations:
    """Return the normal equations of all samples for the entries `free` of the values."""
    whole = [(i, 0, run.u.shape[1]) for i, run in enumerate(runs)]
    return total([*by_segment(solution, runs, free, whole)])


def total(parts: Sequence[Equations]) -> Equations:
    """Return the sum of normal equations."""
    first, *others = parts
    for other in others:
        first = first.plus(other)
    return first


def by_segment(
    solution: Solution,
    runs: Sequence[Run],
    free: Flags,
    segments: Sequence[tuple[int, int, int]],
) -> Iterator[Equations]:
    """Yield the normal equations of each segment: a record, its first and its last sample + 1."""
    blocks = solution.blocks
    poles = bool(free[: blocks.a.size].any())
    shared = blocks.weights(poles)
    size, count, kept = len(blocks.values), 2 * len(blocks.a), int(free.sum())
    columns = np.concatenate([np.flatnonzero(free), size + np.arange(count)])
    weight = 1 / np.maximum(solution.scale, _EXACT) ** 2
    last, signals, through = -1, np.zeros((0, 0)), list[Array]()
    for record, begin, end in segments:
        run, x = runs[record], solution.first[record]
        if record != last:
            last, states = record, blocks.states(run, x) if poles else x
            signals = blocks.signals(run, states, poles)
            through = [m[:, columns] for m in _with_states(blocks, shared, x, poles)]
        part, seen = signals[:, begin:end], run.seen[:, begin:end]
        gram = part @ part.T if seen.all() else None
        towards = part @ solution.errors[record][:, begin:end].T
        own, slope = np.zeros((kept + count,) * 2), np.zeros(kept + count)
        for k, m in enumerate(through):
            square = gram if gram is not None else (part * seen[k]) @ part.T
            own += weight[k] * (m.T @ (square @ m))
            slope += weight[k] * (m.T @ towards[:, k])
        inner = own[kept:, :kept], own[kept:, kept:], slope[kept:]
        yield Equations(own[:kept, :kept], slope[:kept], {record: inner})


def _with_states(blocks: Blocks, shared: Sequence[Array], x: Array, poles: bool) -> list[Array]:
    """Return the weights of signals, with the derivatives by C through the initial states."""
    nu, ny = len(blocks.direct), len(blocks.offset)
    each = 2 * nu + (6 if poles else 2)
    through = blocks.through_states(x)
    rows = np.arange(len(blocks.a)) * each + 2 * nu
    found = []
    for k, own in enumerate(shared):
        m = own.copy()
        begin = blocks.a.size + blocks.b.size
        of_c = begin + (np.arange(len(blocks.a)) * ny + k) * 2
        for j in range(4):
            m[rows + j % 2, of_c + j // 2] += through[:, j]
        found.append(m)
    return found


def solved(
    found: Equations, damping: float, usual: Equations | None = None
) -> tuple[Array, dict[int, Array]]:
    """Return the steps of the parameters and of each record's initial states.

    `usual`: equations of more samples. What these determine alone hardly moves.
    """
    like = found if usual is None else usual
    n, g, inner = found.n.copy(), found.g.copy(), {}
    for record, (cross, own, slope) in found.states.items():
        both = _solve(own, np.column_stack([cross, slope]), damping, like.states[record][1])
        n -= cross.T @ both[:, :-1]
        g -= cross.T @ both[:, -1]
        inner[record] = both
    step = _solve(n, g, damping, like.n)
    return step, {i: both[:, -1] - both[:, :-1] @ step for i, both in inner.items()}


def followed(found: Equations, step: Array, damping: float, usual: Equations) -> dict[int, Array]:
    """Return the best steps of initial states after a given step of the parameters."""
    return {
        i: _solve(own, slope - cross @ step, damping, usual.states[i][1])
        for i, (cross, own, slope) in found.states.items()
    }


def _solve(n: Array, g: Array, damping: float, like: Array) -> Array:
    """Solve N x = g; the share `damping`, and a little, of the diagonal of `like` is added to N."""
    diagonal = np.diag(like)
    size = np.sqrt(np.maximum(diagonal, 1e-24 * max(diagonal.max(initial=0.0), 1e-270)))
    scaled = n / size / size[:, None]
    scaled[np.diag_indices_from(scaled)] += damping + _RIDGE
    towards = (g.T / size).T
    try:
        found = np.linalg.solve(scaled, towards)
    except np.linalg.LinAlgError:
        found = np.linalg.lstsq(scaled, towards, rcond=None)[0]
    return np.asarray((found.T / size).T)


def stepped(
    solution: Solution, runs: Sequence[Run], free: Flags, found: Equations, damping: float
) -> Solution:
    """Return the solution after one damped step."""
    step, states = solved(found, damping)
    whole = np.zeros(len(free))
    whole[free] = step
    first = [x + states[i].reshape(x.shape) for i, x in enumerate(solution.first)]
    with np.errstate(over="ignore", invalid="ignore"):
        return evaluated(solution.blocks.moved(whole), runs, first)


def refined(
    blocks: Blocks,
    runs: Sequence[Run],
    iterations: int,
    first: Sequence[Array] | None = None,
    limit: float = 1.0,
) -> Solution:
    """Return the locally best system, with complex poles below `limit` in absolute value.

    Without `first`, B, D, offset and initial states are solved for first.
    """
    zero = [np.zeros((len(blocks.a), 2)) for _ in runs]
    if first is None:
        at = linear_solution(blocks, runs)
    else:
        at = evaluated(blocks, runs, [*first] or zero)
    samples = sum(float(run.seen.sum()) for run in runs) / len(at.scale)
    damping, free = 1e-4, blocks.free
    for _ in range(iterations):
        found = equations(at, runs, free)
        for _ in range(_STEPS):
            new = stepped(at, runs, free, found, damping)
            better = new.blocks.stable(limit) and np.isfinite(new.scale).all()
            if better and new.cost < at.cost:
                break
            damping = max(damping * 10, 1e-6)
        else:
            return at
        gain, at = at.cost - new.cost, new
        damping = max(damping / 10, 1e-12)
        if samples * gain < _CONVERGED:
            break
    return at


def linear_solution(blocks: Blocks, runs: Sequence[Run]) -> Solution:
    """Return the system with B, D, offset and initial states by linear least squares."""
    first = [np.zeros((len(blocks.a), 2)) for _ in runs]
    at = evaluated(blocks, runs, first)
    return stepped(at, runs, blocks.linear, equations(at, runs, blocks.linear), 0.0)
