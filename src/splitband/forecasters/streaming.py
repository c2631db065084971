"""Run a forecaster sample by sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
import numpy.typing as npt

from splitband.data import Record, require_records
from splitband.data.preparation import Preparation, seconds
from splitband.forecasters.known import Known
from splitband.forecasters.predicting import known_at_origin, known_of, predicted
from splitband.forecasters.stepping import NotSteppedError, Recursion, State
from splitband.metrics import ExtrapolationWarning
from splitband.runtime.arrays import Array
from splitband.runtime.threads import without_warnings

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster


@final
class Stream:
    """Observe measured samples, and predict samples that are not measured.

    `Forecaster.stream` returns one. At any sample, the forecast equals that of `Forecaster.predict`
    from the samples observed so far. Predicted samples count as not measured. Only the last sample
    of a `predict` may differ, where a network knows the slow signal's slope: `predict` ends there.

    Parameters
    ----------
    name : Of the forecaster, for messages.
    recursion : The update of the state with each sample.
    state : The state after the history.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> stream = sb.Periodic().fit(record).stream()
    >>> stream.observe(np.sin(0.3 * 120))
    >>> what_if = stream.copy()
    >>> what_if.step().shape
    (1,)
    """

    def __init__(self, name: str, recursion: Recursion, state: State) -> None:
        self.name, self.recursion, self.state = name, recursion, state

    def observe(
        self, y: npt.ArrayLike, u: npt.ArrayLike | None = None, y_sim: npt.ArrayLike | None = None
    ) -> None:
        """Take the next measured sample.

        Parameters
        ----------
        y : The measured sample, `(ny,)`, NaN for channels that were not measured.
        u : Inputs of this sample, `(nu,)`, for a record with inputs.
        y_sim : Output of the simulator at this sample, for a model with one, `(ny,)`. A
            conditioned hybrid without inputs also needs that of the next sample, `(2, ny)`.
        """
        self._tick(self._signal("y", y, (self.recursion.ny,), gaps=True), u, y_sim)

    def step(self, u: npt.ArrayLike | None = None, y_sim: npt.ArrayLike | None = None) -> Array:
        """Predict the next sample, which was not measured, `(ny,)`.

        Parameters
        ----------
        u, y_sim : See `observe`.

        Raises
        ------
        ValueError
            Where too few samples in a row have been measured to start a forecast.
        """
        before = self.state
        predicted, ready = self._tick(np.full(self.recursion.ny, np.nan), u, y_sim)
        if not ready:
            self.state = before
            needed = self.recursion.warmup or "one"
            raise ValueError(
                f"{needed} measured sample(s) in a row must have been observed before {self.name} "
                "can predict"
            )
        return predicted

    def copy(self) -> Stream:
        """Return an independent stream with the same state, for what-if runs."""
        return Stream(self.name, self.recursion, self.state)

    def __repr__(self) -> str:
        return f"Stream({self.name!r}, ny={self.recursion.ny}, nu={self.recursion.nu})"

    def _tick(
        self, y: Array, u: npt.ArrayLike | None, y_sim: npt.ArrayLike | None
    ) -> tuple[Array, bool]:
        recursion = self.recursion
        inputs = self._given("u", u, recursion.nu > 0, (recursion.nu,))
        shape = (1 + recursion.ahead, recursion.ny)
        if not recursion.simulated and y_sim is not None:
            raise ValueError(f"y_sim must be left out: {self.name} needs no simulator's output")
        simulated = self._given("y_sim", y_sim, recursion.simulated, shape)
        self.state, predicted, ready = recursion.tick(self.state, y, inputs, simulated)
        return predicted, bool(ready)

    def _given(
        self, name: str, value: npt.ArrayLike | None, needed: bool, shape: tuple[int, ...]
    ) -> Array:
        if not needed:
            if value is not None:
                raise ValueError(f"{name} must be left out: {self.name} has no inputs")
            return np.zeros((*shape[:-1], 0))
        if value is None:
            raise ValueError(f"{name} must be given at every sample for {self.name}, {shape}")
        return self._signal(name, value, shape)

    def _signal(
        self, name: str, value: npt.ArrayLike, shape: tuple[int, ...], gaps: bool = False
    ) -> Array:
        signal = np.asarray(value, dtype=np.float64)
        if signal.size != np.prod(shape) or signal.ndim > len(shape):
            raise ValueError(f"{name} must have the shape {shape}, got {signal.shape}")
        if (not gaps and not np.isfinite(signal).all()) or np.isinf(signal).any():
            raise ValueError(f"{name} must be finite, got {signal.tolist()}")
        return signal.reshape(shape)


def stream_of(
    forecaster: Forecaster, history: Record | None = None, other_record: bool = False
) -> Stream:
    """Return the stream of a fitted forecaster; see `Forecaster.stream`."""
    if history is not None:
        require_records("history", history)
    try:
        return _begun(forecaster, forecaster.stepped(), history, other_record)
    except NotSteppedError:
        own = None if history is None else _prepared(forecaster, history)
        begin = known_at_origin(forecaster, own, other_record).begin
        asked = Repredicted(forecaster, _prepared(forecaster, history), begin)
        return _begun(forecaster, asked, history, other_record)


def program_of(
    forecaster: Forecaster, history: Record | None = None
) -> tuple[Recursion, State | None]:
    """Return the recursion that `Forecaster.export` writes, and its state after a history.

    The state is None where it depends on past output of a simulator that is not available.
    """
    recursion = forecaster.stepped(outside=True)
    try:
        stream = _begun(forecaster, recursion, history, False)
    except ValueError:
        if not recursion.simulated or history is not None:
            raise
        return _in_units(forecaster, recursion, history), None
    return stream.recursion, stream.state


def _prepared(forecaster: Forecaster, history: Record | None) -> Record:
    record = forecaster.require_fitted().record
    return record if history is None else history.prepared_as(record)


def _begun(
    forecaster: Forecaster, recursion: Recursion, history: Record | None, other_record: bool
) -> Stream:
    """Return a stream whose state is that after a history."""
    own = None if history is None else _prepared(forecaster, history)
    known = known_at_origin(forecaster, own, other_record)
    recursion = _in_units(forecaster, recursion, history)
    return Stream(forecaster.name, recursion, recursion.followed(known))


def _in_units(forecaster: Forecaster, recursion: Recursion, history: Record | None) -> Recursion:
    """Return the recursion in the units of a history; without one, in measured units."""
    past = _prepared(forecaster, history)
    prepared = past.prepared
    if not prepared or (history is not None and history.prepared == prepared):
        return recursion
    steps = [each.counted_from(seconds(past)[0]) for each in prepared]
    return InUnits(recursion, steps, past.sampling_time)


class Repredicted(Recursion):
    """Predict each sample anew, which takes longer the longer the history is.

    `begin`: where the history begins, see `Known`.
    """

    def __init__(self, forecaster: Forecaster, history: Record, begin: float | None) -> None:
        self.forecaster, self.history, self.begin = forecaster, history, begin
        self.simulated = "simulator" in forecaster.needs
        self.ny, self.nu, self.warmup = history.ny, history.nu, forecaster.warmup

    def initial(self, known: Known | None = None) -> State:
        """Return the history."""
        past = self.history
        return {
            "y": past.seen,
            "u": np.zeros((len(past), 0)) if past.u is None else past.u,
            "y_sim": past.y_sim if self.simulated else np.zeros((len(past), 0)),
        }

    def followed(self, known: Known) -> State:
        """Return the history, which is the whole state."""
        return self.initial(known)

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Return the history with another sample, and its forecast if it was not measured."""
        rows = {"y": y[None], "u": u[None], "y_sim": y_sim}
        new = {name: np.concatenate([state[name], row]) for name, row in rows.items()}
        if np.isnan(y).any():
            return new, self._predicted(new), True
        return new, y, True

    def _predicted(self, state: State) -> Array:
        """Return the last of these samples, predicted from the last measured one before it."""
        measured = np.flatnonzero(~np.isnan(state["y"]).all(axis=1))
        origin = int(measured[measured < len(state["y"]) - 1].max()) + 1
        past = self.history
        record = Record.with_gaps(
            state["y"][:origin],
            past.sampling_time,
            u=state["u"][:origin] if self.nu else None,
            y_sim=state["y_sim"][:origin] if self.simulated else None,
            columns=past.columns,
            inputs=past.inputs,
            start=past.start,
        )
        with without_warnings(ExtrapolationWarning):
            known, _ = known_of(
                self.forecaster,
                len(state["y"]) - origin,
                record,
                state["u"][origin:] if self.nu else None,
                state["y_sim"][origin:] if self.simulated else None,
                other_record=self.begin is None,
            )
            # Without time stamps the record cannot say where it begins.
            return predicted(self.forecaster, replace(known, begin=self.begin), record).y[-1]


