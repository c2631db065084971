"""Run forecasters sample by sample, in NumPy: their recursions, and the stream of one.

A recursion takes one sample after the other. A sample that was not measured is NaN, and is
forecast. Measured and forecast samples may alternate at will; a forecast always equals that of
`Forecaster.predict` from the origin. Time and memory of a sample are constant. The code can be
traced for exported programs, see `runtime.tracing`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
import numpy.typing as npt

from splitband.data import Record, require_records
from splitband.data.preparation import Preparation, seconds
from splitband.data.signals import last_before
from splitband.forecasters.prediction import (
    ForecastContext,
    known_at_origin,
    known_of,
    median,
    predicted,
)
from splitband.metrics import ExtrapolationWarning
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings
from splitband.runtime.tracing import cond

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster
    from splitband.models.stepping import Stepped


State = dict[str, Any]
"""The state of a recursion, by name; it is never changed in place."""


class NotSteppedError(InputError):
    """Report that a forecaster cannot run sample by sample; the message gives the reason."""


class Recursion(ABC):
    """Define the update of a forecaster's state with each sample.

    Attributes
    ----------
    ny, nu : Numbers of channels and inputs.
    ahead : Samples by which a simulator's output must be known in advance, 0 or 1.
    simulated : Whether it needs a simulator's output.
    warmup : Number of samples in a row that must be measured before a forecast.
    prepared : Preparation of the measured signals, which is undone on predictions.
    part : The slow component of a hybrid, or the model itself, whose state is `state["part"]`; None
        without.
    """

    ny: int
    nu: int
    ahead = 0
    simulated = False
    warmup = 0
    prepared: Sequence[Preparation] = ()
    part: Part | None = None

    @abstractmethod
    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the state before the first sample of a history; None is for another record."""

    @abstractmethod
    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Return the state after a sample, its prediction, and whether there is a prediction.

        Parameters
        ----------
        state : After the previous sample.
        y : The measured sample, `(ny,)`, NaN for channels that were not measured.
        u : Inputs of the sample, `(nu,)`.
        y_sim : A simulator's output at the sample and at `ahead` more, `(1 + ahead, ny)`.
        """

    def first_row(self, known: ForecastContext) -> int:
        """Return the first sample of a history on which the forecast depends."""
        return 0

    def followed(self, known: ForecastContext) -> State:
        """Return the state after a history, from which a forecast starts."""
        begin, rows, part = self.first_row(known), len(known.y), self.part
        u = np.zeros((rows, 0)) if known.u is None else known.u
        y_sim = None if part is None else part.simulated_over(known, self.ahead)
        y_sim = np.zeros((rows + self.ahead, 0)) if y_sim is None else y_sim
        state = self.initial(known)
        for n in range(begin, rows):
            state = self.tick(state, known.y[n], u[n], y_sim[n : n + 1 + self.ahead])[0]
        if part is not None and known.own:
            state = state | {"part": part.after_training(state["part"])}
        return state


class Part(ABC):
    """Compute a value for each sample, alone or as the slow component of a hybrid.

    Each channel has a row: the value, and its derivatives by the parameters that are estimated from
    the history. The parameters are constant from the origin of a forecast on.
    """

    simulated = False

    @abstractmethod
    def initial(self, known: ForecastContext | None) -> State:
        """Return the state before the first sample of a history; None is for another record."""

    @abstractmethod
    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the next state and the rows of a sample and `ahead` more, `(1 + ahead, ny, n)`."""

    def correct(self, state: State, row: Array, y: Array) -> State:
        """Return the state updated with a sample, `(ny,)`, NaN where it was not measured."""
        return state

    def settle(self, state: State) -> Array:
        """Return the parameters estimated from the samples so far, `(ny, n - 1)`."""
        return np.zeros((1, 0))

    def simulated_over(self, known: ForecastContext, ahead: int) -> Array | None:
        """Return the simulator's output over a history and `ahead` more samples, `(time, ny)`."""
        return None

    def after_training(self, state: State) -> State:
        """Return the state after the training record, from which no parameters are estimated."""
        return state


def read(rows: Array, settled: Array) -> Array:
    """Return the values of rows with these parameters, `(time, ny)`."""
    if rows.shape[-1] == 1:
        return rows[..., 0]
    return rows[..., 0] + (rows[..., 1:] * settled).sum(axis=-1)


