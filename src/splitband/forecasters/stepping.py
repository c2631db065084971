"""Run forecasters sample by sample, in NumPy: their recursions, and the stream of one.

A recursion takes one sample after the other. A sample that was not measured is NaN, and is
forecast. Measured and forecast samples may alternate at will; a forecast always equals that of
`Forecaster.predict` from the origin. Time and memory of a sample are constant. The code can be
traced for exported programs, see `runtime.tracing`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, final

import numpy as np
import numpy.typing as npt

from splitband.data import Record, require_records
from splitband.data.signals import last_before
from splitband.forecasters.prediction import ForecastContext, extrapolated, known_of, median
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import cond

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster
    from splitband.models.stepping import Stepped


State = dict[str, Any]
"""The state of a recursion, by name; it is never changed in place."""
Tick = Callable[[State, Array, Array, Array], tuple[State, Array, Any]]


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
        nothing was; returns the updated state, the same for NaN alone.
    settle : Returns the parameters estimated from the samples so far, `(ny, n - 1)`.
    after_training : Returns the state after the training record, to which a model is fitted.
    simulated_over : Returns a simulator's output over a history and `ahead` more samples,
        `(time, ny)`; None for a part that needs none.
    merged : Takes the state and the estimated parameters; returns the state of a run in which
        nothing is measured any more, with the parameters put into it: its rows have no
        derivatives. None where parameters are kept beside it.
    """

    row: Callable[[State, Array, Array, int], tuple[State, Array]]
    initial: Callable[[ForecastContext | None], State] = lambda known: {}
    correct: Callable[[State, Array, Array], State] = lambda state, row, y: state
    settle: Callable[[State], Array] = lambda state: np.zeros((1, 0))
    after_training: Callable[[State], State] = lambda state: state
    simulated_over: Callable[[ForecastContext, int], Array] | None = None
    merged: Callable[[State, Array], State] | None = None


@dataclass(frozen=True)
class FreeRun:
    """Define the run of a forecaster in which nothing is measured, for planning.

    Attributes
    ----------
    begin : Takes the state of a recursion after measured samples; returns that of the run, an
        ordinary state. Raises ValueError where too few have been measured.
    step : Takes the state of the run, the inputs of the next sample, `(nu,)`, and a simulator's
        output there, `(1, ny)`; returns the next state and the prediction, `(ny,)`. No value
        depends on whether another one is NaN: the step is as smooth as the model.
    """

    begin: Callable[[State], State]
    step: Callable[[State, Array, Array], tuple[State, Array]]


@dataclass(frozen=True)
class Recursion:
    """Define the update of a forecaster's state with each sample.

    Attributes
    ----------
    ny, nu : Numbers of channels and inputs.
    initial : Returns the state before the first sample of a history; None is for another record.
    tick : Takes the state after the previous sample and, of this one, what was measured, `(ny,)`,
        NaN where nothing was, the inputs, `(nu,)`, and a simulator's output there and at `ahead`
        more, `(1 + ahead, ny)`; returns the state, the prediction, and whether there is one.
    ahead : Samples by which a simulator's output must be known in advance, 0 or 1.
    simulated : Whether it needs a simulator's output.
    warmup : Number of samples in a row that must be measured before a forecast.
    repeats : Whether each sample is predicted anew, from all of the history.
    part : The slow component of a hybrid, or the model itself, whose state is `state["part"]`.
    first_row : Returns the first sample of a history on which the forecast depends.
    followed : Returns the state after a history; by default that of a tick for each sample.
    free_run : The run in which nothing is measured; None where each sample is predicted anew.
    """

    ny: int
    nu: int
    initial: Callable[[ForecastContext | None], State]
    tick: Tick
    ahead: int = 0
    simulated: bool = False
    warmup: int = 0
    repeats: bool = False
    part: Part | None = None
    first_row: Callable[[ForecastContext], int] = lambda known: 0
    followed: Callable[[ForecastContext], State] | None = None
    free_run: FreeRun | None = None

    def after(self, known: ForecastContext) -> State:
        """Return the state after a history, from which a forecast starts."""
        if self.followed is not None:
            return self.followed(known)
        assert self.part is not None
        rows = len(known.y)
        u = np.zeros((rows, 0)) if known.u is None else known.u
        y_sim = np.zeros((rows + self.ahead, 0))
        if self.part.simulated_over is not None:
            y_sim = self.part.simulated_over(known, self.ahead)
        state = self.initial(known)
        for n in range(self.first_row(known), rows):
            state = self.tick(state, known.y[n], u[n], y_sim[n : n + 1 + self.ahead])[0]
        return state | {"part": self.part.after_training(state["part"])} if known.own else state


