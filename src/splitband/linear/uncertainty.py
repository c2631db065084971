"""Estimate the accuracy of a fitted linear model: standard errors, and poles without excitation.

The covariance of the parameters is that of least squares, N^-1 S N^-1, where N are the normal
equations and S is the sum of squares of their right-hand sides over parts of the records, valid for
correlated noise, too (P. J. Huber, 1967; W. K. Newey and K. D. West, 1987).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from splitband.linear.refinement import Signals, Solution, by_segment, segments, total
from splitband.runtime.arrays import Array

NORMAL = 1.96
"""Half width of a 95 % interval of a normal distribution, in standard errors. Convention."""
FREQUENCIES = 100
"""Number of frequencies of the response's confidence band. Layout."""
_PARTS = 40
"""Parts of the records with separate right-hand sides. Bounds the time."""
_FREE = 1e-9
"""Smallest direction of the parameters with effect, as a share of the largest. Rounding."""
_STEP = 1e-4
"""Step of the numerical derivatives, in standard errors of a parameter. Rounding."""
_MOST = 250
"""Largest number of parameters with standard errors: bounds the time."""
_SILENT = 1e-5
"""Least power density of an input that excites a pole, as a share of its mean. Rounding."""

Complex = npt.NDArray[np.complex128]
Matrices = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, eq=False, repr=False)
class Uncertainty:
    """Estimates and their standard errors; missing errors are NaN.

    Attributes
    ----------
    parts, pole_errors : Real and imaginary parts of the poles in the z plane, `(n, 2)`; errors of
        these two and of the absolute value, `(n, 3)`.
    gains, gain_errors : Static gains, `(ny, nu)`; infinite for an integrator.
    angles : Frequencies in radians per sample, `(frequencies,)`.
    response, response_errors : Absolute value of the response at `angles`, `(frequencies, ny, nu)`,
        and its error.
    delay_errors : Errors of the delays by output and input in samples, `(ny, nu)`; 0 without an
        estimate.
    """

    parts: Array
    pole_errors: Array
    gains: Array
    gain_errors: Array
    angles: Array
    response: Array
    response_errors: Array
    delay_errors: Array

    def __repr__(self) -> str:
        """Return poles and static gains, with half of their 95 % intervals."""
        sizes = zip(self.poles, NORMAL * self.pole_errors[:, 2], strict=True)
        lines = [f"pole {pole:.4g}, its absolute value ± {error:.2g}" for pole, error in sizes]
        stable = abs(self.poles).max(initial=0.0) <= 1
        for (i, j), gain in np.ndenumerate(self.gains) if stable else ():
            error = NORMAL * self.gain_errors[i, j]
            lines.append(f"static gain of output {i} for input {j}: {gain:.4g} ± {error:.2g}")
        return "\n".join(lines)

    @property
    def poles(self) -> Complex:
        """Return the poles, `(n,)`."""
        return np.asarray(self.parts[:, 0] + 1j * self.parts[:, 1], np.complex128)

    def time_constants(self, sampling_time: float) -> tuple[Array, Array]:
        """Return the time constants of the poles in seconds and their errors, both `(n,)`."""
        size = abs(self.poles)
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = -np.log(size)
            return sampling_time / rate, sampling_time * self.pole_errors[:, 2] / (size * rate**2)

    @np.errstate(all="ignore")
    def in_units(self, outputs: Array, inputs: Array) -> Uncertainty:
        """Return the uncertainty in the record's units, given the signals' standard deviations."""
        factor = outputs[:, None] / inputs
        return replace(
            self,
            gains=self.gains * factor,
            gain_errors=self.gain_errors * factor,
            response=self.response * factor,
            response_errors=self.response_errors * factor,
        )

    @classmethod
    def of_parts(cls, parts: Sequence[Uncertainty], back: npt.NDArray[np.int_]) -> Uncertainty:
        """Return the uncertainty of several models of some outputs, in the order `back`."""

        def joined(name: str, axis: int = 0) -> Array:
            return np.concatenate([vars(part)[name] for part in parts], axis=axis)

        return cls(
            joined("parts"),
            joined("pole_errors"),
            joined("gains")[back],
            joined("gain_errors")[back],
            parts[0].angles,
            joined("response", 1)[:, back],
            joined("response_errors", 1)[:, back],
            joined("delay_errors")[back],
        )


