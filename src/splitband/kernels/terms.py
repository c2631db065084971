"""Evaluate the unknown terms of an equation, with their derivatives, compiled.

A term is a network with one hidden layer of tanh units: see `simulators.unknown`, whose NumPy
version defines the values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splitband.kernels.common import kernel, tanh, tanh_of
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
    t = s = at = out = 0  # positions in theta, in the scaling, in z and in w
    for term in range(len(layout)):
        nq, nh, no, odd, increasing, bounded = layout[term]
        bias, second = t + nh * nq, t + nh * nq + nh
        last = second + no * nh
        units = np.empty(2 * nh if odd else nh)  # for z, and of an odd term for -z
        for h in range(nh):
            total = 0.0
            for q in range(nq):
                held = min(max(z[at + q], scaling[s + 2 * nq + q]), scaling[s + 3 * nq + q])
                weight = theta[t + h * nq + q]
                weight = weight * weight if increasing else weight
                total += weight * (held - scaling[s + q]) / scaling[s + nq + q]
            units[h] = theta[bias + h] + total
            if odd:
                units[nh + h] = theta[bias + h] - total
        tanh_of(units)
        for o in range(no):
            total = theta[last + o] if nh and not odd else 0.0
            for h in range(nh):
                weight = theta[second + o * nh + h]
                weight = weight * weight if increasing else weight
                total += weight * (units[h] - units[nh + h] if odd else units[h])
            w[out + o] = total
            if not wanted:
                continue
            if nh and not odd:
                by_theta[out + o, last + o] = 1.0
            for h in range(nh):
                given, above = theta[second + o * nh + h], units[h]
                below, slope = (units[nh + h], 1.0) if odd else (0.0, 0.0)
                above_slope, below_slope = 1.0 - above * above, slope * (1.0 - below * below)
                weight, factor = (given * given, 2.0 * given) if increasing else (given, 1.0)
                by_theta[out + o, second + o * nh + h] = factor * (above - below)
                by_theta[out + o, bias + h] = weight * (above_slope - below_slope)
                slope = weight * (above_slope + below_slope)
                for q in range(nq):
                    low, high = scaling[s + 2 * nq + q], scaling[s + 3 * nq + q]
                    held, width = min(max(z[at + q], low), high), scaling[s + nq + q]
                    inner = theta[t + h * nq + q]
                    weight, factor = (inner * inner, 2.0 * inner) if increasing else (inner, 1.0)
                    by_theta[out + o, t + h * nq + q] = (
                        slope * factor * (held - scaling[s + q]) / width
                    )
                    if low <= z[at + q] <= high:
                        by_z[out + o, at + q] += slope * weight / width
        for o in range(no):
            scale, factor = scaling[s + 4 * nq + o], scaling[s + 4 * nq + o]
            value = w[out + o] * scale
            if bounded:
                low, high = scaling[s + 4 * nq + no], scaling[s + 4 * nq + no + 1]
                half, middle = 0.5 * (high - low), 0.5 * (high + low)
                zero = -middle / half if low < 0.0 < high else 0.0
                steep = 1.0 / (half * (1.0 - zero * zero))
                squashed = tanh(np.arctanh(zero) + value * steep)
                value = middle + half * squashed
                factor = scale * half * steep * (1.0 - squashed * squashed)
            w[out + o] = value
            if wanted:
                by_z[out + o] *= factor
                by_theta[out + o] *= factor
        t = last if odd or not nh else last + no
        s += 4 * nq + no + 2
        at += nq
        out += no


def all_of(x: Array, u: Array) -> Array:
    """Return all states and inputs, the quantities of a term that names none."""
    return np.concatenate((x, u))


def gathered(of: Sequence[Function | None], compiled: Function = lambda f: f) -> Function:
    """Return `gather(x, u, layout, z)`, which writes the quantities of all terms into z.

    Parameters
    ----------
    of : The function `of(x, u)` of each term; None for `all_of`.
    compiled : Called with each function; by default they are run as they are.
    """

    def nothing(x: Array, u: Array, layout: Any, z: Array) -> int:
        return 0

    gather = compiled(nothing)
    for term, function in enumerate(of):
        gather = compiled(_appended(gather, compiled(function or all_of), term))
    return gather


def _appended(before: Function, of: Function, term: int) -> Function:
    def gather(x: Array, u: Array, layout: Any, z: Array) -> int:
        at, count = before(x, u, layout, z), layout[term, 0]
        if count > 0:  # 0 before training
            quantities = of(x, u)
            if len(quantities) != count:
                raise InputError("of must return as many quantities as in training")
            for q in range(count):
                z[at + q] = quantities[q]
        return int(at + count)

    return gather
