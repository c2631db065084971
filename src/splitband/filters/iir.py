"""Filter batches of signals by IIR filters, one way or both ways, exactly and differentiably.

Filters are composed of single passes, of `arrays` or `tensors`, so that torch derives the gradient
of the rest. Passes compute in float64 for signals of any dtype: filters of high order lose many
digits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt
import scipy

from splitband.filters import arrays
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

Signal = TypeVar("Signal", npt.NDArray[Any], "Tensor")
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

    The paper's Eq. 4, recurrence, with SciPy's sign of the feedback (reproduction/REPORT.md).

    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : `"zeros"`, or `"steady"`: as if all earlier samples had the value of the first one.
    first : The first P outputs, in place of `start`; the paper starts its hybrid model with the
        training signal.
    dim : The time axis; by default 0 for a 1-D signal and -2 otherwise.
    """
    b, a = normalised(b, a)
    _check_start(start)
    axis, order, of = time_axis(x.ndim, dim), len(a) - 1, _kind(x)
    rows = of.rows(x, axis)
    if first is None:
        return of.signal(_pass(of, b, a, rows, start), axis, x)
    check_first(first.shape, x.shape, order, axis)
    outputs = of.rows(first, axis)
    state = of.xp.stack(_state_after(b, a, rows, outputs), -1)
    rest = of.one_pass(b, a, rows[..., order:], state)
    return of.signal(of.xp.concatenate([outputs, rest], -1), axis, x)


def filtfilt(
    b: npt.ArrayLike,
    a: npt.ArrayLike,
    x: Signal,
    *,
    start: Start = "odd",
    dim: int | None = None,
) -> Signal:
    """Filter forwards and backwards: no phase shift, and a squared magnitude response.

    b, a : Coefficients; the longer one has P + 1.
    x : The signal.
    start : At both ends: `"odd"` extends the signal by 3 (P + 1) samples, point-reflected, as
        `scipy.signal.filtfilt` does; `"steady"` and `"zeros"` extend nothing.
    dim : The time axis; by default 0 for a 1-D signal and -2 otherwise.
    """
    b, a = normalised(b, a)
    _check_start(start)
    axis, of = time_axis(x.ndim, dim), _kind(x)
    pad, samples = 3 * len(a) if start == "odd" else 0, x.shape[axis]
    if samples <= pad:
        raise InputError(
            f"zero-phase filtering of order {len(a) - 1} needs more than {pad} samples, "
            f"got {samples}"
        )
    rows = of.rows(x, axis)
    if pad:
        before = 2 * rows[..., :1] - of.xp.flip(rows[..., 1 : pad + 1], (-1,))
        after = 2 * rows[..., -1:] - of.xp.flip(rows[..., -pad - 1 : -1], (-1,))
        rows = of.xp.concatenate([before, rows, after], -1)
    for reverse in (False, True):
        rows = _pass(of, b, a, rows, start, reverse)
    return of.signal(rows[..., pad : pad + samples], axis, x)


def _kind(x: Any) -> Any:
    """Return the module with the passes for arrays or tensors, by the type of `x`."""
    if isinstance(x, np.ndarray):
        return arrays
    from splitband.filters import tensors  # noqa: PLC0415  whoever has a tensor has torch

    return tensors


def _pass(of: Any, b: Array, a: Array, x: Any, start: Start, reverse: bool = False) -> Any:
    """Filter `(..., time)` from zero, or from the steady state for the first sample."""
    if not x.shape[-1]:
        return x
    steady = np.zeros(len(a) - 1) if start == "zeros" else _steady(tuple(b), tuple(a))
    first = x[..., -1:] if reverse else x[..., :1]
    return of.one_pass(b, a, x, first * of.xp.asarray(steady), reverse)


def _state_after(b: Array, a: Array, x: Any, y: Any) -> list[Any]:
    """Return the entries of the state after the first P samples of `x` and outputs `y`."""
    order = len(a) - 1
    return [
        sum(
            float(b[k]) * x[..., order - (k - m)] - float(a[k]) * y[..., order - (k - m)]
            for k in range(m + 1, order + 1)
        )
        for m in range(order)
    ]


@lru_cache(maxsize=64)
def _steady(b: tuple[float, ...], a: tuple[float, ...]) -> Array:
    """Return the steady state `(P,)` for a constant input of 1."""
    # From SciPy 1.18 on the state has a negative stride, which torch refuses.
    return scipy.signal.lfilter_zi(b, a).copy()


def _check_start(start: Start) -> None:
    if start not in get_args(Start):
        raise InputError(f"start must be one of {get_args(Start)}, got {start!r}")


def check_first(first: tuple[int, ...], signal: tuple[int, ...], order: int, axis: int) -> None:
    """Check that `first` has the shape of the signal's first `order` samples."""
    if signal[axis] < order:
        raise InputError(f"the signal must have at least {order} samples, got {signal[axis]}")
    shape = [*signal]
    shape[axis] = order
    if tuple(first) != tuple(shape):
        raise InputError(
            f"first must hold the first {order} outputs, shape {tuple(shape)}, got {tuple(first)}"
        )


def time_axis(ndim: int, dim: int | None) -> int:
    """Return `dim`, or the conventional time axis of a signal for None."""
    if dim is None:
        return -2 if ndim > 1 else -1
    if not -ndim <= dim < ndim:
        raise InputError(f"dim must name one of the {ndim} axes, got {dim}")
    return dim


def normalised(b: npt.ArrayLike, a: npt.ArrayLike) -> tuple[Array, Array]:
    """Return the coefficients padded to equal length and divided by a_0."""
    b, a = np.atleast_1d(np.asarray(b, float)), np.atleast_1d(np.asarray(a, float))
    if not a[0]:
        raise InputError(f"a[0] must not be zero, got {a[0]:g}")
    width = max(len(a), len(b), 2)
    return tuple(np.pad(c, (0, width - len(c))) / a[0] for c in (b, a))
