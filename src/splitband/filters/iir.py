"""Filter batches of signals by IIR filters, one way or both ways, exactly and differentiably.

A fixed IIR filter is a linear map, so its gradient is the same filter run backwards in time. Both
run as a compiled recurrence in float64, whatever the dtype of the signal; SciPy designs the filters
and is what the tests compare with (benchmarks/filters.py for the speed).
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
    """Filter one way: a_0 y_n = sum_k b_k x_{n-k} - sum_{k>=1} a_k y_{n-k} (paper, Eq. 6).

    The sign of the feedback is SciPy's, not the paper's (docs/deviations.md).

    Raises ValueError for `start="odd"`, which needs both directions, or a `first` of another length
    than P.

    Parameters
    ----------
    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : `"zeros"`, or `"steady"`: as if the first sample had always been there.
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
        return _one_pass(b, a, x, start) if first is None else _run_on(b, a, x, first)

    return _along_time(run, x, first, dim)


def filtfilt(
    b: npt.ArrayLike,
    a: npt.ArrayLike,
    x: Signal,
    *,
    start: Start = "odd",
    dim: int | None = None,
) -> Signal:
    """Filter forwards and backwards, so with no phase shift and the response squared.

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
    pad = 3 * len(a) if start == "odd" else 0

    def run(x: Tensor, _: Tensor | None) -> Tensor:
        samples = x.shape[-1]
        if samples <= pad:
            raise ValueError(
                f"zero-phase filtering of order {len(a) - 1} needs more than {pad} samples, "
                f"got {samples}"
            )
        if pad:
            before = 2 * x[..., :1] - x[..., 1 : pad + 1].flip(-1)
            after = 2 * x[..., -1:] - x[..., -pad - 1 : -1].flip(-1)
            x = torch.cat([before, x, after], dim=-1)
        for reverse in (False, True):
            x = _one_pass(b, a, x, start, reverse)
        return x[..., pad : pad + samples]

    return _along_time(run, x, None, dim)


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


def _one_pass(b: Array, a: Array, x: Tensor, start: Start, reverse: bool = False) -> Tensor:
    """Filter `(..., time)` in one direction."""
    steady = np.zeros(len(a) - 1) if start == "zeros" else _steady(tuple(b), tuple(a))
    edge = x[..., -1:] if reverse else x[..., :1]
    return _from_state(b, a, x, edge * torch.from_numpy(steady).to(x), reverse)


@lru_cache(maxsize=64)
def _steady(b: tuple[float, ...], a: tuple[float, ...]) -> Array:
    """Return the steady state `(P,)` for a constant input of 1."""
    return scipy.signal.lfilter_zi(b, a)


def _run_on(b: Array, a: Array, x: Tensor, first: Tensor) -> Tensor:
    """Filter `(..., time)` one way, going on from the first P outputs."""
    order = len(a) - 1
    state = [
        sum(
            float(b[k]) * x[..., order - (k - m)] - float(a[k]) * first[..., order - (k - m)]
            for k in range(m + 1, order + 1)
        )
        for m in range(order)
    ]
    zi = torch.stack([s for s in state if isinstance(s, Tensor)], dim=-1)
    return torch.cat([first, _from_state(b, a, x[..., order:], zi)], dim=-1)


def _from_state(b: Array, a: Array, x: Tensor, zi: Tensor, reverse: bool = False) -> Tensor:
    """Filter `(..., time)` from the state `(..., P)`."""
    if not x.numel():
        return x
    rows, samples = math.prod(x.shape[:-1]), x.shape[-1]
    y: Tensor = _LFilter.apply(  # type: ignore[no-untyped-call]
        x.reshape(rows, samples), zi.reshape(rows, len(a) - 1), b, a, reverse
    )
    return y.view(x.shape)


def _along_time(
    run: Callable[[Tensor, Tensor | None], Tensor],
    x: Signal,
    first: Signal | None,
    dim: int | None,
) -> Signal:
    """Call `run` with the time axis last, on float64 tensors, and give back what came in.

    In float64 for any input, as filters of high order lose many digits.
    """
    axis = time_axis(x.ndim, dim)
    signal = as_tensor(x)
    known = None if first is None else as_tensor(first).to(signal.device).double().movedim(axis, -1)
    y = run(signal.double().movedim(axis, -1), known).movedim(-1, axis).to(signal.dtype)
    return y if isinstance(x, Tensor) else y.numpy()


def _check_start(start: Start) -> None:
    if start not in get_args(Start):
        raise ValueError(f"start must be one of {get_args(Start)}, got {start!r}")


def check_first(first: tuple[int, ...], signal: tuple[int, ...], order: int, axis: int) -> None:
    """Check that `first` has the signal's shape but `order` samples, and the signal that many."""
    if signal[axis] < order:
        raise ValueError(f"the signal must have at least {order} samples, got {signal[axis]}")
    wanted = [*signal]
    wanted[axis] = order
    if tuple(first) != tuple(wanted):
        raise ValueError(
            f"first must hold the first {order} outputs, shape {tuple(wanted)}, got {tuple(first)}"
        )


def as_tensor(x: npt.NDArray[Any] | Tensor) -> Tensor:
    """Return a signal as a tensor of floating-point numbers, which may share its memory."""
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
    """Bring the coefficients to one length, with a_0 = 1."""
    b, a = np.atleast_1d(np.asarray(b, float)), np.atleast_1d(np.asarray(a, float))
    if not a[0]:
        raise ValueError(f"a[0] must not be zero, got {a[0]:g}")
    width = max(len(a), len(b), 2)
    return tuple(np.pad(c, (0, width - len(c))) / a[0] for c in (b, a))
