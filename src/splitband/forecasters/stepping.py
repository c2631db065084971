"""Run forecasters sample by sample, in NumPy: their recursions, and the stream of one.

A recursion takes one sample after the other. A sample that was not measured is NaN, and is
forecast. Measured and forecast samples may alternate at will; a forecast always equals that of
`Forecaster.predict` from the origin. Time and memory of a sample are constant. The code can be
traced for exported programs, see `runtime.tracing`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
import numpy.typing as npt

from splitband.data import Record, require_records
from splitband.data.preparation import Preparation, seconds
from splitband.data.signals import last_before
from splitband.forecasters.prediction import (
    ForecastContext,
    extrapolated,
    known_at_origin,
    median,
)
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import cond

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster
    from splitband.models.stepping import Stepped


State = dict[str, Any]
"""The state of a recursion, by name; it is never changed in place."""


class NotSteppedError(InputError):
    """Report that a forecaster cannot run sample by sample; the message gives the reason."""


@dataclass(frozen=True)
class Part:
    """Compute a value for each sample, alone or as the slow component of a hybrid.

    Each channel has a row: the value, and its derivatives by the parameters that are estimated from
    the history. The parameters are constant from the origin of a forecast on.

    Attributes
    ----------
    row : Takes the state, the inputs and a simulator's output at a sample, and `ahead`; returns the
        next state, and the rows of the sample and of `ahead` more, `(1 + ahead, ny, n)`.
    initial : Returns the state before the first sample of a history; None is for another record.
    correct : Takes the state after a sample, its rows and what was measured, `(ny,)`, NaN where
        nothing was; returns the updated state.
    settle : Returns the parameters estimated from the samples so far, `(ny, n - 1)`.
    after_training : Returns the state after the training record, to which a model is fitted.
    simulated_over : Returns a simulator's output over a history and `ahead` more samples,
        `(time, ny)`; None for a part that needs none.
    """

    row: Callable[[State, Array, Array, int], tuple[State, Array]]
    initial: Callable[[ForecastContext | None], State] = lambda known: {}
    correct: Callable[[State, Array, Array], State] = lambda state, row, y: state
    settle: Callable[[State], Array] = lambda state: np.zeros((1, 0))
    after_training: Callable[[State], State] = lambda state: state
    simulated_over: Callable[[ForecastContext, int], Array] | None = None


class Recursion(ABC):
    """Define the update of a forecaster's state with each sample.

    Attributes
    ----------
    ny, nu : Numbers of channels and inputs.
    ahead : Samples by which a simulator's output must be known in advance, 0 or 1.
    simulated : Whether it needs a simulator's output.
    warmup : Number of samples in a row that must be measured before a forecast.
    prepared : Preparation of the measured signals, which is undone on predictions.
    part : The slow component of a hybrid, or the model itself, whose state is `state["part"]`.
    """

    ny: int
    nu: int
    ahead = 0
    simulated = False
    warmup = 0
    prepared: Sequence[Preparation] = ()
    part: Part

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
        y_sim = np.zeros((rows + self.ahead, 0))
        if part.simulated_over is not None:
            y_sim = part.simulated_over(known, self.ahead)
        state = self.initial(known)
        for n in range(begin, rows):
            state = self.tick(state, known.y[n], u[n], y_sim[n : n + 1 + self.ahead])[0]
        return state | {"part": part.after_training(state["part"])} if known.own else state


def read(rows: Array, settled: Array) -> Array:
    """Return the values of rows with these parameters, `(time, ny)`."""
    if rows.shape[-1] == 1:
        return rows[..., 0]
    return rows[..., 0] + (rows[..., 1:] * settled).sum(axis=-1)


class Extrapolated(Recursion):
    """Run a part alone."""

    def __init__(self, part: Part, ny: int, nu: int) -> None:
        self.part, self.ny, self.nu = part, ny, nu
        self.simulated = part.simulated_over is not None

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
        ny = self.ny = len(model.y_mean)
        self.model, self.warmup, self.nu = model, warmup, len(model.u_mean)
        self.part = part or Part(lambda state, u, y_sim, ahead: (state, np.zeros((1, ny, 1))))
        self.kept = warmup if part else 0
        """Rows of the slow component that are kept for a warm-up."""
        self.line = DelayLine(tuple(delays))
        self.simulated = self.part.simulated_over is not None
        self.ahead = model.ahead if part else 0

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the state before any measurement."""
        part, y_sim = self.part.initial(known), np.zeros((1 + self.ahead, self.ny))
        _, rows = self.part.row(part, np.zeros(self.nu), y_sim, self.ahead)
        y, u = np.zeros((self.warmup, self.ny)), np.zeros((self.warmup, self.nu))
        window = np.zeros((self.warmup + 1 + self.ahead, self.ny))
        run, _ = self.model.begin(y, np.zeros((self.warmup + 1, self.nu)), window)
        return {
            "line": self.line.initial(),
            "part": part,
            "y": y,
            "u": u,
            "rows": np.zeros((self.kept, *rows.shape[1:])),
            "count": np.zeros(()),
            "running": np.zeros(()),
            "run": run,
            "settled": self.part.settle(part),
        }

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Start a free run, continue it, or wait until the warm-up is complete."""
        last = self.warmup - 1
        part, rows = self.part.row(state["part"], u, y_sim, self.ahead)
        line, late = self.line.tick(state["line"], u)
        inputs = np.concatenate([state["u"], late[None]])
        past = state["rows"] if self.kept else np.zeros((self.warmup, *rows.shape[1:]))
        window = np.concatenate([past, rows])
        missing, running = np.isnan(y).any(), state["running"] > 0
        count = np.where(missing, 0.0, np.minimum(state["count"] + 1, self.warmup))
        ready = running | (state["count"] >= self.warmup)
        runs = ready & (missing | (running & (count < self.warmup)))

        def begun() -> list[Any]:
            settled = self.part.settle(part)
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
            "part": self.part.correct(part, rows[0], y),
            "y": np.concatenate([state["y"][1:], y[None]]),
            "u": inputs[1:],
            "rows": window[1 : self.warmup + 1] if self.kept else state["rows"],
            "count": count,
            "running": np.where(runs, 1.0, 0.0),
            "run": run,
            "settled": settled,
        }
        return new, predicted, runs

    def first_row(self, known: ForecastContext) -> int:
        """Return the first sample that the warm-up and delayed inputs need."""
        if self.kept:
            return 0
        complete = np.asarray(~np.isnan(known.y).any(axis=1))
        start = last_before(complete, self.warmup, len(known.y))
        return max((start or 0) - self.warmup - max(self.line.delays, default=0), 0)


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
        shape = (1 + recursion.ahead, recursion.ny)
        inputs = self._signal("u", u, (recursion.nu,), recursion.nu > 0)
        simulated = self._signal("y_sim", y_sim, shape, recursion.simulated)
        self.state, predicted, ready = recursion.tick(self.state, y, inputs, simulated)
        return predicted, bool(ready)

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
    try:
        return _begun(forecaster, forecaster._stepped(), history, other_record)
    except NotSteppedError:
        return _begun(forecaster, Repredicted(forecaster), history, other_record)


def _begun(
    forecaster: Forecaster, recursion: Recursion, history: Record | None, other_record: bool
) -> Stream:
    recursion, past = _in_units(forecaster, recursion, history)
    known = known_at_origin(forecaster, past, other_record)
    return Stream(forecaster.name, recursion, recursion.followed(known))


def program_of(
    forecaster: Forecaster, history: Record | None = None
) -> tuple[Recursion, State | None]:
    """Return the recursion that `Forecaster.export` writes, and its state after a history.

    The state is None where it depends on past output of a simulator that is not available.
    """
    recursion, past = _in_units(forecaster, forecaster._stepped(outside=True), history)
    try:
        return recursion, recursion.followed(known_at_origin(forecaster, past))
    except ValueError:
        if not recursion.simulated or history is not None:
            raise
        return recursion, None


def _in_units(
    forecaster: Forecaster, recursion: Recursion, history: Record | None
) -> tuple[Recursion, Record | None]:
    """Return the recursion in a history's units, else in measured ones; the prepared history."""
    record = forecaster.require_fitted().record
    past = record if history is None else history.prepared_as(record)
    if past.prepared and (history is None or history.prepared != past.prepared):
        steps = [each.counted_from(seconds(past)[0]) for each in past.prepared]
        recursion = InUnits(recursion, steps, past.sampling_time)
    return recursion, None if history is None else past


