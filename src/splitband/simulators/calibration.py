"""Calibrate a simulator: gain, offset, delay and clock, if a term lowers the error.

Not in the paper. A small clock error or delay makes even a good simulator wrong after a while; the
training part of the record is sufficient for an estimate. Larger sets of terms are compared with
smaller ones on held-out samples.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np
import scipy

from splitband.metrics import rmse, spread
from splitband.runtime.arrays import Array, Flags
from splitband.runtime.deadlines import check
from splitband.runtime.errors import InputError

Term = Literal["gain", "offset", "delay", "clock"]
TERMS: tuple[Term, ...] = get_args(Term)
MOST_DELAY = 0.1
"""Largest delay or advance of a simulator, as a share of the training part's duration. Bounds the
time of the search and of the simulation."""
MOST_CLOCK = 0.05
"""Largest relative deviation of the simulator's clock from 1. Bounds the time as `MOST_DELAY`."""
_MOVING: tuple[Term, ...] = "delay", "clock"
_STILL = np.array([0.0, 1.0])
"""Delay in samples and clock factor of an uncalibrated simulator."""
_WORTH = 0.98
"""Largest error of a useful larger set of terms, as a share of a smaller set's. By eye."""
_SETS: tuple[tuple[Term, ...], ...] = (
    (),
    ("offset",),
    ("gain", "offset"),
    ("gain", "offset", "delay"),
    ("gain", "offset", "clock"),
    ("gain", "offset", "delay", "clock"),
)


@dataclass(frozen=True)
class Calibration:
    """A map from a simulation to the record: y(t) = offset + gain * simulator(clock * t - delay).

    t is counted from the first training sample, the origin.

    Attributes
    ----------
    gain, offset : One value per channel; empty for 1 and 0.
    delay : Delay in s, positive for a simulator ahead of the record.
    clock : Factor of the simulator's time.
    errors : Held-out RMSE by set of terms, for channels scaled to a deviation of 1.
    """

    gain: tuple[float, ...] = ()
    offset: tuple[float, ...] = ()
    delay: float = 0.0
    clock: float = 1.0
    errors: dict[str, float] = field(default_factory=dict)

    def apply(
        self,
        y_sim: Array,
        samples: int,
        sampling_time: float,
        begin: float = 0.0,
        begin_sim: float = 0.0,
    ) -> Array:
        """Return the calibrated simulation, `(samples, ny)`.

        Raises ValueError if `y_sim` ends too early and neither delay nor clock are calibrated.

        Parameters
        ----------
        y_sim : `(time, ny)`. With a calibrated delay or clock, its values are held before the
            origin, and beyond its first and last samples.
        samples : Number of samples to return.
        sampling_time : Sampling time of simulation and result, in s.
        begin, begin_sim : Position of the first sample to return, and of the first sample of
            `y_sim`, in samples after the origin.
        """
        self.check(y_sim.shape[1])
        index = self.positions(samples, sampling_time, begin) - begin_sim
        rows = np.rint(index).astype(int)
        if self.stays and rows[-1] >= len(y_sim):
            raise InputError(f"y_sim must have {rows[-1] + 1} samples at least, got {len(y_sim)}")
        on_rows = self.stays and bool(np.abs(index - rows).max() < 1e-6)
        moved = y_sim[np.maximum(rows, 0)] if on_rows else spline_of(y_sim)(index)
        gain = np.array(self.gain or 1.0)
        return np.asarray(gain * moved + np.array(self.offset or 0.0), dtype=np.float64)

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        finite = np.isfinite([*self.gain, *self.offset, self.delay, self.clock]).all()
        if not (finite and self.clock > 0):
            raise InputError(f"a calibration must be finite, and its clock positive, got {self!r}")

    def check(self, ny: int) -> None:
        """Raise ValueError unless gain and offset have `ny` values, or none."""
        for name in ("gain", "offset"):
            if len(getattr(self, name)) not in (0, ny):
                raise InputError(f"{name} must have {ny} value(s), got {len(getattr(self, name))}")

    def positions(self, samples: int, sampling_time: float, begin: float = 0.0) -> Array:
        """Return the simulator times of `apply`, `(samples,)`, in samples from t = 0."""
        index = begin + np.arange(samples, dtype=np.float64)
        if self.stays:
            return index
        return np.maximum(self.clock * index - self.delay / sampling_time, 0.0)

    def end_warning(
        self, steps: int, sampling_time: float, begin: float, samples: int, end: float
    ) -> str:
        """Return a sentence for a simulation that ends too early, else an empty string.

        The last `steps` of the `samples` from `begin` on are the forecast; `end` is the position
        after the simulation's last sample. Positions are counted in samples after the origin.
        """
        missing = int(np.sum(self.positions(samples, sampling_time, begin) > end - 0.5))
        if not missing:
            return ""
        return (
            f"the simulator's output ends too early for its calibration ({self}): for the last "
            f"{missing} of {steps} samples its last value is held; a longer output would do better"
        )

    def __str__(self) -> str:
        """Return the calibrated terms, with units."""
        scales = ("gain", self.gain), ("offset", self.offset)
        texts = [(name, ", ".join(f"{x:.3g}" for x in values)) for name, values in scales]
        parts = [f"{name} {text}" for name, text in texts if text]
        parts += [f"delay {self.delay:.4g} s"] if self.delay else []
        parts += [f"clock {self.clock:.5g}"] if self.clock != 1 else []
        return "; ".join(parts) or "unmodified"

    @property
    def stays(self) -> bool:
        """Return whether the simulator's time is unchanged."""
        return self.delay == 0 and self.clock == 1


