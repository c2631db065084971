"""Run the linear model sample by sample, as `LinearModel.continued` does for a whole history."""

from __future__ import annotations

import numpy as np

from splitband.baselines.linear import LinearModel
from splitband.baselines.states import most_probable
from splitband.forecasters.prediction import Known
from splitband.forecasters.stepping import DelayLine, Part, State
from splitband.runtime.arrays import Array


class Driven(Part):
    """Simulate a linear model, and observe with its Kalman filter.

    `u`: inputs of the training record from its first sample on, `(time, nu)`.
    """

    def __init__(self, model: LinearModel, u: Array) -> None:
        self.model, self.u = model, u
        self.inputs = [i for i, _ in model.taps]
        self.line = DelayLine(tuple(delay for _, delay in model.taps))
        self.white = model.whitener()
        self.late = np.array(model.late, dtype=np.float64)

    def initial(self, known: Known | None) -> State:
        """Return the expected state: simulated from the training record, or the training mean."""
        model, n = self.model, self.model.order
        begin = -1 if known is None or known.begin is None or known.begin % 1 else int(known.begin)
        expected = 0 <= begin <= len(self.u)
        before = self.u[:begin] if expected else self.u[:0]
        line = self.line.initial()
        if len(before) and line:
            longest = max(self.line.delays)
            rows = np.concatenate([np.repeat(before[:1], longest, axis=0), before])
            past = rows[len(rows) - longest :][:, self.inputs]
            line = {"past": past, "filled": np.ones(())}
        return {
            "line": line,
            "x": model.state_after(before) if expected else model.centre,
            "answers": model.root,
            "information": np.zeros((n, n)),
            "towards": np.zeros(n),
            "age": np.array(float(len(before))),
            "usual": np.array(0.0 if expected else 1.0),
        }

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the predicted sample, and its derivatives by the initial state."""
        model = self.model
        tapped = np.stack([u[i] for i in self.inputs])
        line, acting = self.line.tick(state["line"], tapped)
        acting = acting - model.mean[self.inputs]
        x, answers = state["x"], state["answers"]
        y = model.c @ x + model.d @ acting + model.offset
        row = np.concatenate([y[:, None], model.c @ answers], axis=1)
        x = model.a @ x + model.b @ acting + model.drift
        return state | {"line": line, "x": x, "answers": model.a @ answers}, row[None]

    def learn(self, state: State, row: Array, y: Array) -> State:
        """Return the state after a measured sample."""
        gain = self.model.gain
        left = y - row[:, 0]
        seen = np.logical_not(np.isnan(left)) & (state["age"] >= self.late)
        left = np.where(seen, left, 0.0)
        response = np.where(seen[:, None], row[:, 1:], 0.0)
        counted = self.white @ response
        return state | {
            "x": state["x"] + gain @ left,
            "answers": state["answers"] - gain @ response,
            "information": state["information"] + counted.T @ counted,
            "towards": state["towards"] + counted.T @ (self.white @ left),
            "age": state["age"] + 1,
        }

    def settle(self, state: State) -> Array:
        """Return the most probable initial state, as its deviation from the expected one."""
        return most_probable(state["information"], state["towards"], state["usual"])[None]

    def after_training(self, state: State) -> State:
        """Return the state at the end of the training record, as fitted."""
        return state | {"x": self.model.last - state["answers"] @ self.settle(state)[0]}
