"""Define forecasters sample by sample, in NumPy, for streams and exported programs.

A recursion takes one sample after the other. A sample that was not measured is NaN, and is
forecast. Measured and forecast samples may alternate at will; a forecast always equals that of
`Forecaster.predict` from the origin. Time and memory of a sample are constant. The code can be
traced, see `runtime.tracing`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from splitband.data.preparation import Preparation
from splitband.data.signals import last_before
from splitband.forecasters.known import Known
from splitband.forecasters.medians import median
from splitband.runtime.arrays import Array
from splitband.runtime.tracing import cond

if TYPE_CHECKING:
    from splitband.models.stepping import Stepped

State = dict[str, Any]
"""The state of a recursion, by name; it is never changed in place."""


class NotSteppedError(ValueError):
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
    def initial(self, known: Known | None = None) -> State:
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

    def first_row(self, known: Known) -> int:
        """Return the first sample of a history on which the forecast depends."""
        return 0

    def followed(self, known: Known) -> State:
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
    def initial(self, known: Known | None) -> State:
        """Return the state before the first sample of a history; None is for another record."""

    @abstractmethod
    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the next state and the rows of a sample and `ahead` more, `(1 + ahead, ny, n)`."""

    def learn(self, state: State, row: Array, y: Array) -> State:
        """Return the state updated with a sample, `(ny,)`, NaN where it was not measured."""
        return state

    def settle(self, state: State) -> Array:
        """Return the parameters estimated from the samples so far, `(ny, n - 1)`."""
        return np.zeros((1, 0))

    def simulated_over(self, known: Known, ahead: int) -> Array | None:
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

    def initial(self, known: Known | None = None) -> State:
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
        new = {"part": self.part.learn(part, rows[0], y), "settled": settled, "stale": stale}
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

    def initial(self, known: Known | None = None) -> State:
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
            "part": part if self.part is None else self.part.learn(part, rows[0], y),
            "y": np.concatenate([state["y"][1:], y[None]]),
            "u": inputs[1:],
            "rows": window[1 : self.warmup + 1] if self.part else state["rows"],
            "count": count,
            "running": np.where(runs, 1.0, 0.0),
            "run": run,
            "settled": settled,
        }
        return new, predicted, runs

    def first_row(self, known: Known) -> int:
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

    def initial(self, known: Known | None = None) -> State:
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

    def followed(self, known: Known) -> State:
        """Return the states of the members after the history."""
        return {"members": [member.followed(known) for member in self.members]}
