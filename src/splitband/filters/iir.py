"""Filter batches of signals by IIR filters, one way or both ways, exactly and differentiably.

A fixed IIR filter is a linear map, so its gradient is the same filter run backwards in time, with
the adjoint of the end extension. Both run as a compiled recurrence in float64, whatever the dtype
of the signal. SciPy designs the filters and is the reference of the tests (speed:
benchmarks/filters.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt
import scipy
import torch
from torch import Tensor

from splitband.kernels import recurrence
from splitband.runtime.arrays import Array

Signal = TypeVar("Signal", npt.NDArray[Any], Tensor)
Start = Literal["odd", "steady", "zeros"]


def lfilter(
    b: npt.ArrayLike,
    a: npt.ArrayLike,
    x: Signal,
    *,
    start: Start = "zeros",
    first: Signal | None = None,
    dim: int | None = None,
) -> Signal:
    """Filter one way: a_0 y_n = sum_k b_k x_{n-k} - sum_{k>=1} a_k y_{n-k}.

    That is the paper's Eq. 4, recurrence.

    The sign of the feedback is SciPy's, not the paper's (docs/deviations.md).

    Raises ValueError for `start="odd"`, which needs both directions, and for a `first` that does
    not have P samples.

    Parameters
    ----------
    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : `"zeros"`, or `"steady"`: as if all earlier samples had the value of the first one.
    first : The first P outputs, in place of `start`; the paper starts its hybrid model with the
        training signal.
    dim : The time axis; by default 0 for a 1-D signal and -2 otherwise.
    """
    b, a = normalised(b, a)
    _check_start(start)
    if start == "odd":
        raise ValueError('start="odd" is for filtering in both directions; use "steady" or "zeros"')
    if first is not None:
        check_first(first.shape, x.shape, len(a) - 1, time_axis(x.ndim, dim))

    def run(x: Tensor, first: Tensor | None) -> Tensor:
        if first is None:
            return _apply(_Passes(b, a, start, both_ways=False), x)
        return _run_on(b, a, x, first)

    return _along_time(run, x, first, dim)


def filtfilt(
    b: npt.ArrayLike,
    a: npt.ArrayLike,
    x: Signal,
    *,
    start: Start = "odd",
    dim: int | None = None,
) -> Signal:
    """Filter forwards and backwards: no phase shift, and a squared magnitude response.

    Raises ValueError for a signal that is too short for the extension.

    Parameters
    ----------
    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : At both ends: `"odd"` extends the signal by 3 (P + 1) samples, point-reflected, as
        `scipy.signal.filtfilt` does; `"steady"` and `"zeros"` extend nothing.
    dim : The time axis; by default 0 for a 1-D signal and -2 otherwise.
    """
    b, a = normalised(b, a)
    _check_start(start)
    passes = _Passes(b, a, start, both_ways=True)

    def run(x: Tensor, _: Tensor | None) -> Tensor:
        if x.shape[-1] <= passes.pad:
            raise ValueError(
                f"zero-phase filtering of order {len(a) - 1} needs more than {passes.pad} samples, "
                f"got {x.shape[-1]}"
            )
        return _apply(passes, x)

    return _along_time(run, x, None, dim)


class _Passes:
    """Run one or two filter passes over `(rows, time)`, and the adjoint of this linear map."""

    def __init__(self, b: Array, a: Array, start: Start, both_ways: bool) -> None:
        self.b, self.a = b, a
        self.pad = 3 * len(a) if start == "odd" else 0
        self.directions = (False, True) if both_ways else (False,)
        order = len(a) - 1
        # The initial state of a pass, for a first sample of 1.
        self.steady = np.zeros(order) if start == "zeros" else _steady(tuple(b), tuple(a))

    def map(self, x: npt.NDArray[Any]) -> Array:
        p = self.pad
        y = np.empty((len(x), x.shape[1] + 2 * p))
        inner = y[:, p : p + x.shape[1]]
        inner[:] = x
        if p:
            y[:, :p] = 2 * inner[:, :1] - inner[:, p:0:-1]
            y[:, -p:] = 2 * inner[:, -1:] - inner[:, -2 : -p - 2 : -1]
        for reverse in self.directions:
            first = y[:, -1] if reverse else y[:, 0]
            recurrence(self.b, self.a, np.outer(first, self.steady), y, y, reverse)
        return inner

    def adjoint(self, grad: npt.NDArray[Any]) -> Array:
        p = self.pad
        g = np.zeros((len(grad), grad.shape[1] + 2 * p))
        inner = g[:, p : p + grad.shape[1]]
        inner[:] = grad
        nothing = np.zeros((len(g), len(self.steady)))
        for reverse in reversed(self.directions):
            onto_state = g @ _responses(tuple(self.b), tuple(self.a), g.shape[1], reverse)
            recurrence(self.b, self.a, nothing, g, g, not reverse)
            g[:, -1 if reverse else 0] += onto_state @ self.steady
        if p:
            left, right = g[:, :p], g[:, -p:]
            inner[:, 0] += 2 * left.sum(axis=1)
            inner[:, -1] += 2 * right.sum(axis=1)
            inner[:, 1 : p + 1] -= left[:, ::-1]
            inner[:, -p - 1 : -1] -= right[:, ::-1]
        return inner


class _Map(torch.autograd.Function):
    """Apply a linear map to `(rows, time)`, or its adjoint; each is the other's gradient."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, passes: _Passes, adjoint: bool) -> Tensor:
        ctx.passes, ctx.adjoint = passes, adjoint
        run = passes.adjoint if adjoint else passes.map
        values = x.detach().cpu().numpy()
        y = run(values) if values.size else values
        return torch.from_numpy(np.array(y, values.dtype)).to(x.device)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        return _Map.apply(grad, ctx.passes, not ctx.adjoint), None, None  # type: ignore[no-untyped-call]


