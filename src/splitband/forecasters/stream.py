"""Run a forecaster sample by sample, beside the plant."""

from __future__ import annotations

from typing import TYPE_CHECKING, final

import numpy as np
import numpy.typing as npt

from splitband.forecasters.prediction import OVERFLOWED, known_of, total
from splitband.forecasters.steps import State, Steps, tick
from splitband.records import Record, require_records
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster


@final
class Stream:
    """A running model: it observes measured samples, and predicts those that are not measured.

    `Forecaster.stream` returns one. A forecast equals that of `Forecaster.predict` after the
    samples observed so far, with two exceptions. The state of an equation (`GreyBox`) is estimated
    from the history alone. A linear model estimates its initial state anew for each `predict`, and
    here by a Kalman filter; the two agree once the initial state no longer matters.

    Parameters
    ----------
    name : Of the forecaster, for messages.
    steps : Its step form.
    state : The state after the history.
    ny, nu : Numbers of channels and inputs.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> stream = sb.Periodic().fit(record).stream()
    >>> stream.observe(np.sin(0.3 * 120))
    >>> what_if = stream.copy()
    >>> what_if.step().shape
    (1,)
    """

    def __init__(self, name: str, steps: Steps, state: State, ny: int, nu: int) -> None:
        self.name, self.steps, self.state = name, steps, state
        self.ny, self.nu = ny, nu
        self._overflowed = False

    def observe(
        self, y: npt.ArrayLike, u: npt.ArrayLike | None = None, y_sim: npt.ArrayLike | None = None
    ) -> None:
        """Take the next measured sample.

        Parameters
        ----------
        y : The measured sample, `(ny,)`, NaN for channels that were not measured; these keep the
            model's own prediction.
        u : Inputs of this sample, `(nu,)`, for a record with inputs.
        y_sim : Output of the simulator at this sample, for a model with one, `(ny,)`. A
            conditioned hybrid without inputs also needs that of the next sample, `(2, ny)`.
        """
        self._tick(self._signal("y", y, (self.ny,), gaps=True), u, y_sim)

    def step(self, u: npt.ArrayLike | None = None, y_sim: npt.ArrayLike | None = None) -> Array:
        """Predict the next sample, which was not measured, `(ny,)`.

        As in `Forecaster.predict`, 1e100 stands for what is larger, and for all that follows.

        Parameters
        ----------
        u, y_sim : See `observe`.

        Raises
        ------
        ValueError
            Where too few samples have been observed to start a forecast.
        """
        before = self.state
        predicted = self._tick(np.full(self.ny, np.nan), u, y_sim)
        if np.isnan(predicted).any() and not self._overflowed:
            self.state = before
            needed = self.steps.warmup or "one"
            raise InputError(
                f"{needed} measured sample(s) must have been observed before {self.name} can "
                "predict"
            )
        predicted = total([predicted])
        self._overflowed = bool((predicted == OVERFLOWED).any())
        return predicted

    def copy(self) -> Stream:
        """Return an independent stream with the same state, for what-if runs."""
        new = Stream(self.name, self.steps, self.state, self.ny, self.nu)
        new._overflowed = self._overflowed
        return new

    def __repr__(self) -> str:
        return f"Stream({self.name!r}, ny={self.ny}, nu={self.nu})"

    def _tick(self, y: Array, u: npt.ArrayLike | None, y_sim: npt.ArrayLike | None) -> Array:
        steps = self.steps
        inputs = self._signal("u", u, (self.nu,), self.nu > 0)
        simulated = self._signal("y_sim", y_sim, (1 + steps.ahead, self.ny), steps.simulated)
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may overflow
            self.state, predicted = tick(steps, self.state, y, inputs, simulated)
        return predicted

    def _signal(
        self,
        name: str,
        value: npt.ArrayLike | None,
        shape: tuple[int, ...],
        needed: bool = True,
        gaps: bool = False,
    ) -> Array:
        """Return a signal at a sample, of this shape, or without channels if it is not needed."""
        if value is None and needed:
            raise InputError(f"{name} must be given at every sample for {self.name}, {shape}")
        if value is not None and not needed:
            raise InputError(f"{name} must be left out: {self.name} needs none")
        if value is None:
            return np.zeros((*shape[:-1], 0))
        signal = np.asarray(value, dtype=np.float64)
        if signal.size != np.prod(shape) or signal.ndim > len(shape):
            raise InputError(f"{name} must have the shape {shape}, got {signal.shape}")
        if (not gaps and not np.isfinite(signal).all()) or np.isinf(signal).any():
            raise InputError(f"{name} must be finite, got {signal.tolist()}")
        return signal.reshape(shape)


def stream_of(
    forecaster: Forecaster, history: Record | None = None, other_record: bool = False
) -> Stream:
    """Return the stream of a fitted forecaster; see `Forecaster.stream`."""
    if history is not None:
        require_records("history", history)
    record, steps = forecaster.require_fitted().record, forecaster.step_form()
    state = steps.begin(known_of(forecaster, 0, history, other_record))
    return Stream(forecaster.name, steps, state, record.ny, record.nu)
