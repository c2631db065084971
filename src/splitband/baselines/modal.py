"""Hold a linear system as a sum of first- and second-order blocks, and its simulation.

A block is x_{t+1} = [[a_1, a_2], [1, 0]] x_t + B u_t, y_t += C x_t: two poles, which may be real,
complex or equal. A first-order block has a_2 = 0 and one state. The form is nearly minimal, the
responses of all blocks and their derivatives are filters of second order (`scipy.signal.lfilter`),
and the normal equations of a least-squares fit follow from the products of few signals: an
iteration of 40 states and 16,000 samples takes a tenth of a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array

Flags = npt.NDArray[np.bool_]

_RADIUS = 1 - 1e-9
"""Largest absolute value of a free pole; 1 is an integrator."""
_SPLIT = 1e-9
"""Two poles of a block that are nearer are moved apart by so much, as a diagonal block with equal
poles has no companion form."""


class Run(NamedTuple):
    """Hold a record for a fit: inputs `(nu, time)`, outputs `(ny, time)` with 0 in gaps.

    `seen` `(ny, time)` is 1 where an output was measured, else 0.
    """

    u: Array
    y: Array
    seen: Array


@dataclass(frozen=True, eq=False)
class Blocks:
    """Hold the parameters of all blocks.

    Attributes
    ----------
    a : `(blocks, 2)`.
    b : `(blocks, 2, nu)`.
    c : `(blocks, ny, 2)`.
    d : `(ny, nu)`.
    offset : `(ny,)`.
    single : Whether a block has one pole, `(blocks,)`.
    fixed : Whether a block's poles are given, `(blocks,)`.
    direct : Whether an input may act at once, `(nu,)`.
    constant : Whether the last input is the constant 1, which acts on fixed blocks alone.
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
    def order(self) -> int:
        """Return the number of poles."""
        return int(2 * len(self.a) - self.single.sum())

    @cached_property
    def free(self) -> Flags:
        """Return which entries of `values` are parameters."""
        blocks, ny, nu = len(self.a), len(self.offset), len(self.direct)
        second = ~self.single
        both = np.stack([np.ones(blocks, bool), second], axis=1)
        of_b = np.repeat(both[:, :, None], nu, axis=2)
        if self.constant:
            of_b[:, :, -1] &= self.fixed[:, None]
        parts = (
            both & ~self.fixed[:, None],
            of_b,
            np.repeat(both[:, None], ny, axis=1),
            np.repeat(self.direct[None], ny, axis=0),
            np.ones(ny, bool),
        )
        return np.concatenate([part.ravel() for part in parts])

    @property
    def linear(self) -> Flags:
        """Return which entries of `values` the output is linear in, for given poles and C."""
        of_c = np.zeros(self.c.size, bool)
        parts = np.zeros(self.a.size, bool), np.ones(self.b.size, bool), of_c
        rest = np.ones(self.d.size + len(self.offset), bool)
        return np.concatenate([*parts, rest]) & self.free

    @property
    def values(self) -> Array:
        """Return all numbers in one row."""
        parts = self.a, self.b, self.c, self.d, self.offset
        return np.concatenate([part.ravel() for part in parts])

    def moved(self, step: Array) -> Blocks:
        """Return the system with `step` added to `values`."""
        new, parts = self.values + step, []
        for part in (self.a, self.b, self.c, self.d, self.offset):
            parts.append(new[: part.size].reshape(part.shape))
            new = new[part.size :]
        a, b, c, d, offset = parts
        return replace(self, a=a, b=b, c=c, d=d, offset=offset)

    def stable(self, limit: float = 1.0) -> bool:
        """Return whether all free poles are stable, and complex ones smaller than `limit`."""
        free = ~self.fixed
        first, second = self.a[free, 0] / _RADIUS, self.a[free, 1] / _RADIUS**2
        complex_ = self.a[free, 0] ** 2 + 4 * self.a[free, 1] < 0
        inside = (abs(second) < 1) & (abs(first) < 1 - second)
        return bool((inside & (~complex_ | (-self.a[free, 1] < limit**2))).all())

    def poles(self) -> npt.NDArray[np.complex128]:
        """Return all poles."""
        root = np.sqrt((self.a[:, 0] / 2) ** 2 + self.a[:, 1] + 0j)
        pairs = np.stack([self.a[:, 0] / 2 + root, self.a[:, 0] / 2 - root], axis=1)
        pairs[self.single, 0] = self.a[self.single, 0]
        return np.asarray(np.concatenate([pairs[:, 0], pairs[~self.single, 1]]))

    @property
    def kept(self) -> Flags:
        """Return which of two states a block there are: a first-order block has one."""
        return np.stack([np.ones(len(self.a), bool), ~self.single], axis=1).ravel()

    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D, without states that a first-order block does not have."""
        kept = self.kept
        companions = [np.array([row, [1.0, 0.0]]) for row in self.a]
        a = scipy.linalg.block_diag(*companions)[np.ix_(kept, kept)] if len(self.a) else np.zeros(
            (0, 0)
        )  # fmt: skip
        b = self.b.reshape(-1, self.b.shape[2])[kept]
        c = self.c.transpose(1, 0, 2).reshape(len(self.offset), -1)[:, kept]
        return a, b, c, self.d

    def states(self, run: Run, first: Array) -> Array:
        """Return the states of all blocks from the initial ones `(blocks, 2)` on."""
        found = np.empty((len(self.a), 2, run.u.shape[1]))
        for i, row in enumerate(self.a):
            found[i] = _states(row, self.b[i] @ run.u, first[i])
        return found

    def outputs(self, run: Run, states: Array) -> Array:
        """Return the outputs `(ny, time)` for states from `states`."""
        c = self.c.transpose(1, 0, 2).reshape(len(self.offset), 2 * len(self.a))
        y = self.d @ run.u + self.offset[:, None]
        return y + c @ states.reshape(2 * len(self.a), states.shape[2])

    def simulate(self, run: Run, first: Array) -> Array:
        """Return the outputs `(ny, time)` from the initial states `(blocks, 2)` on."""
        return self.outputs(run, self.states(run, first))

    def signals(self, run: Run, states: Array, poles: bool) -> Array:
        """Return the signals that the outputs' derivatives are made of, `(signals, time)`.

        They are, block by block, each input filtered by the block's denominator, one and two
        samples late; its impulse response, at once and one sample late; with `poles` both states,
        filtered, one and two samples late. The inputs and the constant follow.
        """
        nu, time = run.u.shape
        each = 2 * nu + (6 if poles else 2)
        found = np.zeros((len(self.a) * each + nu + 1, time))
        driven = np.vstack([run.u, np.zeros((1, time))])
        driven[-1, 0] = 1.0
        for i, (first, second) in enumerate(self.a):
            rows = found[i * each : (i + 1) * each]
            filtered = scipy.signal.lfilter([1.0], [1.0, -first, -second], driven)
            rows[:nu, 1:], rows[nu : 2 * nu, 2:] = filtered[:nu, :-1], filtered[:nu, :-2]
            rows[2 * nu], rows[2 * nu + 1, 1:] = filtered[nu], filtered[nu, :-1]
            if poles:
                late = scipy.signal.lfilter([1.0], [1.0, -first, -second], states[i])
                rows[2 * nu + 2 : 2 * nu + 4, 1:] = late[:, :-1]
                rows[2 * nu + 4 :, 2:] = late[:, :-2]
        found[-nu - 1 : -1], found[-1] = run.u, 1.0
        return found

    def weights(self, poles: bool) -> list[Array]:
        """Return for each output the matrix from parameters to weights of `signals`.

        Columns are all `values`, then the initial states.
        """
        blocks, ny, nu = len(self.a), len(self.offset), len(self.direct)
        each = 2 * nu + (6 if poles else 2)
        size = len(self.values)
        of_b = self.a.size + np.arange(self.b.size).reshape(self.b.shape)
        of_c = self.a.size + self.b.size + np.arange(self.c.size).reshape(self.c.shape)
        of_d = self.a.size + self.b.size + self.c.size + np.arange(self.d.size).reshape(ny, nu)
        found, inputs = [], np.arange(nu)
        for k in range(ny):
            m = np.zeros((blocks * each + nu + 1, size + 2 * blocks))
            for i, (first, second) in enumerate(self.a):
                one, two = self.c[i, k]
                row, (b1, b2) = i * each, self.b[i]
                late, later, impulse = row, row + nu, row + 2 * nu
                # x = [F(t-1) b1 + a2 F(t-2) b2, F(t-2) b1 + F(t-1) b2 - a1 F(t-2) b2]
                m[late + inputs, of_b[i, 0]] = one
                m[later + inputs, of_b[i, 0]] = two
                m[late + inputs, of_b[i, 1]] = two
                m[later + inputs, of_b[i, 1]] = second * one - first * two
                m[late : late + nu, of_c[i, k, 0]] = b1
                m[later : later + nu, of_c[i, k, 0]] = second * b2
                m[late : late + nu, of_c[i, k, 1]] = b2
                m[later : later + nu, of_c[i, k, 1]] = b1 - first * b2
                start = size + 2 * i
                m[impulse, start : start + 2] = one, two
                m[impulse + 1, start : start + 2] = two, second * one - first * two
                if poles:
                    m[row + 2 * nu + 2 : row + each, 2 * i : 2 * i + 2] = [
                        [one, 0], [0, one], [two, 0], [0, two]]  # fmt: skip
            m[blocks * each + inputs, of_d[k]] = 1.0
            m[-1, size - ny + k] = 1.0
            found.append(m)
        return found

    def through_states(self, first: Array) -> Array:
        """Return what `weights` lacks of the derivatives by C, which the initial states add."""
        x1, x2 = first[:, 0], first[:, 1]
        return np.stack([x1, self.a[:, 1] * x2, x2, x1 - self.a[:, 0] * x2], axis=1)


def _states(a: Array, forced: Array, first: Array) -> Array:
    """Return both states of a block for forces `(2, time)` on them, `(2, time)`."""
    time = forced.shape[1]
    # Their sum obeys one recursion: x1' = a1 x1 + a2 x2 + f1, x2' = x1 + f2.
    into = np.empty(time)
    into[0] = first[0]
    if time > 1:
        into[1:] = forced[0, :-1]
        into[1] += a[1] * first[1]
        into[2:] += a[1] * forced[1, :-2]
    x1 = scipy.signal.lfilter([1.0], [1.0, -a[0], -a[1]], into)
    x2 = np.empty(time)
    x2[0] = first[1]
    x2[1:] = x1[:-1] + forced[1, :-1]
    return np.stack([x1, x2])


def blocks_of(  # noqa: PLR0915  a few lines for each kind of pole
    a: Array,
    c: Array,
    direct: Sequence[bool],
    integrators: int = 0,
    chain: bool = False,
    b: Array | None = None,
    d: Array | None = None,
) -> Blocks:
    """Return the blocks of a system, whose poles are those of A.

    Parameters
    ----------
    a, c : `(states, states)` and `(ny, states)`.
    direct : Whether each input may act at once.
    integrators : Number of poles that are set to 1: the real ones that are nearest to it.
    chain : Whether two of them are a chain, an integrator after an integrator.
    b, d : `(states, nu)` and `(ny, nu)`; by default zero.
    """
    ny, nu = len(c), len(direct)
    poles, vectors = np.linalg.eig(a)
    rows, out, fixed = list[tuple[float, float]](), list[Array](), list[bool]()
    order = [*np.argsort(abs(poles - 1), kind="stable")]
    real = [i for i in order if poles[i].imag == 0]
    pairs = [i for i in order if poles[i].imag > 0]

    def add(row: tuple[float, float], basis: Array) -> None:
        rows.append(row)
        out.append(basis)
        fixed.append(False)

    def add_pair(i: int) -> None:
        pole, v = poles[i], vectors[:, i]
        row = (2 * pole.real, -(abs(pole) ** 2))
        # In the basis [Re v, Im v] the block is [[re, im], [-im, re]].
        own = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])
        add(row, np.stack([v.real, v.imag], axis=1) @ _companion(own, row))

    def add_real(i: int, j: int) -> None:
        p, q = poles[i].real, poles[j].real
        if abs(p - q) < _SPLIT:
            q -= _SPLIT
        row = (p + q, -p * q)
        add(row, vectors[:, [i, j]].real @ _companion(np.diag([p, q]), row))

    if chain and (pairs or len(real) > 1):
        if len(real) > 1 and not (pairs and abs(poles[pairs[0]] - 1) < abs(poles[real[1]] - 1)):
            add_real(real.pop(0), real.pop(0))
        else:
            add_pair(pairs.pop(0))
        rows[-1], fixed[-1] = (2.0, -1.0), True
        integrators -= 2
    while integrators > 0 and (real or pairs):
        if real:
            add((1.0, 0.0), vectors[:, [real.pop(0)]].real)
            fixed[-1] = True
        else:  # a pair becomes an integrator and another real pole
            i = pairs.pop(0)
            add((poles[i].real, 0.0), vectors[:, [i]].imag)
            add((1.0, 0.0), vectors[:, [i]].real)
            fixed[-1] = True
        integrators -= 1
    for i in pairs:
        add_pair(i)
    while len(real) > 1:
        add_real(real.pop(0), real.pop(0))
    for i in real:
        add((poles[i].real, 0.0), vectors[:, [i]].real)
    of_b, of_c = np.zeros((len(rows), 2, nu)), np.zeros((len(rows), ny, 2))
    single = np.array([basis.shape[1] == 1 for basis in out], bool)
    into = None if b is None else np.linalg.lstsq(np.hstack(out), b, rcond=None)[0]
    first = 0
    for i, basis in enumerate(out):
        size = basis.shape[1]
        of_c[i, :, :size] = c @ basis
        if into is not None:
            of_b[i, :size] = into[first : first + size]
        first += size
    return Blocks(
        np.array(rows).reshape(-1, 2),
        of_b,
        of_c,
        np.zeros((ny, nu)) if d is None else d,
        np.zeros(ny),
        single,
        np.array(fixed, bool),
        np.array(direct, bool),
    )


def _companion(own: Array, row: tuple[float, float]) -> Array:
    """Return the basis in which a block `(2, 2)` has the companion form."""
    begin = np.ones(2)
    return np.stack([begin, own @ begin - row[0] * begin], axis=1)