class Extrapolated(Recursion):
    """Run a part alone."""

    part: Part

    def __init__(self, part: Part, ny: int, nu: int) -> None:
        self.part, self.ny, self.nu, self.simulated = part, ny, nu, part.simulated

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the state of the part, and its parameters before the first sample."""
        part = self.part.initial(known)
        return {"part": part, "settled": self.part.settle(part), "stale": np.ones(())}

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Evaluate the part at a sample, and estimate its parameters where a forecast begins."""
        part, rows = self.part.row(state["part"], u, y_sim, 0)
        missing = np.isnan(y)
        settled = cond(
            missing.any() & (state["stale"] > 0),
            lambda: self.part.settle(state["part"]),
            lambda: state["settled"],
        )
        predicted = read(rows, settled)[0]
        stale = np.where(missing.all(), np.where(missing.any(), 0.0, state["stale"]), 1.0)
        new = {"part": self.part.correct(part, rows[0], y), "settled": settled, "stale": stale}
        return new, predicted, np.logical_not(np.isnan(predicted).any())


@dataclass(frozen=True)
class DelayLine:
    """Delay each input by its number of samples; before the first sample its value is held."""

    delays: tuple[int, ...]

    def initial(self) -> State:
        """Return the line before the first sample."""
        if not any(self.delays):
            return {}
        return {"past": np.zeros((max(self.delays), len(self.delays))), "filled": np.zeros(())}

    def tick(self, state: State, u: Array) -> tuple[State, Array]:
        """Return the next line, and the delayed inputs."""
        if not state:
            return state, u
        past = np.where(state["filled"] > 0, state["past"], u[None])
        all_of_them = np.concatenate([past, u[None]])
        last = len(all_of_them) - 1
        late = np.stack([all_of_them[last - d, i] for i, d in enumerate(self.delays)])
        return {"past": all_of_them[1:], "filled": np.ones(())}, late


