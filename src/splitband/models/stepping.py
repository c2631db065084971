"""Run models sample by sample, in NumPy, also for export; subclasses are in the models' modules.

`begin` warms up on the last measured samples, as a simulation does, before the next inputs are
known, and `advance` goes on by one sample. The run that is passed between them is the whole state.
The code can be traced, see `runtime.tracing`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import scipy

from splitband.filters import Band, ComplementaryPair
from splitband.networks import Cell
from splitband.networks.in_numpy import in_numpy, values
from splitband.runtime.arrays import Array
from splitband.runtime.tracing import cond, scan

Run = dict[str, Any]
"""The state of a free run, by name."""


class Stepped(ABC):
    """Run a trained model sample by sample."""

    def __init__(self, model: Any) -> None:
        self.y_mean, self.y_std = values(model.y_mean), values(model.y_std)
        self.u_mean, self.u_std = values(model.u_mean), values(model.u_std)
        self.feedthrough = bool(model.feedthrough)
        self.driven = model.nu > 0
        self.conditioned = bool(model.conditioned)
        self.ahead = int(self.conditioned and not self.driven)
        """Samples of the slow signal that are used beyond the one to predict, 0 or 1."""
        self.slope_scale = values(model.slope_scale).reshape(-1) if self.conditioned else np.ones(1)

    def begin(self, y: Array, u: Array, slow: Array) -> Run:
        """Return the run at the last measured sample.

        y, u : The last measured samples, `(R, ny)`, and their inputs, `(R, nu)`.
        slow : A given slow component over these samples, `(R + ahead, ny)`; ignored by models
            without one.
        """
        return self._begin(self._y(y), self._u(u), self._y(slow))

    def advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        """Return the run one sample later, and what it predicts there, `(ny,)`.

        run : At the sample before.
        u : Inputs of the sample before and of the one to predict, `(2, nu)`.
        slow : The slow component over these samples, `(2 + ahead, ny)`.
        """
        run, following = self._advance(run, self._u(u), self._y(slow))
        return run, following * self.y_std + self.y_mean

    def simulate(
        self, y: Array, steps: int, u: Array | None = None, slow: Array | None = None
    ) -> Array:
        """Return the free run after a warm-up, `(steps, ny)`; see `Model.simulate_components`."""
        warmup, ahead, samples = len(y), self.ahead, len(y) + steps
        u = np.zeros((samples, 0)) if u is None else u
        slow = np.tile(self.y_mean, (samples, 1)) if slow is None else slow[:samples]
        # A straight line beyond the end gives the last sample the slope that models take there.
        slow = np.concatenate([slow, *[2 * slow[-1:] - slow[-2:-1]] * ahead])
        run, found = self.begin(y, u[:warmup], slow[: warmup + ahead]), []
        for n in range(warmup, samples):
            run, predicted = self.advance(run, u[n - 1 : n + 1], slow[n - 1 : n + 1 + ahead])
            found.append(predicted)
        return np.array(found).reshape(steps, len(self.y_mean))

    @abstractmethod
    def _begin(self, y: Array, u: Array, slow: Array) -> Run:
        """Begin, in the networks' units."""

    @abstractmethod
    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        """Advance, in the networks' units."""

    def _y(self, y: Array) -> Array:
        return (y - self.y_mean) / self.y_std

    def _u(self, u: Array) -> Array:
        return (u - self.u_mean) / self.u_std

    def _rows(self, u: Array) -> Array:
        """Return the inputs of the steps between samples, see `models.base.with_next_input`."""
        return np.concatenate([u[:-1], u[1:]], axis=1) if self.feedthrough else u[:-1]

    def _network_inputs(self, rows: Array, slow: Array) -> Array:
        """Return the inputs, if conditioned followed by value and slope of the slow component.

        See `models.base.conditioning`.
        """
        if not self.conditioned:
            return rows
        steps = len(slow) - 1 - self.ahead
        following = slow[1 : steps + 1]
        slope = (slow[2:] - slow[:-2]) / 2 if self.ahead else following - slow[:steps]
        told = np.concatenate([following, slope / self.slope_scale], axis=1)
        return np.concatenate([rows, told], axis=1)