def covariance_root(solution: Solution, runs: Sequence[Signals]) -> Array:
    """Return a root R of the covariance R R' of the free values, `(free, parts)`."""
    cuts = segments(runs, _PARTS)
    parts = by_segment(solution, runs, solution.blocks.free, cuts)
    whole = total(parts)
    n, through = whole.n.copy(), dict[int, Array]()
    for i, (cross, square, _) in whole.states.items():
        ridge = 1e-10 * np.diag(square).max(initial=0.0) + 1e-300
        through[i] = np.linalg.solve(square + ridge * np.eye(len(square)), cross).T
        n -= through[i] @ cross
    size = np.sqrt(np.maximum(np.diag(whole.n), 1e-300))
    power, axes = np.linalg.eigh(n / size / size[:, None])
    strong = power > _FREE * power[-1]
    inverse = (axes[:, strong] / power[strong]) @ axes[:, strong].T / size / size[:, None]
    slopes = [p.g - through[i] @ p.states[i][2] for p, (i, _, _) in zip(parts, cuts, strict=True)]
    count = len(slopes)
    root = inverse @ np.stack(slopes, axis=1)
    return np.asarray(root * np.sqrt(count / max(count - 1, 1)))


@np.errstate(all="ignore")
def uncertainty_of(
    solution: Solution,
    runs: Sequence[Signals],
    matrices: Callable[[Array | None], Matrices],
    longest: int,
) -> Uncertainty:
    """Return the uncertainty of a model in normalised units.

    `matrices` returns A, B, C and D after a step of the values of `solution`. `longest` is the
    length of the longest record, its first samples before delayed inputs included.
    """
    a, b, c, d = matrices(None)
    order = np.argsort(-abs(np.linalg.eigvals(a)))
    poles = np.linalg.eigvals(a)[order].astype(np.complex128)
    angles = np.geomspace(np.pi / longest, np.pi, FREQUENCIES)

    def found(step: Array | None) -> Array:
        """Return poles, gains and responses in one vector of real numbers."""
        one, two, three, four = matrices(step)
        eigenvalues = np.linalg.eigvals(one)
        # Match poles to the nearest ones of the fitted model.
        _, place = scipy.optimize.linear_sum_assignment(abs(poles[:, None] - eigenvalues[None]))
        eigenvalues = eigenvalues[place]
        response = _response(one, two, three, four, angles)
        gains = _response(one, two, three, four, np.zeros(1))[0].real
        return np.concatenate(
            [
                eigenvalues.real,
                eigenvalues.imag,
                np.abs(eigenvalues),
                gains.ravel(),
                np.abs(response).ravel(),
            ]
        )

    base = found(None)
    spread = np.full(len(base), np.nan)
    free = solution.blocks.free
    if free.sum() <= _MOST:
        root = covariance_root(solution, runs)
        change = np.zeros((len(base), root.shape[1]))
        for j, direction in enumerate(root.T):
            step = np.zeros(len(free))
            step[free] = _STEP * direction
            change[:, j] = (found(step) - found(-step)) / (2 * _STEP)
        spread = np.sqrt((change**2).sum(axis=1))
    n, gains = len(poles), c.shape[0] * b.shape[1]
    shape = c.shape[0], b.shape[1]
    value = base[3 * n : 3 * n + gains].reshape(shape)
    near = abs(poles - 1).min(initial=np.inf) < 1e-12
    # An infinite gain has the sign of the response at a real z just above 1.
    above = _response(a, b, c, d, np.array([-1e-6j]))[0].real
    value = np.where(near | np.isinf(value), np.copysign(np.inf, above), value)
    return Uncertainty(
        np.stack([poles.real, poles.imag], axis=1),
        spread[: 3 * n].reshape(3, n).T,
        value,
        spread[3 * n : 3 * n + gains].reshape(shape),
        angles,
        np.abs(_response(a, b, c, d, angles)),
        spread[3 * n + gains :].reshape(-1, *shape),
        np.zeros(shape),
    )


def _response(a: Array, b: Array, c: Array, d: Array, angles: Array | Complex) -> Complex:
    """Return the frequency response `(frequencies, ny, nu)`."""
    z = np.exp(1j * angles)[:, None, None]
    with np.errstate(all="ignore"):
        try:
            inner = np.linalg.solve(
                z * np.eye(len(a)) - a, np.broadcast_to(b, (len(angles), *b.shape))
            )
        except np.linalg.LinAlgError:
            return np.full((len(angles), len(c), b.shape[1]), np.inf, np.complex128)
    return np.asarray(c @ inner + d, np.complex128)


def silent(poles: Complex, runs: Sequence[Signals]) -> list[float]:
    """Return the angles of poles without power of an input at their frequencies."""
    angles = []
    for pole in poles[poles.imag >= 0]:
        angle, excited = float(abs(np.angle(pole))), False
        for run in runs:
            time = run.u.shape[1]
            frequencies = 2 * np.pi * np.fft.rfftfreq(time)
            width = max(2 * abs(1 - abs(pole)), 6 * np.pi / time)
            near = abs(frequencies - angle) <= width
            power = abs(np.fft.rfft(run.u, axis=1)) ** 2
            mean = power.mean(axis=1)
            excited |= bool(
                (power[:, near].max(axis=1, initial=0) > _SILENT * mean)[mean > 0].any()
            )
        if not excited:
            angles.append(angle)
    return angles
