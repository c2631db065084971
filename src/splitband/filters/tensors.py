"""Filter tensors, exactly and differentiably.

A fixed IIR filter is a linear map, so its gradient is the same filter run backwards in time, with
the adjoint of the end extension. Both run as a compiled recurrence in float64 (speed:
benchmarks/filters.py).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from splitband.filters.iir import Passes
from splitband.kernels.recurrence import recurrence
from splitband.runtime.arrays import Array


def run(passes: Passes, x: Tensor, first: Tensor | None, axis: int) -> Tensor:
    """Return a signal filtered along an axis; `first` are the first P outputs of a single pass."""
    signal = floating(x)
    rows = signal.movedim(axis, -1)
    if first is None:
        y: Tensor = _Map.apply(rows.reshape(-1, rows.shape[-1]), passes, False)  # type: ignore[no-untyped-call]
        y = y.view(rows.shape)
    else:
        known = floating(first).to(signal.device, torch.float64).movedim(axis, -1)
        y = _run_on(passes, rows.double(), known)
    return y.movedim(-1, axis).to(signal.dtype)


def floating(x: npt.NDArray[Any] | Tensor) -> Tensor:
    """Return a signal as a floating-point tensor, which may share its memory."""
    if not isinstance(x, Tensor):
        x = torch.from_numpy(np.require(x, requirements=["C", "W"]))
    return x if x.is_floating_point() else x.double()


class _Map(torch.autograd.Function):
    """Apply a linear map to `(rows, time)`, or its adjoint; each is the other's gradient."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, passes: Passes, adjoint: bool) -> Tensor:
        ctx.passes, ctx.adjoint = passes, adjoint
        values = x.detach().cpu().numpy()
        if not values.size:
            y = values
        else:
            y = _adjoint(passes, values) if adjoint else passes.run(values, recurrence)
        return torch.from_numpy(np.array(y, values.dtype)).to(x.device)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        return _Map.apply(grad, ctx.passes, not ctx.adjoint), None, None  # type: ignore[no-untyped-call]


def _adjoint(passes: Passes, grad: npt.NDArray[Any]) -> Array:
    """Return the adjoint of `Passes.run`, applied to `(rows, time)`."""
    b, a, p = passes.b, passes.a, passes.pad
    g = np.zeros((len(grad), grad.shape[1] + 2 * p))
    inner = g[:, p : p + grad.shape[1]]
    inner[:] = grad
    nothing = np.zeros((len(g), len(passes.steady)))
    for reverse in reversed(passes.directions):
        onto_state = g @ _responses(tuple(b), tuple(a), g.shape[1], reverse)
        recurrence(b, a, nothing, g, g, not reverse)
        g[:, -1 if reverse else 0] += onto_state @ passes.steady
    if p:
        left, right = g[:, :p], g[:, -p:]
        inner[:, 0] += 2 * left.sum(axis=1)
        inner[:, -1] += 2 * right.sum(axis=1)
        inner[:, 1 : p + 1] -= left[:, ::-1]
        inner[:, -p - 1 : -1] -= right[:, ::-1]
    return inner


class _LFilter(torch.autograd.Function):
    """Run one pass over `(rows, time)` in float64 from the state `zi` `(rows, P)`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, zi: Tensor, b: Array, a: Array, reverse: bool) -> Tensor:
        ctx.coefficients, ctx.reverse = (b, a), reverse
        values, state = (t.detach().cpu().numpy() for t in (x, zi))
        y = np.empty(values.shape)
        recurrence(b, a, np.ascontiguousarray(state), np.ascontiguousarray(values), y, reverse)
        return torch.from_numpy(y).to(x.device)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        b, a = ctx.coefficients
        responses = torch.from_numpy(_responses(tuple(b), tuple(a), grad.shape[-1], ctx.reverse))
        nothing = grad.new_zeros(len(grad), len(a) - 1)
        grad_x = _LFilter.apply(grad, nothing, b, a, not ctx.reverse)  # type: ignore[no-untyped-call]
        return grad_x, grad @ responses.to(grad), None, None, None


@lru_cache(maxsize=4)
def _responses(
    b: tuple[float, ...], a: tuple[float, ...], samples: int, reverse: bool
) -> npt.NDArray[Any]:
    """Return the output's response to each entry of the initial state, `(samples, P)`."""
    order = len(a) - 1
    y = np.zeros((order, samples))
    recurrence(np.array(b), np.array(a), np.eye(order), y, y, reverse)
    return np.ascontiguousarray(y.T)


def _run_on(passes: Passes, x: Tensor, first: Tensor) -> Tensor:
    """Filter `(..., time)` one way in float64, given its first P outputs."""
    zi = torch.stack(passes.first_state(x, first), dim=-1)
    order = zi.shape[-1]
    rest = x[..., order:]
    rows, shape = math.prod(rest.shape[:-1]), rest.shape
    y: Tensor = _LFilter.apply(  # type: ignore[no-untyped-call]
        rest.reshape(rows, -1), zi.reshape(rows, order), passes.b, passes.a, False
    )
    return torch.cat([first, y.view(shape)], dim=-1)