class SteppedCell:
    """Step a cell on its last prediction."""

    def __init__(self, cell: Cell) -> None:
        self.cell = in_numpy(cell)

    def begin(self, y: Array, rows: Array) -> Run:
        """Return its state at the last of R measured samples; `rows` are of the R - 1 steps.

        A cell that begins with all R steps of its warm-up at once does so with the first `advance`.
        """
        if len(rows) >= self.cell.fewest_steps:
            return {"h": self.cell.initial_state(y[:-1], rows), "y": y[-1]}
        past = {"y": y, "rows": rows, "waits": np.ones(())}
        return {"h": np.zeros(self.cell.size), "y": y[-1], "past": past}

    def advance(self, run: Run, row: Array) -> Run:
        """Return its state one sample later."""

        def moved() -> Any:
            return self.cell.step(run["h"], run["y"], row)

        if "past" not in run:
            h = moved()
            return {"h": h, "y": self.cell.observe(h)}
        past = run["past"]

        def begun() -> Any:
            return self.cell.initial_state(past["y"], np.concatenate([past["rows"], row[None]]))

        h = cond(past["waits"] > 0, begun, moved)
        return {"h": h, "y": self.cell.observe(h), "past": past | {"waits": np.zeros(())}}


def filtered(b: Array, a: Array, state: Array, x: Array) -> tuple[Array, Array]:
    """Return the state `(P, ny)` and output `(ny,)` of SciPy's transposed direct form II."""
    y = b[0] * x + state[0]
    moved = np.concatenate([state[1:], np.zeros((1, state.shape[1]))]) if len(state) > 1 else 0.0
    return b[1:, None] * x - a[1:, None] * y + moved, y


def one_way(b: Array, a: Array, x: Array, zi: Array) -> tuple[Array, Array]:
    """Filter `(time, ny)` in one direction; return the output and the last state.

    The initial state is `zi`, which is for a first sample of 1, times the first sample.
    """

    def body(state: Array, row: Any) -> tuple[Array, Array]:
        return filtered(b, a, state, row[0])

    state, y = scan(body, zi[:, None] * x[0], [x])
    return y, state


def both_ways(pair: ComplementaryPair, y: Array, band: Band = "low") -> Array:
    """Return a band of `(time, ny)`: filtered both ways, or one way if not `zero_phase`."""
    b = pair.b_low if band == "low" else pair.b_high
    if not pair.zero_phase:
        return one_way(b, pair.a, y, steady(pair, band))[0]
    p = 3 * len(pair.a) if pair.start == "odd" else 0
    x, n = y, len(y)
    if p:
        head, tail = y[1 : p + 1][::-1], y[::-1][1 : p + 1]
        x = np.concatenate([2 * y[:1] - head, y, 2 * y[n - 1 :] - tail])
    for _ in range(2):
        x = one_way(b, pair.a, x, steady(pair, band))[0][::-1]
    return x[p : p + n]


def steady(pair: ComplementaryPair, band: Band) -> Array:
    """Return the initial state of a filter, for a first sample of 1."""
    b = pair.b_low if band == "low" else pair.b_high
    if pair.start == "zeros":
        return np.zeros(pair.order)
    return np.asarray(scipy.signal.lfilter_zi(b, pair.a))


def state_after(b: Array, a: Array, x: Array, y: Array) -> Array:
    """Return the state of a filter after its last P inputs and outputs, each `(P, ny)`."""
    order = len(a) - 1
    rows = []
    for m in range(order):
        k = np.arange(m + 1, order + 1)
        at = slice(m, order)  # order - (k - m), backwards
        rows.append((b[k[::-1], None] * x[at] - a[k[::-1], None] * y[at]).sum(axis=0))
    return np.stack(rows)