class Repredicted(Recursion):
    """Predict each sample anew, which takes longer the longer the history is."""

    def __init__(self, forecaster: Forecaster) -> None:
        record = forecaster.require_fitted().record
        self.forecaster, self.simulated = forecaster, "simulator" in forecaster.needs
        self.ny, self.nu, self.warmup = record.ny, record.nu, forecaster.warmup

    def initial(self, known: ForecastContext | None = None) -> State:
        """Return the history."""
        assert known is not None
        none, samples = np.zeros((len(known.y), 0)), len(known.y)
        u, y_sim = (none if each is None else each[:samples] for each in (known.u, known.y_sim))
        return {"history": known, "y": known.y, "u": u, "y_sim": y_sim}

    def followed(self, known: ForecastContext) -> State:
        """Return the history, which is the whole state."""
        return self.initial(known)

    def tick(self, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Return the history with another sample, and its forecast if it was not measured."""
        rows = {"y": y[None], "u": u[None], "y_sim": y_sim}
        new = state | {name: np.concatenate([state[name], row]) for name, row in rows.items()}
        return new, self._predicted(new) if np.isnan(y).any() else y, True

    def _predicted(self, state: State) -> Array:
        """Return the last of these samples, predicted from the last measured one before it."""
        y, history = state["y"], state["history"]
        measured = np.flatnonzero(~np.isnan(y).all(axis=1))
        origin = int(measured[measured < len(y) - 1].max()) + 1
        known = replace(
            history,
            y=y[:origin],
            steps=len(y) - origin,
            u=state["u"] if self.nu else None,
            y_sim=state["y_sim"] if self.simulated else None,
            grid=history.grid and replace(history.grid, samples=origin),
            own=False,
        )
        return extrapolated(self.forecaster, known)[0][-1]


class InUnits(Recursion):
    """Run a recursion for prepared signals in measured units; times count from the history on."""

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
            rows = each.measured(rows, time[:1])
            inputs = each.inputs(inputs, time[:1]) if self.nu else inputs
            y_sim = each.outputs(y_sim, time) if self.simulated else y_sim
        inner, predicted, able = self.inner.tick(state["inner"], rows[0], inputs[0], y_sim)
        predicted = predicted[None]
        for each in reversed(self.prepared):
            predicted = each.restored(predicted, time[:1])
        return {"inner": inner, "samples": state["samples"] + 1}, predicted[0], able