class InUnits(Recursion):
    """Run a recursion for prepared signals in measured units.

    The times of the preparations count from the first sample of the history; `step` is in s.
    """

    def __init__(self, inner: Recursion, prepared: Sequence[Preparation], step: float) -> None:
        self.inner, self.prepared, self.step = inner, prepared, step
        self.ny, self.nu, self.ahead = inner.ny, inner.nu, inner.ahead
        self.simulated, self.warmup = inner.simulated, inner.warmup

    def initial(self, known: Known | None = None) -> State:
        """Return the state of the inner recursion, and the number of samples so far."""
        return {"inner": self.inner.initial(known), "samples": np.zeros(())}

    def followed(self, known: Known) -> State:
        """Return the state after a prepared history."""
        return {"inner": self.inner.followed(known), "samples": np.array(float(len(known.y)))}

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Prepare the signals of a sample, and undo the preparation on the prediction."""
        time = self.step * np.stack([state["samples"] + i for i in range(1 + self.ahead)])
        rows, inputs = y[None], u[None]
        for each in self.prepared:
            rows = each.measured(rows, time[:1])
            inputs = each.inputs(inputs, time[:1]) if self.nu else inputs
            y_sim = each.outputs(y_sim, time) if self.simulated else y_sim
        inner, predicted, able = self.inner.tick(state["inner"], rows[0], inputs[0], y_sim)
        predicted = predicted[None]
        for each in reversed(self.prepared):
            predicted = each.restored(predicted, time[:1])
        return {"inner": inner, "samples": state["samples"] + 1}, predicted[0], able
