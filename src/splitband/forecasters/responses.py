"""Compute step responses of a forecaster: what it has learned about each input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.forecasters.base import Forecaster
from splitband.metrics import ExtrapolationWarning
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.threads import without_warnings

SHARE = 0.1
"""Size of the step, as a share of the input's range in training. By eye."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Hold the response of each output to a small step of each input around an operating point.

    Attributes
    ----------
    y : Change of the outputs for a unit step at index 0, `(steps, ny, nu)`.
    sampling_time : In seconds.
    columns, inputs : Names of outputs and inputs.
    at : The operating point, `(nu,)`.
    size : Sizes of the simulated steps, `(nu,)`.
    """

    y: Array
    sampling_time: float
    columns: tuple[str, ...]
    inputs: tuple[str, ...]
    at: Array
    size: Array

    @property
    def time(self) -> Array:
        """Return the times after the step in seconds, `(steps,)`."""
        return np.asarray(np.arange(len(self.y)) * self.sampling_time, dtype=np.float64)

    def frequency_response(self) -> tuple[Array, npt.NDArray[np.complex128]]:
        """Return frequencies above 0 in Hz, and the small-signal gain there, `(n, ny, nu)`.

        It is the Fourier transform of the impulse response, over the length of the step response.
        """
        impulse = np.diff(self.y, axis=0, prepend=np.zeros_like(self.y[:1]))
        frequencies = np.fft.rfftfreq(len(impulse), self.sampling_time)
        return np.asarray(frequencies[1:], np.float64), np.fft.rfft(impulse, axis=0)[1:]


def respond(
    forecaster: Forecaster, steps: int, at: npt.ArrayLike | None, size: npt.ArrayLike | None
) -> Responses:
    """Return the responses of a fitted forecaster; see `Forecaster.step_responses`."""
    fitted = forecaster.require_fitted()
    record, steps = fitted.record, whole("steps", steps)
    if fitted.u_summary is None:
        raise ValueError(f"{forecaster.name} must have inputs to respond to, it has none")
    if "simulator" in forecaster.needs:
        raise ValueError(
            f"{forecaster.name} cannot respond by itself: its simulator stays outside of it"
        )
    low, high, mean = fitted.u_summary
    held = mean if at is None else _each("at", at, record.nu)
    sizes = SHARE * (high - low) if size is None else _each("size", size, record.nu)
    if not sizes.all():
        raise ValueError(
            "size must not be 0: give one for an input that was constant in training, "
            f"got {sizes.tolist()}"
        )
    found = np.empty((steps, record.ny, record.nu))
    for i, of_input in enumerate(sizes):
        # Up and down: even-order nonlinearities cancel.
        ends = []
        for half in (0.5 * of_input, -0.5 * of_input):
            u = np.tile(held, (2 * steps, 1))
            u[steps:, i] += half
            with without_warnings(ExtrapolationWarning):
                ends.append(forecaster.predict(2 * steps, u=u).y[steps:])
        found[:, :, i] = (ends[0] - ends[1]) / of_input
    return Responses(found, record.sampling_time, record.columns, record.inputs, held, sizes)


def _each(what: str, value: npt.ArrayLike, nu: int) -> Array:
    """Return a number for each input."""
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape not in ((), (nu,)) or not np.isfinite(numbers).all():
        raise ValueError(f"{what} must be a finite number for each of {nu} inputs, got {value!r}")
    return np.broadcast_to(numbers, (nu,))
