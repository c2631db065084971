"""Split signals into bands: IIR design, exact differentiable filtering, low/high pairs.

Signals are `(time,)`, `(time, ny)` or `(batch, time, ny)`; `dim` names another time axis.
NumPy in, NumPy out; torch in, torch out.
"""

from splitband.filters.iir import Start, filtfilt, lfilter
from splitband.filters.pair import Band, ComplementaryPair, butterworth

__all__ = ["Band", "ComplementaryPair", "Start", "butterworth", "filtfilt", "lfilter"]