def samples_needed(samples: int, train: int) -> int:
    """Return the sufficient length in samples of a simulation for a fit of all terms."""
    return int(np.ceil(samples * (1 + MOST_CLOCK) + train * MOST_DELAY)) + 1


def spline_of(y: Array) -> Callable[[Array], Array]:
    """Return an interpolating function of the sample index; values at the ends are held."""
    spline = scipy.interpolate.CubicSpline(np.arange(len(y)), y)
    return lambda index: np.asarray(spline(np.clip(index, 0, len(y) - 1)))


def calibrate(
    y_sim: Array, y: Array, sampling_time: float, terms: Iterable[Term] | None = None
) -> Calibration:
    """Calibrate a simulator on the training part of a record.

    Parameters
    ----------
    y_sim : `(time, ny)`, aligned with the record, and at least as long. Later samples are used for
        a slow clock or a late output.
    y : The training part, `(train, ny)`, NaN in gaps.
    sampling_time : Sampling time of record and simulation, in s.
    terms : Terms to fit. By default sets of terms are fitted to the beginning of `y` and compared
        on the rest, for several cuts; a larger set must lower the held-out error.

    Raises
    ------
    ValueError
        For an unknown term, or too few samples.
    """
    measured = int((~np.isnan(y)).any(axis=1).sum())
    if len(y_sim) < len(y) or measured < 2 or y_sim.shape[1] != y.shape[1]:
        raise InputError(
            f"y_sim must cover the record's {len(y)} samples in y's channels, and y have 2 "
            f"samples at least, got {y_sim.shape} and {y.shape}, of which {measured} were measured"
        )
    scale = spread(y)  # equal weights of channels in any units
    y, y_sim = y / scale, y_sim / scale
    if terms is not None:
        chosen = tuple(terms)
        unknown = [term for term in chosen if term not in TERMS]
        if unknown:
            raise InputError(f"terms must be out of {', '.join(TERMS)}, got {', '.join(unknown)}")
        return _fit(y_sim, y, sampling_time, chosen, scale)
    errors = {subset: _held_out(y_sim, y, sampling_time, subset) for subset in _SETS}
    best = _SETS[0]
    for subset in _SETS[1:]:
        pays = errors[subset].mean() < _WORTH * errors[best].mean()
        # After one cut, a delay or clock may fit noise by chance, but hardly after all cuts.
        moves = set(subset) & set(_MOVING)
        if pays and (not moves or (errors[subset] < errors[best]).all()):
            best = subset
    calibration = _fit(y_sim, y, sampling_time, best, scale)
    means = {" + ".join(subset) or "none": float(left.mean()) for subset, left in errors.items()}
    return replace(calibration, errors=means)


def affine_fit(y_sim: Array, y: Array) -> tuple[Array, Array]:
    """Return gains and offsets by channel, both `(ny,)`, for the best fit of `y_sim` to `y`.

    Least squares on `(time, ny)` without NaN of y; a constant channel of the simulator has gain 0.
    """
    mean_sim, mean = _mean(y_sim, y), _mean(y, y)
    gain = _gain(y_sim - mean_sim, y - mean)
    return gain, mean - gain * mean_sim


def _mean(values: Array, y: Array) -> Array:
    """Return the means by channel where y is not NaN; 0 for a channel without measurements."""
    measured = ~np.isnan(y)
    means = np.where(measured, values, 0.0).sum(axis=0) / np.maximum(measured.sum(axis=0), 1)
    return np.asarray(means, dtype=np.float64)


def _gain(x: Array, y: Array) -> Array:
    """Return the least-squares gain from x to y where y is not NaN; 0 where x is zero."""
    power = np.where(np.isnan(y), 0.0, x**2).sum(axis=0)
    return np.asarray(np.nansum(x * y, axis=0) / np.where(power > 0, power, 1.0))