def _apply(passes: _Passes, x: Tensor) -> Tensor:
    """Filter `(..., time)`."""
    y: Tensor = _Map.apply(x.reshape(-1, x.shape[-1]), passes, False)  # type: ignore[no-untyped-call]
    return y.view(x.shape)


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


@lru_cache(maxsize=64)
def _steady(b: tuple[float, ...], a: tuple[float, ...]) -> Array:
    """Return the steady state `(P,)` for a constant input of 1."""
    return scipy.signal.lfilter_zi(b, a)


def _run_on(b: Array, a: Array, x: Tensor, first: Tensor) -> Tensor:
    """Filter `(..., time)` one way in float64, given its first P outputs."""
    order, x = len(a) - 1, x.double()
    state = [
        sum(
            float(b[k]) * x[..., order - (k - m)] - float(a[k]) * first[..., order - (k - m)]
            for k in range(m + 1, order + 1)
        )
        for m in range(order)
    ]
    zi = torch.stack([s for s in state if isinstance(s, Tensor)], dim=-1)
    rest = x[..., order:]
    rows, shape = math.prod(rest.shape[:-1]), rest.shape
    y: Tensor = _LFilter.apply(  # type: ignore[no-untyped-call]
        rest.reshape(rows, -1), zi.reshape(rows, order), b, a, False
    )
    return torch.cat([first, y.view(shape)], dim=-1)


def _along_time(
    run: Callable[[Tensor, Tensor | None], Tensor],
    x: Signal,
    first: Signal | None,
    dim: int | None,
) -> Signal:
    """Call `run` on tensors with the time axis last; return the result in the form of `x`."""
    axis = time_axis(x.ndim, dim)
    signal = as_tensor(x)
    # Computed in float64 for any input, as filters of high order lose many digits.
    known = None if first is None else as_tensor(first).to(signal.device, torch.float64)
    if known is not None:
        known = known.movedim(axis, -1)
    y = run(signal.movedim(axis, -1), known).movedim(-1, axis).to(signal.dtype)
    return y if isinstance(x, Tensor) else y.numpy()


def _check_start(start: Start) -> None:
    if start not in get_args(Start):
        raise ValueError(f"start must be one of {get_args(Start)}, got {start!r}")


def check_first(first: tuple[int, ...], signal: tuple[int, ...], order: int, axis: int) -> None:
    """Check that `first` has the shape of the signal's first `order` samples."""
    if signal[axis] < order:
        raise ValueError(f"the signal must have at least {order} samples, got {signal[axis]}")
    wanted = [*signal]
    wanted[axis] = order
    if tuple(first) != tuple(wanted):
        raise ValueError(
            f"first must hold the first {order} outputs, shape {tuple(wanted)}, got {tuple(first)}"
        )


def as_tensor(x: npt.NDArray[Any] | Tensor) -> Tensor:
    """Return a signal as a floating-point tensor, which may share its memory."""
    if not isinstance(x, Tensor):
        x = torch.from_numpy(np.require(x, requirements=["C", "W"]))
    return x if x.is_floating_point() else x.double()


def time_axis(ndim: int, dim: int | None) -> int:
    """Return `dim`, or the conventional time axis of a signal if it is None."""
    if dim is None:
        return -2 if ndim > 1 else -1
    if not -ndim <= dim < ndim:
        raise ValueError(f"dim must name one of the {ndim} axes, got {dim}")
    return dim


def normalised(b: npt.ArrayLike, a: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the coefficients padded to equal length and divided by a_0."""
    b, a = np.atleast_1d(np.asarray(b, float)), np.atleast_1d(np.asarray(a, float))
    if not a[0]:
        raise ValueError(f"a[0] must not be zero, got {a[0]:g}")
    width = max(len(a), len(b), 2)
    return tuple(np.pad(c, (0, width - len(c))) / a[0] for c in (b, a))