class Warmed(Recursion):
    """Run a trained model after a warm-up on the last measured samples, with a slow part or none.

    It keeps the last `warmup` samples. A free run starts from them when a sample is not measured,
    and ends when as many samples in a row have been measured again.
    """

    def __init__(
        self, model: Stepped, part: Part | None, warmup: int, delays: Sequence[int]
    ) -> None:
        self.model, self.part, self.warmup = model, part, warmup
        self.ny, self.nu = len(model.y_mean), len(model.u_mean)
        self.line = DelayLine(tuple(delays))
        self.simulated = part is not None and part.simulated
        self.ahead = model.ahead if part is not None else 0

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the state before any measurement."""
        part = {} if self.part is None else self.part.initial(known)
        y_sim = np.zeros((1 + self.ahead, self.ny))
        _, rows = self._row(part, np.zeros(self.nu), y_sim)
        y, u = np.zeros((self.warmup, self.ny)), np.zeros((self.warmup, self.nu))
        window = np.zeros((self.warmup + 1 + self.ahead, self.ny))
        run, _ = self.model.begin(y, np.zeros((self.warmup + 1, self.nu)), window)
        return {
            "line": self.line.initial(),
            "part": part,
            "y": y,
            "u": u,
            "rows": np.zeros((self.warmup if self.part else 0, *rows.shape[1:])),
            "count": np.zeros(()),
            "running": np.zeros(()),
            "run": run,
            "settled": np.zeros((1, 0)) if self.part is None else self.part.settle(part),
        }

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Start a free run, continue it, or wait until the warm-up is complete."""
        last = self.warmup - 1
        part, rows = self._row(state["part"], u, y_sim)
        line, late = self.line.tick(state["line"], u)
        inputs = np.concatenate([state["u"], late[None]])
        past = state["rows"] if self.part else np.zeros((self.warmup, *rows.shape[1:]))
        window = np.concatenate([past, rows])
        missing, running = np.isnan(y).any(), state["running"] > 0
        count = np.where(missing, 0.0, np.minimum(state["count"] + 1, self.warmup))
        ready = running | (state["count"] >= self.warmup)
        runs = ready & (missing | (running & (count < self.warmup)))

        def begun() -> list[Any]:
            settled = state["settled"] if self.part is None else self.part.settle(part)
            run, first = self.model.begin(state["y"], inputs, read(window, settled))
            return [run, settled, first]

        def moved() -> list[Any]:
            slow = read(window[last:], state["settled"])
            run, following = self.model.advance(state["run"], inputs[last:], slow)
            return [run, state["settled"], following]

        run, settled, predicted = cond(
            runs,
            lambda: cond(running, moved, begun),
            lambda: [state["run"], state["settled"], np.full(self.ny, np.nan)],
        )
        new = {
            "line": line,
            "part": part if self.part is None else self.part.correct(part, rows[0], y),
            "y": np.concatenate([state["y"][1:], y[None]]),
            "u": inputs[1:],
            "rows": window[1 : self.warmup + 1] if self.part else state["rows"],
            "count": count,
            "running": np.where(runs, 1.0, 0.0),
            "run": run,
            "settled": settled,
        }
        return new, predicted, runs

    def first_row(self, known: ForecastContext) -> int:
        """Return the first sample that the warm-up and delayed inputs need."""
        if self.part is not None:
            return 0
        complete = np.asarray(~np.isnan(known.y).any(axis=1))
        start = last_before(complete, self.warmup, len(known.y))
        return max((start or 0) - self.warmup - max(self.line.delays, default=0), 0)

    def _row(self, part: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        if self.part is None:
            return part, np.zeros((1, self.ny, 1))
        return self.part.row(part, u, y_sim, self.ahead)


class Medians(Recursion):
    """Predict the median of several recursions."""

    def __init__(self, members: Sequence[Recursion]) -> None:
        self.members = [*members]
        first = members[0]
        self.ny, self.nu, self.simulated = first.ny, first.nu, first.simulated
        self.ahead = max(member.ahead for member in members)
        self.warmup = max(member.warmup for member in members)

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the states of the members."""
        return {"members": [member.initial(known) for member in self.members]}

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Return the median prediction of the members, once all of them have one."""
        ticks = [
            member.tick(own, y, u, y_sim[: 1 + member.ahead])
            for member, own in zip(self.members, state["members"], strict=True)
        ]
        ready = ticks[0][2]
        for _, _, able in ticks[1:]:
            ready = ready & able
        predicted = median([each for _, each, _ in ticks], np.minimum, np.maximum)
        return {"members": [new for new, _, _ in ticks]}, predicted, ready

    def followed(self, known: ForecastContext) -> State:
        """Return the states of the members after the history."""
        return {"members": [member.followed(known) for member in self.members]}


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
            raise InputError(
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
            raise InputError(f"y_sim must be left out: {self.name} needs no simulator's output")
        simulated = self._given("y_sim", y_sim, recursion.simulated, shape)
        self.state, predicted, ready = recursion.tick(self.state, y, inputs, simulated)
        return predicted, bool(ready)

    def _given(
        self, name: str, value: npt.ArrayLike | None, needed: bool, shape: tuple[int, ...]
    ) -> Array:
        if not needed:
            if value is not None:
                raise InputError(f"{name} must be left out: {self.name} has no inputs")
            return np.zeros((*shape[:-1], 0))
        if value is None:
            raise InputError(f"{name} must be given at every sample for {self.name}, {shape}")
        return self._signal(name, value, shape)

    def _signal(
        self, name: str, value: npt.ArrayLike, shape: tuple[int, ...], gaps: bool = False
    ) -> Array:
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
    try:
        return _begun(forecaster, forecaster._stepped(), history, other_record)
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
    recursion = forecaster._stepped(outside=True)
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

    `begin`: where the history begins, see `ForecastContext`.
    """

    def __init__(self, forecaster: Forecaster, history: Record, begin: float | None) -> None:
        self.forecaster, self.history, self.begin = forecaster, history, begin
        self.simulated = "simulator" in forecaster.needs
        self.ny, self.nu, self.warmup = history.ny, history.nu, forecaster.warmup

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the history."""
        past = self.history
        return {
            "y": past.y_with_gaps,
            "u": np.zeros((len(past), 0)) if past.u is None else past.u,
            "y_sim": past.y_sim if self.simulated else np.zeros((len(past), 0)),
        }

    def followed(self, known: ForecastContext) -> State:
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

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the state of the inner recursion, and the number of samples so far."""
        return {"inner": self.inner.initial(known), "samples": np.zeros(())}

    def followed(self, known: ForecastContext) -> State:
        """Return the state after a prepared history."""
        return {"inner": self.inner.followed(known), "samples": np.array(float(len(known.y)))}

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Prepare the signals of a sample, and undo the preparation on the prediction."""
        time = self.step * np.stack([state["samples"] + i for i in range(1 + self.ahead)])
        rows, inputs = y[None], u[None]
        for each in self.prepared:
            rows = each.done("y", rows, time[:1])
            inputs = each.done("u", inputs, time[:1]) if self.nu else inputs
            y_sim = each.done("y_sim", y_sim, time) if self.simulated else y_sim
        inner, predicted, able = self.inner.tick(state["inner"], rows[0], inputs[0], y_sim)
        predicted = predicted[None]
        for each in reversed(self.prepared):
            predicted = each.undone("y", predicted, time[:1])
        return {"inner": inner, "samples": state["samples"] + 1}, predicted[0], able