def _held_out(y_sim: Array, y: Array, sampling_time: float, terms: tuple[Term, ...]) -> Array:
    """Return the RMSE after several cuts, of fits to the samples before the cut."""
    errors, measured = [], ~np.isnan(y)
    rows = np.flatnonzero(measured.any(axis=1))
    for share in (0.5, 0.6, 0.7, 0.8):
        cut = rows[max(int(share * len(rows)), 1)]
        calibration = _fit(y_sim, y[:cut], sampling_time, terms)
        left = y[cut:] - calibration.apply(y_sim, len(y), sampling_time)[cut:]
        # Only channels with measurements both before and after the cut count.
        present = measured[:cut].any(axis=0) & measured[cut:].any(axis=0)
        if present.any():
            errors.append(rmse(left[:, present], np.zeros_like(left[:, present])))
    return np.array(errors or [0.0])


def _fit(
    y_sim: Array,
    y: Array,
    sampling_time: float,
    terms: tuple[Term, ...],
    scale: Array | float = 1.0,
) -> Calibration:
    """Fit by least squares over delay and clock; gain and offset are eliminated."""
    check()
    moving = np.array([term in terms for term in _MOVING])
    index: Array = np.arange(len(y), dtype=np.float64)
    spline = spline_of(y_sim)

    def fitted(warp: Array) -> tuple[Array, Array, Array, Flags]:
        """Return gain, offset, the simulation, and a mask of the simulated samples."""
        delay, clock = _warp(warp, moving)
        positions = clock * index - delay
        inside = (positions >= 0) & (positions <= len(y_sim) - 1)
        inside = inside if inside.any() else ~inside
        x = spline(positions) if moving.any() else y_sim[: len(y)]
        return *_affine(x[inside], y[inside], terms), x, inside

    def residual(warp: Array) -> Array:
        gain, offset, x, inside = fitted(warp)
        error = (gain * x + offset - y) * inside[:, None] / np.sqrt(inside.mean())
        return np.nan_to_num(error).ravel()

    warp = np.empty(0)
    if moving.any():
        most = np.array([MOST_DELAY * len(y), MOST_CLOCK])
        low, high = (_STILL - most)[moving], (_STILL + most)[moving]
        guesses = _guesses(y, lambda clock: spline(clock * index), most * moving)
        begins = (np.clip(guess[moving], low, high) for guess in guesses)
        how: Any = {"bounds": (low, high), "x_scale": (high - low) / 100}
        minima = [scipy.optimize.least_squares(residual, begin, **how) for begin in begins]
        warp = np.asarray(min(minima, key=lambda result: result.cost).x)
    gain, offset, *_ = fitted(warp)
    delay, clock = _warp(warp, moving)
    return Calibration(
        tuple(map(float, gain)) if "gain" in terms else (),
        tuple(map(float, offset * scale)) if "offset" in terms else (),
        delay * sampling_time,
        clock,
    )


def _affine(x: Array, y: Array, terms: Sequence[Term]) -> tuple[Array, Array]:
    if "gain" in terms and "offset" in terms:
        return affine_fit(x, y)
    gain = _gain(x, y) if "gain" in terms else np.ones(y.shape[1])
    return gain, _mean(y - x, y) if "offset" in terms else np.zeros(y.shape[1])


def _warp(warp: Array, moving: Flags) -> tuple[float, float]:
    """Return the delay in samples, and the clock factor."""
    values = _STILL.copy()
    values[moving] = warp
    return float(values[0]), float(values[1])


def _guesses(y: Array, at_clock: Callable[[float], Array], most: Array) -> Iterator[Array]:
    """Yield delay and clock: none, and the pairs within `most` of the highest correlations."""
    yield _STILL
    clocks = np.linspace(1 - most[1], 1 + most[1], 41) if most[1] else np.ones(1)
    shifts = np.arange(-int(most[0]), int(most[0]) + 1)  # in samples of the record
    centred = np.nan_to_num(y - _mean(y, y))
    ranked = []
    for clock in clocks:
        x = at_clock(clock)
        x = x - x.mean(axis=0)
        power = (x**2).sum(axis=0)
        correlation = scipy.signal.fftconvolve(centred, x[::-1], axes=0)
        # Squares of the correlation, as a gain may be negative.
        squared = (correlation**2 / np.where(power > 0, power, 1.0)).sum(axis=1)
        at_shifts = squared[shifts + len(y) - 1]
        best = int(np.argmax(at_shifts))
        ranked.append((at_shifts[best], np.array([clock * shifts[best], clock])))
    ranked.sort(key=lambda pair: -pair[0])
    for _, point in ranked[:3]:
        yield point
