"""IIR filtering, one way and in both directions: exact, differentiable, on any batch.

A fixed IIR filter is a linear map, so its gradient is the same filter run backwards in time.
Forward and backward are therefore SciPy's compiled recurrence, in float64 whatever the dtype of
the signal. A blocked state-space form in torch operations was slower (benchmarks/filters.py).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt
import scipy
import torch
from torch import Tensor

Array = npt.NDArray[np.float64]
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

    Parameters
    ----------
    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : `"zeros"`, or `"steady"`: as if the first sample had always been there.
    first : The first P outputs, in place of `start`; the paper starts its hybrid model with the
        training signal.
    dim : The time axis; by default 0 for a 1-D signal and -2 otherwise.

    Raises
    ------
    ValueError
        For `start="odd"`, which needs both directions, or a `first` of another length than P.
    """
    b, a = normalised(b, a)
    _check_start(start)
    if start == "odd":
        raise ValueError('start="odd" is for filtering in both directions; use "steady" or "zeros"')
    if first is not None:
        check_first(first.shape, x.shape, len(a) - 1, time_axis(x.ndim, dim))

    def run(x: Tensor, first: Tensor | None) -> Tensor:
        if first is None:
            return _run(b, a, x, start)
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
    """Filter forwards and backwards, so with no phase shift and the response squared.

    Parameters
    ----------
    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : At both ends: `"odd"` extends the signal by 3 (P + 1) samples, point-reflected, as
        `scipy.signal.filtfilt` does; `"steady"` and `"zeros"` extend nothing.
    dim : The time axis; by default 0 for a 1-D signal and -2 otherwise.

    Raises
    ------
    ValueError
        For a signal that is too short for the extension.
    """
    b, a = normalised(b, a)
    _check_start(start)
    pad = 3 * len(a) if start == "odd" else 0
    once: Start = "zeros" if start == "zeros" else "steady"

    def run(x: Tensor, _: Tensor | None) -> Tensor:
        if x.shape[-1] <= pad:
            raise ValueError(
                f"zero-phase filtering of order {len(a) - 1} needs more than {pad} samples, "
                f"got {x.shape[-1]}"
            )
        extended = _extend_odd(x, pad) if pad else x
        forward = _run(b, a, extended, once)
        both = _run(b, a, forward.flip(-1), once).flip(-1)
        return both[..., pad : both.shape[-1] - pad]

    return _along_time(run, x, None, dim)


class _LFilter(torch.autograd.Function):
    """SciPy's `lfilter` on `(..., time)` from the state `zi` `(..., P)`."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, zi: Tensor, b: Array, a: Array) -> Tensor:
        ctx.coefficients = b, a
        signal, state = (t.detach().cpu().numpy() for t in (x, zi))
        # SciPy refuses a signal of no samples.
        y = scipy.signal.lfilter(b, a, signal, zi=state)[0] if signal.size else signal
        return torch.from_numpy(np.ascontiguousarray(y)).to(x.device)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
        b, a = ctx.coefficients
        need_x, need_zi, *_ = ctx.needs_input_grad
        backwards = grad.flip(-1)
        rest = grad.new_zeros(*grad.shape[:-1], len(a) - 1)
        grad_x = grad_zi = None
        if need_x:
            grad_x = _recurrence(b, a, backwards, rest).flip(-1)
        if need_zi:  # the state enters as P extra inputs behind the numerator
            impulse = np.eye(1, len(a))[0]
            seen = _recurrence(impulse, a, backwards, rest).flip(-1)[..., : len(a) - 1]
            grad_zi = torch.nn.functional.pad(seen, (0, len(a) - 1 - seen.shape[-1]))
        return grad_x, grad_zi, None, None


def _recurrence(b: Array, a: Array, x: Tensor, zi: Tensor) -> Tensor:
    return _LFilter.apply(x, zi, b, a)  # type: ignore[no-untyped-call]


def _run(b: Array, a: Array, x: Tensor, start: Start) -> Tensor:
    """Filter `(..., time)` one way from zero or steady state."""
    if start == "steady" and x.shape[-1]:
        zi = x[..., :1] * torch.from_numpy(scipy.signal.lfilter_zi(b, a)).to(x)
    else:
        zi = x.new_zeros(*x.shape[:-1], len(a) - 1)
    return _recurrence(b, a, x, zi)


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
    return torch.cat([first, _recurrence(b, a, x[..., order:], zi)], dim=-1)


def _extend_odd(x: Tensor, pad: int) -> Tensor:
    """Point-reflect `pad` samples at both ends of `(..., time)`."""
    left = 2 * x[..., :1] - x[..., 1 : pad + 1].flip(-1)
    right = 2 * x[..., -1:] - x[..., -pad - 1 : -1].flip(-1)
    return torch.cat([left, x, right], dim=-1)


def _along_time(
    run: Callable[[Tensor, Tensor | None], Tensor],
    x: Signal,
    first: Signal | None,
    dim: int | None,
) -> Signal:
    """Call `run` with the time axis last, on tensors, and give back what came in."""
    axis = time_axis(x.ndim, dim)
    signal = _tensor(x)
    # In float64 whatever comes in: a high order needs the digits.
    known = None if first is None else _tensor(first).to(signal.device, torch.float64)
    if known is not None:
        known = known.movedim(axis, -1)
    y = run(signal.double().movedim(axis, -1), known).movedim(-1, axis).to(signal.dtype)
    return y if isinstance(x, Tensor) else y.numpy()


def _check_start(start: Start) -> None:
    if start not in get_args(Start):
        raise ValueError(f"start must be one of {get_args(Start)}, got {start!r}")


def check_first(first: tuple[int, ...], signal: tuple[int, ...], order: int, axis: int) -> None:
    """Check that `first` has the signal's shape but `order` samples, and the signal that many."""
    given = first[axis] if len(first) == len(signal) else len(first)
    if len(first) != len(signal) or given != order:
        raise ValueError(
            f"first must hold the first {order} outputs, got {given} in shape {tuple(first)}"
        )
    if signal[axis] < order:
        raise ValueError(f"the signal must have at least {order} samples, got {signal[axis]}")
    others = [n for n, of in enumerate(signal) if n != axis % len(signal) and first[n] != of]
    if others:
        raise ValueError(
            f"first must be shaped like the signal {tuple(signal)}, got {tuple(first)}"
        )


def _tensor(x: npt.NDArray[Any] | Tensor) -> Tensor:
    if not isinstance(x, Tensor):
        x = torch.from_numpy(np.require(x, requirements=["C", "W"]))
    return x if x.is_floating_point() else x.double()


def time_axis(ndim: int, dim: int | None) -> int:
    """`dim`, or where the time axis of a signal is by convention."""
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
