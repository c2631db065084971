"""Filter batches of signals by IIR filters, one way or both ways, exactly and differentiably.

Arrays are filtered by SciPy, tensors as `filters.tensors` says, which is loaded for them. Both
compute in float64, whatever the dtype of the signal: filters of high order lose many digits.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array

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
    return _run(Passes(b, a, start, both_ways=False), x, first, dim)


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
    passes = Passes(b, a, start, both_ways=True)
    samples = x.shape[time_axis(x.ndim, dim)]
    if samples <= passes.pad:
        raise ValueError(
            f"zero-phase filtering of order {len(a) - 1} needs more than {passes.pad} samples, "
            f"got {samples}"
        )
    return _run(passes, x, None, dim)


class Passes:
    """Describe one or two filter passes, and run them over arrays.

    Attributes
    ----------
    b, a : Coefficients, `(P + 1,)` each.
    pad : Samples by which both ends are extended.
    directions : Of each pass: whether it runs from the last sample to the first.
    steady : The initial state of a pass, for a first sample of 1.
    """

    def __init__(self, b: Array, a: Array, start: Start, both_ways: bool) -> None:
        self.b, self.a = b, a
        self.pad = 3 * len(a) if start == "odd" else 0
        self.directions = (False, True) if both_ways else (False,)
        order = len(a) - 1
        self.steady = np.zeros(order) if start == "zeros" else _steady(tuple(b), tuple(a))

    def run(self, x: npt.NDArray[Any], recurrence: Callable[..., None]) -> Array:
        """Return `x` `(rows, time)`, filtered; `recurrence` runs a pass, as `passed` does."""
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

    def first_state(self, x: Any, first: Any) -> list[Any]:
        """Return the entries of the state after the first P outputs of `x` `(..., time)`."""
        order, b, a = len(self.a) - 1, self.b, self.a
        return [
            sum(
                float(b[k]) * x[..., order - (k - m)] - float(a[k]) * first[..., order - (k - m)]
                for k in range(m + 1, order + 1)
            )
            for m in range(order)
        ]


def passed(b: Array, a: Array, state: Array, x: Array, y: Array, reverse: bool) -> None:
    """Filter each row of `x` `(rows, time)` into `y`, which may be `x` itself, by SciPy.

    `state` `(rows, P)` is that before the first sample; `reverse`: from the last sample to the
    first. `kernels.recurrence` does the same.
    """
    order = slice(None, None, -1 if reverse else 1)
    y[:, order] = scipy.signal.lfilter(b, a, x[:, order], zi=state)[0]


def _run(passes: Passes, x: Signal, first: Signal | None, dim: int | None) -> Signal:
    """Filter along the time axis; `first` are the first P outputs of a single pass."""
    axis = time_axis(x.ndim, dim)
    if not isinstance(x, np.ndarray):
        from splitband.filters import tensors  # noqa: PLC0415  whoever has a tensor has torch

        return tensors.run(passes, x, first, axis)
    kind = x.dtype if np.issubdtype(x.dtype, np.floating) else np.dtype(np.float64)
    moved = np.moveaxis(x, axis, -1)
    if not moved.size:
        return x.astype(kind)
    rows = moved.reshape(-1, moved.shape[-1]).astype(np.float64)
    if first is None:
        y = passes.run(rows, passed)
    else:
        known = np.moveaxis(np.asarray(first, np.float64), axis, -1).reshape(len(rows), -1)
        state = np.stack(passes.first_state(rows, known), axis=-1)
        y, order = rows, known.shape[1]
        y[:, :order] = known
        passed(passes.b, passes.a, state, rows[:, order:], y[:, order:], reverse=False)
    return np.ascontiguousarray(np.moveaxis(y.reshape(moved.shape), -1, axis), kind)


@lru_cache(maxsize=64)
def _steady(b: tuple[float, ...], a: tuple[float, ...]) -> Array:
    """Return the steady state `(P,)` for a constant input of 1."""
    return scipy.signal.lfilter_zi(b, a)


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
