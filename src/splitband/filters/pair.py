"""Design Butterworth filters and complementary pairs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import scipy

from splitband.filters.iir import (
    Signal,
    Start,
    check_first,
    filtfilt,
    lfilter,
    normalised,
    time_axis,
)
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

Band = Literal["low", "high"]


def butterworth(
    cutoff: float, sampling_rate: float, order: int = 1, band: Band = "low"
) -> tuple[Array, Array]:
    """Design a Butterworth filter; return its coefficients `(b, a)`, each `(order + 1,)`.

    cutoff : Frequency of half power in Hz, inside (0, sampling_rate / 2).
    sampling_rate : In Hz.
    order : At least 1.
    band : `"low"` or `"high"`, the pass band.
    """
    nyquist = sampling_rate / 2
    if not sampling_rate > 0:
        raise InputError(f"sampling_rate must be positive, got {sampling_rate:g} Hz")
    if not 0 < cutoff < nyquist:
        raise InputError(
            f"cutoff must lie between 0 and the Nyquist frequency {nyquist:g} Hz, got {cutoff:g} Hz"
        )
    if order < 1:
        raise InputError(f"order must be at least 1, got {order}")
    low, a = scipy.signal.iirfilter(order, cutoff, btype="low", ftype="butter", fs=sampling_rate)
    high, _ = scipy.signal.iirfilter(order, cutoff, btype="high", ftype="butter", fs=sampling_rate)
    # The gain must be 1 at zero frequency (z = 1, low-pass) and at Nyquist (z = -1, high-pass).
    for b, z in ((low, 1.0), (high, -1.0)):
        rest = np.polyval(a, z)
        gain = float(np.polyval(b, z) / rest) if rest else float("inf")
        if abs(gain - 1) > 1e-6 or _largest_pole(a) >= 1:
            raise InputError(
                f"order {order} is too high for a cut-off of {cutoff:g} Hz at "
                f"{sampling_rate:g} Hz: its coefficients are lost in rounding (a gain that should "
                f"be 1 is {gain:.3g}); lower the order or move the cut-off"
            )
    return (low if band == "low" else high), a


@dataclass(frozen=True, eq=False)
class ComplementaryPair:
    """A low-pass and a high-pass filter with the identity as their sum.

    See Ensinger et al. 2023, Eq. 3, complementarity, and Eq. 6, joint recurrence, for both.

    Use `ComplementaryPair.butterworth` or `ComplementaryPair.perfect`.

    Attributes
    ----------
    b_low, b_high, a : Coefficients `(P + 1,)` over one common denominator, a_0 = 1.
    sampling_rate : In Hz.
    cutoff : In Hz, where it is known.
    zero_phase : Whether the filters run in both directions.
    start : Initial state of the filters, see `lfilter` and `filtfilt`.

    Examples
    --------
    >>> y = np.sin(0.1 * np.arange(200))
    >>> pair = sb.ComplementaryPair.perfect([0.1], [1.0, -0.9], sampling_rate=20)
    >>> low, high = pair.split(y)
    >>> bool(np.abs(low + high - y).max() < 1e-12)
    True

    The low band of one signal and the high band of another:

    >>> pair.combine(low=y, high=np.zeros(200)).shape
    (200,)
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
            raise InputError(f"b_low, b_high and a must have one length, got {sorted(lengths)}")
        if self.start == "odd" and not self.zero_phase:
            raise InputError('start="odd" needs zero_phase=True; use "steady" or "zeros"')
        if (largest := _largest_pole(self.a)) >= 1:
            raise InputError(
                f"the filter must be stable, its poles inside the unit circle, "
                f"got one at |z| = {largest:.6g}"
            )

    @classmethod
    def butterworth(
        cls,
        cutoff: float,
        sampling_rate: float,
        order: int = 1,
        zero_phase: bool = True,
        start: Start | None = None,
    ) -> ComplementaryPair:
        """Return two Butterworth filters with a common cut-off.

        They satisfy `|L|^2 + |H|^2 = 1`: filtered in both directions, the bands sum to the signal
        for any order, except at its ends; one way, for order 1 only.

        Parameters
        ----------
        cutoff, sampling_rate : In Hz.
        order : Of each filter, one way.
        zero_phase : Run in both directions: no delay, but outputs then depend on later samples.
        start : By default `"odd"` in both directions and `"steady"` one way.
        """
        b_low, a = butterworth(cutoff, sampling_rate, order, "low")
        b_high, _ = butterworth(cutoff, sampling_rate, order, "high")
        start = start or ("odd" if zero_phase else "steady")
        return cls(b_low, b_high, a, sampling_rate, cutoff, zero_phase, start)

    @classmethod
    def perfect(  # noqa: PLR0913
        cls,
        b: npt.ArrayLike,
        a: npt.ArrayLike,
        sampling_rate: float,
        band: Band = "low",
        zero_phase: bool = False,
        start: Start | None = None,
        cutoff: float | None = None,
    ) -> ComplementaryPair:
        """Complete a stable filter `b`, `a` to L + H = 1 (Ensinger et al. 2023, Sec. 3.3).

        `band` is the band of the filter `b`; the numerator of the other is a - b. L + H = 1 holds
        one way; in both directions the sum is L^2 + H^2 instead.
        """
        b, a = normalised(b, a)
        low, high = (b, a - b) if band == "low" else (a - b, b)
        start = start or ("odd" if zero_phase else "steady")
        return cls(low, high, a, sampling_rate, cutoff, zero_phase, start)

    def one_way(self) -> ComplementaryPair:
        """Return the same filters run forwards only: their gains are the square roots."""
        if not self.zero_phase:
            return self
        start: Start = "steady" if self.start == "odd" else self.start
        return replace(self, zero_phase=False, start=start)

    @property
    def order(self) -> int:
        """Return P, the order of each filter one way."""
        return len(self.a) - 1

    def lowpass(self, y: Signal, dim: int | None = None) -> Signal:
        """Return the low band L(y), shaped like `y`."""
        return self._filter(self.b_low, y, dim)

    def highpass(self, y: Signal, dim: int | None = None) -> Signal:
        """Return the high band H(y), shaped like `y`."""
        return self._filter(self.b_high, y, dim)

    def split(self, y: Signal, dim: int | None = None) -> tuple[Signal, Signal]:
        """Return both bands `(L(y), H(y))`, each shaped like `y`."""
        return self.lowpass(y, dim), self.highpass(y, dim)

    def combine(
        self, *, low: Signal, high: Signal, first: Signal | None = None, dim: int | None = None
    ) -> Signal:
        """Return L(low) + H(high) (Ensinger et al. 2023, Eq. 6, joint recurrence).

        One way, `first` may give the first P outputs of the sum. The recurrence is linear: the low
        band is filtered separately, and the high band starts from `first` minus the low band. A
        constant low band then needs to be filtered only once.
        """
        if first is not None:
            check_first(first.shape, low.shape, self.order, time_axis(low.ndim, dim))
        low = self.lowpass(low, dim)
        if first is None:
            return low + self.highpass(high, dim)
        head = (slice(None),) * (time_axis(low.ndim, dim) % low.ndim) + (slice(self.order),)
        return low + self.highpass_from(high, first - low[head], dim)

    def highpass_from(self, y: Signal, first: Signal, dim: int | None = None) -> Signal:
        """Return H(y) one way, with its first P outputs given."""
        if self.zero_phase:
            raise InputError("first outputs can be given one way only (zero_phase=False)")
        return lfilter(self.b_high, self.a, y, first=first, dim=dim)

    def response(self, freqs: npt.ArrayLike) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """Return the complex responses `(L, H)` at `freqs` in Hz; squared moduli for zero phase."""
        pair = [
            scipy.signal.freqz(b, self.a, worN=np.atleast_1d(freqs), fs=self.sampling_rate)[1]
            for b in (self.b_low, self.b_high)
        ]
        low, high = (abs(r) ** 2 if self.zero_phase else r for r in pair)
        return low, high

    def reconstruction_error(self, y: Signal, dim: int | None = None) -> Signal:
        """Return y - L(y) - H(y), shaped like `y`; the error is largest at the ends."""
        low, high = self.split(y, dim)
        return y - low - high

    def _filter(self, b: Array, y: Signal, dim: int | None) -> Signal:
        run = filtfilt if self.zero_phase else lfilter
        return run(b, self.a, y, start=self.start, dim=dim)


def _largest_pole(a: Array) -> float:
    return float(max(abs(np.roots(a)), default=0.0))
