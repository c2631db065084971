"""Complementary filters: IIR design, exact differentiable filtering, low/high pairs.

A fixed IIR filter is a linear map, so its gradient is the same filter run backwards in time.
Forward and backward are therefore SciPy's compiled recurrence, in float64 whatever the dtype of
the signal; `benchmarks/filters.py` holds the measurement behind that choice.

Signals are `(time,)`, `(time, ny)` or `(batch, time, ny)`; `dim` names another time axis.
NumPy in, NumPy out; torch in, torch out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
import scipy
import torch
from torch import Tensor

Array = npt.NDArray[np.float64]
Signal = TypeVar("Signal", npt.NDArray[Any], Tensor)
Band = Literal["low", "high"]
Start = Literal["odd", "steady", "zeros"]


def butterworth(
    cutoff: float, sampling_rate: float, order: int = 1, band: Band = "low"
) -> tuple[Array, Array]:
    """Design a Butterworth filter; return its coefficients `(b, a)`, each `(order + 1,)`.

    Parameters
    ----------
    cutoff : Frequency of half power in Hz, inside (0, sampling_rate / 2).
    sampling_rate : In Hz.
    order : At least 1.
    band : Which side of the cut-off passes.

    Raises
    ------
    ValueError
        For a cut-off outside the Nyquist range, or an order so high for the cut-off that the
        coefficients no longer describe the filter in double precision.
    """
    nyquist = sampling_rate / 2
    if not sampling_rate > 0:
        raise ValueError(f"sampling_rate must be positive, got {sampling_rate:g} Hz")
    if not 0 < cutoff < nyquist:
        raise ValueError(
            f"cutoff must lie between 0 and the Nyquist frequency {nyquist:g} Hz, got {cutoff:g} Hz"
        )
    if order < 1:
        raise ValueError(f"order must be at least 1, got {order}")
    b, a = scipy.signal.iirfilter(order, cutoff, btype=band, ftype="butter", fs=sampling_rate)
    passed = 1.0 if band == "low" else -1.0  # z at zero frequency, at the Nyquist frequency
    rest = np.polyval(a, passed)
    gain = float(np.polyval(b, passed) / rest) if rest else float("inf")
    if abs(gain - 1) > 1e-6 or _largest_pole(a) >= 1:
        raise ValueError(
            f"order {order} is too high for a cut-off of {cutoff:g} Hz at {sampling_rate:g} Hz: "
            f"its coefficients are lost in rounding (the gain that should be 1 is {gain:.3g}); "
            f"lower the order or raise the cut-off"
        )
    return b, a


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
    b, a = _normalised(b, a)
    if start == "odd":
        raise ValueError('start="odd" is for filtering in both directions; use "steady" or "zeros"')
    if first is not None:
        _check_first(first.shape, x.shape, len(a) - 1, _time_axis(x.ndim, dim))

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
    b, a = _normalised(b, a)
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


@dataclass(frozen=True, eq=False)
class ComplementaryPair:
    """A low-pass and a high-pass filter that together pass everything (paper, Eqs. 3 and 7).

    Use `ComplementaryPair.butterworth` or `ComplementaryPair.perfect`.

    Attributes
    ----------
    b_low, b_high, a : Coefficients `(P + 1,)` over one common denominator, a_0 = 1.
    sampling_rate : In Hz.
    cutoff : In Hz, where it is known.
    zero_phase : Whether the filters run in both directions.
    start : How they start, see `lfilter` and `filtfilt`.
    """

    b_low: Array
    b_high: Array
    a: Array
    sampling_rate: float
    cutoff: float | None = None
    zero_phase: bool = True
    start: Start = "odd"

    def __post_init__(self) -> None:
        """Check the coefficients."""
        lengths = {len(self.b_low), len(self.b_high), len(self.a)}
        if len(lengths) > 1:
            raise ValueError(f"b_low, b_high and a must have one length, got {sorted(lengths)}")
        if self.start == "odd" and not self.zero_phase:
            raise ValueError('start="odd" needs zero_phase=True; use "steady" or "zeros"')
        _check_stable(self.a)

    @classmethod
    def butterworth(
        cls,
        cutoff: float,
        sampling_rate: float,
        order: int = 1,
        zero_phase: bool = True,
        start: Start | None = None,
    ) -> ComplementaryPair:
        """Two Butterworth filters that share a cut-off.

        They satisfy |L|^2 + |H|^2 = 1, so in both directions any order adds up to the identity
        away from the ends of a signal. One way, only order 1 does.

        Parameters
        ----------
        cutoff, sampling_rate : In Hz.
        order : Of each filter, one way.
        zero_phase : Run both directions: no delay, but each output then depends on later samples.
        start : By default `"odd"` in both directions and `"steady"` one way.
        """
        b_low, a = butterworth(cutoff, sampling_rate, order, "low")
        b_high, _ = butterworth(cutoff, sampling_rate, order, "high")
        start = start or ("odd" if zero_phase else "steady")
        return cls(b_low, b_high, a, sampling_rate, cutoff, zero_phase, start)

    @classmethod
    def perfect(
        cls,
        b: npt.ArrayLike,
        a: npt.ArrayLike,
        sampling_rate: float,
        band: Band = "low",
        zero_phase: bool = False,
        start: Start | None = None,
        cutoff: float | None = None,
    ) -> ComplementaryPair:
        """Complete any stable filter with coefficients `b`, `a` to L + H = 1 (paper, Sec. 3.3).

        `band` says which of the two `b` describes; the other is a - b. L + H = 1 holds one way;
        in both directions the pair adds up to L^2 + H^2 instead.
        """
        b, a = _normalised(b, a)
        low, high = (b, a - b) if band == "low" else (a - b, b)
        start = start or ("odd" if zero_phase else "steady")
        return cls(low, high, a, sampling_rate, cutoff, zero_phase, start)

    @property
    def order(self) -> int:
        """P, the order of each filter one way."""
        return len(self.a) - 1

    def lowpass(self, y: Signal, dim: int | None = None) -> Signal:
        """L(y), shaped like `y`."""
        return self._filter(self.b_low, y, dim)

    def highpass(self, y: Signal, dim: int | None = None) -> Signal:
        """H(y), shaped like `y`."""
        return self._filter(self.b_high, y, dim)

    def split(self, y: Signal, dim: int | None = None) -> tuple[Signal, Signal]:
        """`(L(y), H(y))`, each shaped like `y`."""
        return self.lowpass(y, dim), self.highpass(y, dim)

    def combine(
        self, *, low: Signal, high: Signal, first: Signal | None = None, dim: int | None = None
    ) -> Signal:
        """L(low) + H(high), the joint recurrence (paper, Eq. 7), shaped like its arguments.

        One way, `first` may give the first P outputs of the sum. The recurrence is linear, so the
        low part runs by itself and the high part starts from what it leaves of `first`: a low
        part that does not change needs to be filtered only once.
        """
        if first is not None:
            _check_first(first.shape, low.shape, self.order, _time_axis(low.ndim, dim))
        low = self.lowpass(low, dim)
        if first is None:
            return low + self.highpass(high, dim)
        rest = first - self._head(low, dim)
        return low + self.highpass_from(high, rest, dim)

    def highpass_from(self, y: Signal, first: Signal, dim: int | None = None) -> Signal:
        """H(y) one way, with its first P outputs given."""
        if self.zero_phase:
            raise ValueError("first outputs can be given one way only (zero_phase=False)")
        return lfilter(self.b_high, self.a, y, first=first, dim=dim)

    def response(self, freqs: npt.ArrayLike) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """The complex responses `(L, H)` at `freqs` in Hz; real squares where zero-phase."""
        pair = [
            scipy.signal.freqz(b, self.a, worN=np.atleast_1d(freqs), fs=self.sampling_rate)[1]
            for b in (self.b_low, self.b_high)
        ]
        low, high = (abs(r) ** 2 if self.zero_phase else r for r in pair)
        return low, high

    def reconstruction_error(self, y: Signal, dim: int | None = None) -> Signal:
        """Y - L(y) - H(y), shaped like `y`: what the pair loses, mostly at the ends."""
        low, high = self.split(y, dim)
        return y - low - high

    def _filter(self, b: Array, y: Signal, dim: int | None) -> Signal:
        run = filtfilt if self.zero_phase else lfilter
        return run(b, self.a, y, start=self.start, dim=dim)

    def _head(self, y: Signal, dim: int | None) -> Signal:
        axis = _time_axis(y.ndim, dim)
        return y[(slice(None),) * (axis % y.ndim) + (slice(self.order),)]


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
    axis = _time_axis(x.ndim, dim)
    signal = _tensor(x)
    # In float64 whatever comes in: a high order needs the digits.
    known = None if first is None else _tensor(first).to(signal.device, torch.float64)
    if known is not None:
        known = known.movedim(axis, -1)
    y = run(signal.double().movedim(axis, -1), known).movedim(-1, axis).to(signal.dtype)
    return y if isinstance(x, Tensor) else y.numpy()


def _check_first(first: tuple[int, ...], signal: tuple[int, ...], order: int, axis: int) -> None:
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


def _time_axis(ndim: int, dim: int | None) -> int:
    if dim is None:
        return -2 if ndim > 1 else -1
    if not -ndim <= dim < ndim:
        raise ValueError(f"dim must name one of the {ndim} axes, got {dim}")
    return dim


def _normalised(b: npt.ArrayLike, a: npt.ArrayLike) -> tuple[Array, Array]:
    """Bring the coefficients to one length, with a_0 = 1."""
    b, a = np.atleast_1d(np.asarray(b, float)), np.atleast_1d(np.asarray(a, float))
    if not a[0]:
        raise ValueError(f"a[0] must not be zero, got {a[0]:g}")
    width = max(len(a), len(b), 2)
    return tuple(np.pad(c, (0, width - len(c))) / a[0] for c in (b, a))


def _check_stable(a: Array) -> None:
    largest = _largest_pole(a)
    if largest >= 1:
        raise ValueError(
            f"the filter must be stable, its poles inside the unit circle, "
            f"got one at |z| = {largest:.6g}"
        )


def _largest_pole(a: Array) -> float:
    return float(max(abs(np.roots(a)), default=0.0))
