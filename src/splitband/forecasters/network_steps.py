"""The step form of networks, alone or beside a base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np

from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.steps import DelayLine, State, Steps
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import cond

if TYPE_CHECKING:
    from splitband.forecasters.network import Network
    from splitband.models.stepping import Stepped

Prediction = Callable[[State, Array, Array], Sequence[Any]]
"""Returns the next run and the prediction: of a state, the last two inputs, and rows of a base."""


@final
class NetworkSteps(Steps):
    """Step a trained model, with a base or without.

    The state holds the last `warmup` samples, measured or predicted. After a measured sample, the
    model warms up on them again, once a prediction is requested.

    network : The fitted forecaster.
    model : Its model, step by step.
    base : The step form of its base; None without one.
    """

    def __init__(self, network: Network, model: Stepped, base: Steps | None) -> None:
        self.network, self.model, self.base = network, model, base
        self.warmup, self.line = network.warmup, DelayLine(network.delays)
        self.ahead = model.ahead if base is not None else 0
        self.simulated = base is not None and base.simulated
        self.note = "" if base is None else base.note
        self.ny = len(model.y_mean)

    def begin(self, history: ForecastContext | None) -> State:
        """Return the state after a history; without one it holds the means of the training."""
        model, length, free = self.model, self.warmup, 0
        y, u = (np.tile(mean, (length, 1)) for mean in (model.y_mean, model.u_mean))
        base: Array | None = None
        if history is not None:
            y, inputs, base, free = self.network.warmed_up(history, self.ahead)
            u = np.zeros((length + free, 0)) if inputs is None else inputs
        whole = length + free + self.ahead
        slow = np.tile(model.y_mean, (whole, 1)) if base is None else base
        # Where the output ends with the history, the next sample is given with the first `advance`.
        unknown = max(whole - len(slow), 0)
        if unknown and free:
            raise InputError(
                f"history must bring a simulator's output (y_sim) of the sample after its end for "
                f"{self.network.name}, as it ends in a gap"
            )
        slow = np.concatenate([slow, np.repeat(slow[-1:], unknown, axis=0)])
        first = slow[: length + self.ahead]
        state: State = {
            "line": self.line.begin(None if history is None else history.u),
            "y": y,
            "u": u[:length],
            "run": model.begin(y, u[:length], first),
            "fresh": np.array(float(unknown > 0)),
            "count": np.array(0.0 if history is None else float(length)),
        }
        if self.base is not None:
            state |= {"base": self.base.begin(history), "slow": first}
        for n in range(length, length + free):
            state, _ = self._moved(state, u[n], slow[n : n + 1 + self.ahead], self._predicted)
        if unknown:
            nothing = np.full((unknown, self.ny), np.nan)
            state["slow"] = np.concatenate([state["slow"][:-unknown], nothing])
        return state

    def warmed_up(self, state: State) -> State:
        """Return the state with the run begun after the last samples, if any was measured."""
        slow = state["slow"] if self.base is not None else state["y"]
        run = cond(
            state["fresh"] > 0,
            lambda: self.model.begin(state["y"], state["u"], slow),
            lambda: state["run"],
        )
        return state | {"run": run, "fresh": np.zeros(())}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        return self._later(state, u, y_sim, self._predicted)

    def advance(
        self, state: State, u: Array, y_sim: Array, needed: Any = True
    ) -> tuple[State, Array]:
        """Return the state one sample later, and the prediction; NaN until it is warmed up."""

        def predicted(state: State, u: Array, slow: Array) -> list[Any]:
            if self.ahead:  # it is known now, if it was not when the history ended
                state = state | {"slow": np.concatenate([state["slow"][:-1], slow[1:2]])}
            return cond(
                needed,
                lambda: self._predicted(self.warmed_up(state), u, slow),
                lambda: [state["run"], state["y"][-1]],
            )

        following, y = self._later(state, u, y_sim, predicted)
        following["fresh"] = np.where(needed, 0.0, state["fresh"])
        return following, np.where(state["count"] >= self.warmup, y, np.nan)

    def correct(self, state: State, y: Array) -> State:
        """Return the state with a measured sample in place of the predicted one."""
        last = np.where(np.isnan(y), state["y"][-1], y)
        new = {
            "y": np.concatenate([state["y"][:-1], last[None]]),
            "fresh": np.ones(()),
            "count": np.minimum(state["count"] + 1, self.warmup),
        }
        if self.base is not None:
            new["base"] = self.base.correct(state["base"], y)
        return state | new

    def _later(
        self, state: State, u: Array, y_sim: Array, predicted: Prediction
    ) -> tuple[State, Array]:
        """Return the state one sample later, and the prediction by this function."""
        line, inputs = self.line.move(state["line"], u)
        if self.base is None:
            following, y = self._moved(state, inputs, np.zeros((1, self.ny)), predicted)
            return following | {"line": line}, y
        base, slow = self.base.advance(state["base"], u, y_sim[:1])
        rows, later = [slow], base
        for n in range(self.ahead):  # there are no inputs then
            later, slow = self.base.advance(later, u, y_sim[n + 1 :])
            rows.append(slow)
        following, y = self._moved(state, inputs, np.stack(rows), predicted)
        return following | {"line": line, "base": base}, y

    def _moved(
        self, state: State, u: Array, slow: Array, predicted: Prediction
    ) -> tuple[State, Array]:
        """Return the state one sample later, and the prediction; `slow` are rows of the base."""
        last = self.warmup - 1
        known = slow[:0] if self.base is None else state["slow"][last : last + 1]
        run, y = predicted(state, np.stack([state["u"][-1], u]), np.concatenate([known, slow]))
        new = {
            "y": np.concatenate([state["y"][1:], y[None]]),
            "u": np.concatenate([state["u"][1:], u[None]]),
            "run": run,
        }
        if self.base is not None:
            new["slow"] = np.concatenate([state["slow"][1 : last + 1], slow])
        return state | new, y

    def _predicted(self, state: State, u: Array, slow: Array) -> list[Any]:
        return [*self.model.advance(state["run"], u, slow)]
