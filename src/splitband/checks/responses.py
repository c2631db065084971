"""Simulate responses to small steps of the inputs, and derive frequency responses."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.forecasters.base import Forecaster, fitted_of
from splitband.forecasters.prediction import OVERFLOWED
from splitband.metrics import ExtrapolationWarning
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings

SHARE = 0.1
"""Size of the step, and distance of operating points from the ends, as a share of the input's range
in training. By eye."""
SETTLED = 0.02
"""Largest change of the slope in the last quarter of a settled step response, as a share of the
largest slope: the 2 % of the settling time, a convention."""
GROWN = 100.0
"""Growth of an error at which the responses of an unstable model end. By eye."""
INTEGRATES = 0.5
"""Least growth of the gain towards low frequencies, or of a step response, as a share of that of an
integrator. By eye."""
LONGEST = 16
"""Longest simulation for a frequency response, in multiples of `steps`. Bounds the time."""


@dataclass(frozen=True, eq=False)
class Responses:
    """The responses of the outputs to small steps of the inputs around an operating point.

    Attributes
    ----------
    y : Change of the outputs for a unit step at index 0, `(steps, ny, nu)`.
    sampling_time : In seconds.
    columns, inputs : Names of outputs and inputs.
    at : The operating point, `(nu,)`.
    size : Sizes of the simulated steps, `(nu,)`.
    whole : The response until settled, or to `LONGEST` times the samples of `y`.
    system : A, B, C and D of a linear model in state space, with an exact frequency response.
    share : Position of all inputs in their ranges in training; None for another operating point.
    remarks : Sentences on missing responses, see `respond_over_range`.
    """

    y: Array
    sampling_time: float
    columns: tuple[str, ...]
    inputs: tuple[str, ...]
    at: Array
    size: Array
    whole: Array
    system: tuple[Array, Array, Array, Array] | None = None
    share: float | None = None
    remarks: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """Return the position of the inputs in their ranges, in words."""
        return "the mean" if self.share is None else f"{self.share:.0%}".replace("%", " %")

    @property
    def settled(self) -> bool:
        """Return whether the frequency response is right at low frequencies, too."""
        return self.system is not None or _settled(self.whole)

    @property
    def gains(self) -> Array:
        """Return the static gains, `(ny, nu)`: inf of an integrator, NaN of what has not settled.

        The step response of an integrator ends in a straight line. One of known matrices has a
        gain that is ten times as large at a tenth of a low frequency; where the response is flat
        all the same, the integrator has no visible effect, and the gain is that of its end.
        """
        last, largest = self.whole[-1], abs(self.whole).max(axis=0)
        rise = abs(_impulse(self.whole)[-1]) * len(self.whole)
        if self.system is not None:
            near, nearer = (abs(_gain(self.system, np.exp(1j * w))) for w in (1e-5, 1e-6))
            at_zero = _gain(self.system, np.exp(1e-6j)).real
            in_the_end = np.where(rise > SETTLED * largest, np.inf, last)
            return np.where(nearer > 10 * INTEGRATES * near, in_the_end, at_zero)
        settled = np.where(rise > INTEGRATES * largest, np.inf, last)
        return settled if self.settled else np.full_like(last, np.nan)

    @property
    def time(self) -> Array:
        """Return the times after the step in seconds, `(steps,)`."""
        return np.asarray(np.arange(len(self.y)) * self.sampling_time, dtype=np.float64)

    @property
    def operating_point(self) -> str:
        """Return the operating point in words."""
        pairs = zip(self.inputs, self.at, strict=True)
        return ", ".join(f"{name} = {value:.4g}" for name, value in pairs)

    def frequency_response(self) -> tuple[Array, npt.NDArray[np.complex128]]:
        """Return frequencies above 0 in Hz, and the small-signal gain there, `(n, ny, nu)`.

        For `Linear` the gain is exact. For others it is the Fourier transform of the impulse
        response of `whole`, continued with its last value: near 0 for a settled step response, the
        slope for an integrator. It is wrong unless `settled`.
        """
        frequencies = np.fft.rfftfreq(len(self.y), self.sampling_time)[1:]
        z = np.exp(2j * np.pi * frequencies * self.sampling_time)[:, None, None]
        if self.system is not None:
            gain = _gain(self.system, z)
        else:
            impulse, every = _impulse(self.whole), len(self.whole) // len(self.y)
            gain = np.fft.rfft(impulse, axis=0)[every::every] + impulse[-1] * z / (z - 1)
        return np.asarray(frequencies, np.float64), np.asarray(gain, np.complex128)


def _gain(system: tuple[Array, Array, Array, Array], z: Any) -> npt.NDArray[np.complex128]:
    """Return the transfer function of state-space matrices at `z`."""
    a, b, c, d = system
    return np.asarray(c @ np.linalg.solve(z * np.eye(len(a)) - a, b + 0 * z) + d, np.complex128)


def _impulse(y: Array) -> Array:
    """Return the impulse response of a step response, `(steps, ny, nu)`."""
    return np.diff(y, axis=0, prepend=np.zeros_like(y[:1]))


def _settled(y: Array) -> bool:
    """Return whether the slopes of all step responses have come to their last values."""
    impulse = _impulse(y)
    left = abs(impulse[-(len(y) // 4 or 1) :] - impulse[-1]).max(axis=0)
    return bool((left <= SETTLED * abs(impulse).max(axis=0)).all())


def step_responses(
    forecaster: Forecaster,
    steps: int = 500,
    at: npt.ArrayLike | None = None,
    size: npt.ArrayLike | None = None,
    moving: bool = False,
) -> Responses:
    """Return the responses of a fitted forecaster's outputs to small steps of its inputs.

    Parameters
    ----------
    forecaster : A forecaster with inputs that needs no simulator's output from a record.
    steps : Samples of the response. Before the step, the outputs settle for as many samples, with
        constant inputs. Those of an unstable model end when an error has grown a hundredfold.
    at : The operating point, `(nu,)`; by default the means of the training inputs.
    size : Step sizes, `(nu,)`; by default a tenth of the inputs' ranges in training. One run
        steps up by half the size and one down; `y` is their difference, scaled to a step of 1.
    moving : Whether constant inputs in training are left out.

    Raises
    ------
    ValueError
        For a forecaster without inputs, and one that needs a simulator's output from a record.
    """
    fitted = fitted_of(forecaster)
    record, steps, growth = fitted.record, whole("steps", steps), fitted.report.growth
    if fitted.u_summary is None:
        raise InputError(f"{forecaster.name} must have inputs to respond to, it has none")
    if "simulator" in forecaster.needs:
        raise InputError(
            f"{forecaster.name} cannot respond by itself: its simulator stays outside of it"
        )
    low, high, mean = fitted.u_summary
    held = mean if at is None else _each("at", at, record.nu)
    sizes = SHARE * (high - low) if size is None else _each("size", size, record.nu)
    of = np.flatnonzero(sizes) if moving else np.arange(record.nu)
    if not (len(of) and sizes[of].all()):
        raise InputError(
            "size must not be 0: give one for an input that was constant in training, "
            f"got {sizes.tolist()}"
        )
    for beyond in fitted.inputs_beyond(held + 0.5 * np.stack([-abs(sizes), abs(sizes)])):
        name = record.inputs[beyond.channel]
        warnings.warn(
            f"input {name} is beyond its range in training ({beyond.low:g} to {beyond.high:g}) "
            f"in a step response, at {beyond.farthest:g}: the response is an extrapolation",
            ExtrapolationWarning,
            stacklevel=2,
        )

    def simulated(steps: int) -> Array:
        responses = np.empty((steps, record.ny, len(of)))
        for k, i in enumerate(of):
            # In the difference of steps up and down, even-order nonlinearities cancel.
            ends = []
            for half in (0.5 * sizes[i], -0.5 * sizes[i]):
                u = np.tile(held, (2 * steps, 1))
                u[steps:, i] += half
                with without_warnings(ExtrapolationWarning):
                    ends.append(forecaster.predict(2 * steps, u=u).y[steps:])
            up, down = (np.where(abs(y) < OVERFLOWED, y, np.nan) for y in ends)
            responses[:, :, k] = (up - down) / sizes[i]
        return responses

    few = steps if growth <= 1 else min(steps, max(int(np.log(GROWN) / np.log(growth)), 2))
    stable = of_stable_plant(forecaster)
    y = simulated(steps if stable else few)
    if few < len(y) and not np.isfinite(y).all():  # a network that is unstable after all
        y = simulated(few)
    settled, longer, system = y, y, forecaster.system_matrices()
    whole_run = system is None and stable and len(y) == steps
    while whole_run and not _settled(settled) and np.isfinite(longer).all():
        settled = longer
        if len(longer) >= LONGEST * steps:
            break
        longer = simulated(2 * len(longer))
    if system is not None:
        a, b, c, d = system
        system = a, b[:, of], c, d[:, of]
    inputs = tuple(record.inputs[i] for i in of)
    step, columns = record.sampling_time, record.columns
    return Responses(y, step, columns, inputs, held[of], sizes[of], settled, system)


def of_stable_plant(forecaster: Forecaster) -> bool:
    """Return whether responses settle, or integrate, as far as is known; see `FitReport.reach`."""
    return forecaster.require_fitted().report.reach is None


def respond_over_range(forecaster: Forecaster) -> list[Responses]:
    """Return the responses of a fitted forecaster at the means of its training inputs.

    Responses of a nonlinear one follow with all inputs at `SHARE` and at 1 - `SHARE` of their
    ranges in training. Forecasters without inputs, or with a simulator outside, have none. The
    `remarks` of the first response name other missing ones.
    """
    try:
        every = [step_responses(forecaster, moving=True)]
    except InputError:
        return []
    low, high, _ = forecaster.require_fitted().u_summary  # type: ignore[misc]  # it has inputs
    for share in () if forecaster.affine else (SHARE, 1 - SHARE):
        at = low + share * (high - low)
        every.append(replace(step_responses(forecaster, at=at, moving=True), share=share))
    finite = [responses for responses in every if np.isfinite(responses.y).all()]
    if not finite or not finite[0].y.any():
        return []
    names = forecaster.require_fitted().record.inputs
    still = [name for name in names if name not in every[0].inputs]
    remarks = (
        [f"In training {', '.join(still)} never moved: the effect is unknown."] if still else []
    )
    stable = of_stable_plant(forecaster)
    if not stable:
        remarks.append(
            "The model is unstable: its responses grow without bound, and have no static gain."
        )
    lost = [responses.place for responses in every if responses not in finite]
    remarks += [
        f"The response at {at} of the training inputs is not finite: left out." for at in lost
    ]
    unsettled = [responses for responses in finite if stable and not responses.settled]
    for moving in unsettled[:1]:
        after = len(moving.whole) * moving.sampling_time
        remarks.append(
            f"The response has not settled after {after:.4g} s: gain and phase at low frequencies "
            "are uncertain."
        )
    return [replace(finite[0], remarks=tuple(remarks)), *finite[1:]]


def _each(what: str, value: npt.ArrayLike, nu: int) -> Array:
    """Return the numbers by input; raises ValueError, naming the argument."""
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape not in ((), (nu,)) or not np.isfinite(numbers).all():
        raise InputError(f"{what} must be a finite number for each of {nu} inputs, got {value!r}")
    return np.broadcast_to(numbers, (nu,))
