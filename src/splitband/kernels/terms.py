"""Evaluate the unknown terms of an equation, with their derivatives, compiled.

A term is a network with one hidden layer of tanh units: see `simulators.unknown`, whose NumPy
version defines the values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numba import literal_unroll, types
from numba.extending import overload

from splitband.kernels.common import kernel, tanh
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

Function = Callable[..., Any]


@kernel
def evaluate(  # noqa: PLR0912, PLR0915  one loop, for Numba
    theta: Array,
    scaling: Array,
    layout: Any,
    z: Array,
    w: Array,
    by_z: Array,
    by_theta: Array,
) -> None:
    """Write the outputs of all terms into `w`, and their derivatives into `by_z` and `by_theta`.

    Parameters
    ----------
    theta, scaling, layout : The terms, as `simulators.unknown.packed` returns them.
    z : Quantities of all terms, one after another, `(quantities,)`.
    w : `(outputs,)`.
    by_z, by_theta : `(outputs, quantities)` and `(outputs, len(theta))`, or both empty, for the
        outputs alone.
    """
    wanted = len(by_z) > 0
    if wanted:
        by_z[:] = 0.0
        by_theta[:] = 0.0
    units, scaled, beyond = np.empty(len(theta)), np.empty(len(z)), np.zeros(len(z))
    t = s = at = out = 0  # positions in theta, in the scaling, in z and in w
    for term in range(len(layout)):
        nq, nh, no, odd, increasing, bounded = layout[term]
        bias, second = t + nh * nq, t + nh * nq + nh
        last = second + no * nh
        for q in range(nq):
            held = min(max(z[at + q], scaling[s + 2 * nq + q]), scaling[s + 3 * nq + q])
            scaled[q] = (held - scaling[s + q]) / scaling[s + nq + q]
            beyond[q] = (z[at + q] - held) / scaling[s + nq + q]
        for h in range(nh):
            total = along = 0.0
            for q in range(nq):
                weight = theta[t + h * nq + q]
                weight = weight * weight if increasing else weight
                total += weight * scaled[q]
                along += weight * beyond[q]
            units[h] = theta[bias + h] + total  # for z, and of an odd term for -z
            units[nh + h] = odd * (theta[bias + h] - total)
            units[2 * nh + h] = along
        for i in range(2 * nh):
            units[i] = tanh(units[i])
        for o in range(no):
            value = theta[last + o] if nh and not odd else 0.0
            for h in range(nh):
                weight = theta[second + o * nh + h]
                above, below, along = units[h], units[nh + h], units[2 * nh + h]
                steep = 1.0 - above * above + odd * (1.0 - below * below)
                value += (weight * weight if increasing else weight) * (
                    above - below + steep * along
                )
            factor = scaling[s + 4 * nq + o]
            value *= factor
            if bounded:
                low, high = scaling[s + 4 * nq + no], scaling[s + 4 * nq + no + 1]
                half, middle = 0.5 * (high - low), 0.5 * (high + low)
                zero = -middle / half if low < 0.0 < high else 0.0
                steep = 1.0 / (half * (1.0 - zero * zero))
                squashed = tanh(np.arctanh(zero) + value * steep)
                value = middle + half * squashed
                factor *= half * steep * (1.0 - squashed * squashed)
            w[out + o] = value
            if not wanted:
                continue
            if nh and not odd:
                by_theta[out + o, last + o] = factor
            for h in range(nh):
                weight, above, below = theta[second + o * nh + h], units[h], units[nh + h]
                weight, double = (weight * weight, 2.0 * weight) if increasing else (weight, 1.0)
                rise, fall, along = (
                    1.0 - above * above,
                    odd * (1.0 - below * below),
                    units[2 * nh + h],
                )
                value = above - below + (rise + fall) * along
                by_theta[out + o, second + o * nh + h] = factor * double * value
                bend, twist = -2.0 * above * rise * along, 2.0 * below * fall * along
                by_theta[out + o, bias + h] = factor * weight * (rise - fall + bend - twist)
                end = factor * weight * (rise + fall)
                slope = end + factor * weight * (bend + twist)
                for q in range(nq):
                    inner = theta[t + h * nq + q]
                    inner, double = (inner * inner, 2.0 * inner) if increasing else (inner, 1.0)
                    moved = slope * scaled[q] + end * beyond[q]
                    by_theta[out + o, t + h * nq + q] = double * moved
                    by_z[out + o, at + q] += (end if beyond[q] != 0.0 else slope) * inner
            for q in range(nq):
                by_z[out + o, at + q] /= scaling[s + nq + q]
        t = last if odd or not nh else last + no
        s += 4 * nq + no + 2
        at += nq
        out += no


def put(values: Any, out: Any, at: Any) -> Any:
    """Write values into an array from a place on."""
    for j in range(len(values)):
        out[at + j] = values[j]


@overload(put)
def _put(values: Any, out: Any, at: Any) -> Any:
    if not isinstance(values, types.BaseTuple):
        return put

    def each(values: Any, out: Any, at: Any) -> Any:
        for value in literal_unroll(values):
            out[at] = value
            at += 1

    return each


def all_of(x: Array, u: Array) -> Array:
    """Return all states and inputs, the quantities of a term that names none."""
    return np.concatenate((x, u))


def gathered(of: Sequence[Function | None], compiled: Function = lambda f: f) -> Function:
    """Return `gather(x, u, layout, z)`, which writes the quantities of all terms into z.

    Parameters
    ----------
    of : The function `of(x, u)` of each term, or one with the `places` of states and inputs; None
        for `all_of`.
    compiled : Called with each function; by default they are run as they are.
    """

    def nothing(x: Array, u: Array, layout: Any, z: Array) -> int:
        return 0

    gather = compiled(nothing)
    for term, function in enumerate(of):
        places = getattr(function, "places", None)
        if places is None:
            gather = compiled(_appended(gather, compiled(function or all_of), term))
        else:
            gather = compiled(_chosen(gather, np.array(places), term))
    return gather


def _appended(before: Function, of: Function, term: int) -> Function:
    def gather(x: Array, u: Array, layout: Any, z: Array) -> int:
        at, count = before(x, u, layout, z), layout[term, 0]
        if count > 0:  # 0 before training
            quantities = of(x, u)
            if len(quantities) != count:
                raise InputError("of must return as many quantities as in training")
            put(quantities, z, at)
        return int(at + count)

    return gather


def _chosen(before: Function, places: Array, term: int) -> Function:
    def gather(x: Array, u: Array, layout: Any, z: Array) -> int:
        at = before(x, u, layout, z)
        for q in range(layout[term, 0]):
            place = places[q]
            z[at + q] = x[place] if place < len(x) else u[place - len(x)]
        return int(at + layout[term, 0])

    return gather