def read(rows: Array, settled: Array) -> Array:
    """Return the values of rows with these parameters, `(time, ny)`."""
    if rows.shape[-1] == 1:
        return rows[..., 0]
    return rows[..., 0] + (rows[..., 1:] * settled).sum(axis=-1)


def recursion_of_part(part: Part, ny: int, nu: int) -> Recursion:
    """Return the recursion of a part alone."""

    def initial(known: ForecastContext | None) -> State:
        state = part.initial(known)
        return {"part": state, "settled": part.settle(state), "stale": np.ones(())}

    def tick(state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Evaluate the part at a sample, and estimate its parameters where a forecast begins."""
        new, rows = part.row(state["part"], u, y_sim, 0)
        missing = np.isnan(y)
        settled = cond(
            missing.any() & (state["stale"] > 0),
            lambda: part.settle(state["part"]),
            lambda: state["settled"],
        )
        predicted = read(rows, settled)[0]
        stale = np.where(missing.all(), np.where(missing.any(), 0.0, state["stale"]), 1.0)
        after = {"part": part.correct(new, rows[0], y), "settled": settled, "stale": stale}
        return after, predicted, np.logical_not(np.isnan(predicted).any())

    return Recursion(
        ny,
        nu,
        initial,
        tick,
        simulated=part.simulated_over is not None,
        part=part,
        free_run=_run_of_part(part),
    )


def _run_of_part(part: Part) -> FreeRun:
    """Return the free run of a part alone."""

    def begin(state: State) -> State:
        settled = part.settle(state["part"]) if state["stale"] > 0 else state["settled"]
        if np.isnan(settled).any():
            raise _too_few(1)
        now, kept = _merged(part, state["part"], settled)
        return {"part": now, "settled": kept}

    def step(state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        now, rows = part.row(state["part"], u, y_sim, 0)
        return {"part": now, "settled": state["settled"]}, read(rows, state["settled"])[0]

    return FreeRun(begin, step)


def _merged(part: Part, state: State, settled: Array) -> tuple[State, Array]:
    """Return a part's state in a free run, and the parameters that are kept beside it."""
    if part.merged is None:
        return state, settled
    return part.merged(state, settled), np.zeros((1, 0))


def _too_few(needed: int) -> InputError:
    return InputError(
        f"{needed} measured sample(s) in a row must have been observed before a free run"
    )


def delay_line(delays: Sequence[int]) -> tuple[State, Callable[[State, Array], Any]]:
    """Return the initial state of a line that delays each input by some samples, and its tick.

    The tick returns the next state and the delayed inputs; before the first sample they are held.
    """
    if not any(delays):
        return {}, lambda state, u: (state, u)

    def tick(state: State, u: Array) -> tuple[State, Array]:
        past = np.where(state["filled"] > 0, state["past"], u[None])
        rows = np.concatenate([past, u[None]])
        late = np.stack([rows[len(rows) - 1 - delay, i] for i, delay in enumerate(delays)])
        return {"past": rows[1:], "filled": np.ones(())}, late

    return {"past": np.zeros((max(delays), len(delays))), "filled": np.zeros(())}, tick


def recursion_of_network(
    model: Stepped, slow: Part | None, warmup: int, delays: Sequence[int]
) -> Recursion:
    """Return the recursion of a trained model, with a slow part or none.

    It keeps the last `warmup` samples. A free run starts from them when a sample is not measured,
    and ends when as many samples in a row have been measured again.
    """
    ny, nu, (line, delayed) = len(model.y_mean), len(model.u_mean), delay_line(delays)
    part = slow or Part(lambda state, u, y_sim, ahead: (state, np.zeros((1, ny, 1))))
    kept, ahead = (warmup, model.ahead) if slow else (0, 0)  # rows of the slow part
    last = warmup - 1

    def initial(known: ForecastContext | None) -> State:
        begun = part.initial(known)
        _, rows = part.row(begun, np.zeros(nu), np.zeros((1 + ahead, ny)), ahead)
        y, u = np.zeros((warmup, ny)), np.zeros((warmup, nu))
        run, _ = model.begin(y, np.zeros((warmup + 1, nu)), np.zeros((warmup + 1 + ahead, ny)))
        return {
            "line": line,
            "part": begun,
            "y": y,
            "u": u,
            "rows": np.zeros((kept, *rows.shape[1:])),
            "count": np.zeros(()),
            "running": np.zeros(()),
            "run": run,
            "settled": part.settle(begun),
        }

    def tick(state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        """Start a free run, continue it, or wait until the warm-up is complete."""
        now, rows = part.row(state["part"], u, y_sim, ahead)
        past_inputs, late = delayed(state["line"], u)
        inputs = np.concatenate([state["u"], late[None]])
        past = state["rows"] if kept else np.zeros((warmup, *rows.shape[1:]))
        window = np.concatenate([past, rows])
        missing, running = np.isnan(y).any(), state["running"] > 0
        count = np.where(missing, 0.0, np.minimum(state["count"] + 1, warmup))
        ready = running | (state["count"] >= warmup)
        runs = ready & (missing | (running & (count < warmup)))

        def begun() -> list[Any]:
            settled = part.settle(now)
            run, first = model.begin(state["y"], inputs, read(window, settled))
            return [run, settled, first]

        def moved() -> list[Any]:
            signal = read(window[last:], state["settled"])
            run, following = model.advance(state["run"], inputs[last:], signal)
            return [run, state["settled"], following]

        run, settled, predicted = cond(
            runs,
            lambda: cond(running, moved, begun),
            lambda: [state["run"], state["settled"], np.full(ny, np.nan)],
        )
        new = {
            "line": past_inputs,
            "part": part.correct(now, rows[0], y),
            "y": np.concatenate([state["y"][1:], y[None]]),
            "u": inputs[1:],
            "rows": window[1 : warmup + 1] if kept else state["rows"],
            "count": count,
            "running": np.where(runs, 1.0, 0.0),
            "run": run,
            "settled": settled,
        }
        return new, predicted, runs

    def first_row(known: ForecastContext) -> int:
        """Return the first sample that the warm-up and delayed inputs need."""
        complete = np.asarray(~np.isnan(known.y).any(axis=1))
        start = 0 if kept else last_before(complete, warmup, len(known.y)) or 0
        return max(start - warmup - max(delays, default=0), 0)

    simulated = part.simulated_over is not None
    free_run = _run_of_network(model, part, warmup, kept, delayed)
    recursion = Recursion(ny, nu, initial, tick, ahead, simulated, warmup)
    return replace(recursion, part=part, first_row=first_row, free_run=free_run)


def _run_of_network(model: Stepped, part: Part, warmup: int, kept: int, delayed: Any) -> FreeRun:
    """Return the free run of a trained model; `kept` and `delayed` as in `recursion_of_network`."""
    ny = len(model.y_mean)

    def begin(state: State) -> State:
        going = bool(state["running"] > 0)
        if not going and state["count"] < warmup:
            raise _too_few(warmup)
        settled = state["settled"] if going else part.settle(state["part"])
        slow = read(state["rows"], settled) if kept else np.zeros((warmup, ny))
        run = state["run"] if going else model.paused(state["y"], state["u"], slow)
        now, beside = _merged(part, state["part"], settled)
        rows = state["rows"][-1:] if part.merged is None else slow[-1:, :, None]
        return {
            "line": state["line"],
            "part": now,
            "u": state["u"][-1],
            "rows": rows if kept else np.zeros((0, ny, 1)),
            "run": run,
            "settled": beside,
        }

    def step(state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        now, rows = part.row(state["part"], u, y_sim, 0)
        line, late = delayed(state["line"], u)
        past = state["rows"] if kept else np.zeros((1, ny, 1))
        signal = read(np.concatenate([past, rows]), state["settled"])
        run, y = model.advance(state["run"], np.stack([state["u"], late]), signal)
        new = {
            "line": line,
            "part": now,
            "u": late,
            "rows": rows if kept else state["rows"],
            "run": run,
            "settled": state["settled"],
        }
        return new, y

    return FreeRun(begin, step)


def recursion_of_median(members: Sequence[Recursion]) -> Recursion:
    """Return the recursion of the median of several, which predicts once all of them do."""

    def tick(state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        ticks = [
            member.tick(own, y, u, y_sim[: 1 + member.ahead])
            for member, own in zip(members, state["members"], strict=True)
        ]
        ready = ticks[0][2]
        for _, _, able in ticks[1:]:
            ready = ready & able
        predicted = median([each for _, each, _ in ticks])
        return {"members": [new for new, _, _ in ticks]}, predicted, ready

    runs = [member.free_run for member in members if member.free_run]

    def begin(state: State) -> State:
        own = zip(runs, state["members"], strict=True)
        return {"members": [run.begin(each) for run, each in own]}

    def step(state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        own = zip(runs, state["members"], strict=True)
        each = [run.step(one, u, y_sim) for run, one in own]
        predicted = median([y for _, y in each])
        return {"members": [new for new, _ in each]}, predicted

    return replace(
        members[0],
        initial=lambda known: {"members": [member.initial(known) for member in members]},
        tick=tick,
        followed=lambda known: {"members": [member.after(known) for member in members]},
        ahead=max(member.ahead for member in members),
        warmup=max(member.warmup for member in members),
        free_run=FreeRun(begin, step) if len(runs) == len(members) else None,
    )


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
        return _begun(forecaster, forecaster.recursion(), history, other_record)
    except NotSteppedError:
        return _begun(forecaster, _repredicted(forecaster), history, other_record)


def _begun(
    forecaster: Forecaster, recursion: Recursion, history: Record | None, other_record: bool
) -> Stream:
    known = known_of(forecaster, 0, history, other_record)
    return Stream(forecaster.name, recursion, recursion.after(known))


def program_of(
    forecaster: Forecaster, history: Record | None = None, other_record: bool = False
) -> tuple[Recursion, State | None]:
    """Return the recursion that `Forecaster.export` writes, and its state after a history.

    The state is None where it depends on past output of a simulator that is not available.
    """
    recursion = forecaster.recursion(outside=True)
    try:
        return recursion, recursion.after(known_of(forecaster, 0, history, other_record))
    except ValueError:
        if not recursion.simulated or history is not None or other_record:
            raise
        return recursion, None


def _repredicted(forecaster: Forecaster) -> Recursion:
    """Return the recursion that predicts each sample anew, ever more slowly."""
    record, simulated = forecaster.require_fitted().record, "simulator" in forecaster.needs

    def followed(known: ForecastContext | None) -> State:
        assert known is not None
        none, samples = np.zeros((len(known.y), 0)), len(known.y)
        u, y_sim = (none if each is None else each[:samples] for each in (known.u, known.y_sim))
        return {"history": known, "y": known.y, "u": u, "y_sim": y_sim}

    def tick(state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array, Any]:
        rows = {"y": y[None], "u": u[None], "y_sim": y_sim}
        new = state | {name: np.concatenate([state[name], row]) for name, row in rows.items()}
        return new, last_of(new) if np.isnan(y).any() else y, True

    def last_of(state: State) -> Array:
        """Return the last of these samples, predicted from the last measured one before it."""
        y, history = state["y"], state["history"]
        measured = np.flatnonzero(~np.isnan(y).all(axis=1))
        origin = int(measured[measured < len(y) - 1].max()) + 1
        known = replace(
            history,
            y=y[:origin],
            steps=len(y) - origin,
            u=state["u"] if record.nu else None,
            y_sim=state["y_sim"] if simulated else None,
            grid=history.grid and replace(history.grid, samples=origin),
            own=False,
        )
        return extrapolated(forecaster, known)[0][-1]

    return Recursion(
        record.ny,
        record.nu,
        followed,
        tick,
        simulated=simulated,
        warmup=forecaster.warmup,
        repeats=True,
        followed=followed,
    )
