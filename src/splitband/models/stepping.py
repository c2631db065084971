"""Define the models sample by sample, in NumPy: how they are stepped, and exported.

`begin` computes from the last measured samples what `Model.simulate` begins with, and `advance`
goes on by one sample. What is passed between them is all the state there is. The code can be
traced, see `runtime.tracing`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import scipy

from splitband.filters import ComplementaryPair
from splitband.networks import Cell
from splitband.networks.plain import in_numpy, values
from splitband.runtime.arrays import Array
from splitband.runtime.tracing import cond, scan

Run = dict[str, Any]
"""The state of a free run, by name."""


class Stepped(ABC):
    """Run a trained model sample by sample."""

    ahead = 0
    """How many samples beyond the one to predict of the slow signal are looked at, 0 or 1."""

    def __init__(self, model: Any) -> None:
        self.y_mean, self.y_std = values(model.y_mean), values(model.y_std)
        self.u_mean, self.u_std = values(model.u_mean), values(model.u_std)
        self.feedthrough = bool(model.feedthrough)
        self.driven = model.nu > 0

    def begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
        """Return the run after measured samples, and the first sample that it predicts, `(ny,)`.

        Parameters
        ----------
        y : The last measured samples, `(R, ny)`.
        u : Inputs of these and of the sample to predict, `(R + 1, nu)`.
        slow : What is given beside them, `(R + 1 + ahead, ny)`; not looked at without any.
        """
        run, first = self._begin(self._y(y), self._u(u), self._y(slow))
        return run, first * self.y_std + self.y_mean

    def advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        """Return the run and what it predicts one sample later, `(ny,)`.

        Parameters
        ----------
        run : After the sample before.
        u : Inputs of the sample before and of the one to predict, `(2, nu)`.
        slow : What is given beside them, `(2 + ahead, ny)`.
        """
        run, following = self._advance(run, self._u(u), self._y(slow))
        return run, following * self.y_std + self.y_mean

    @abstractmethod
    def _begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
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

    def _told(self, slow: Array, scale: Array) -> Array:
        """Return value and slope of what is slower, by steps, see `models.base.conditioning`."""
        steps = len(slow) - 1 - self.ahead
        following = slow[1 : steps + 1]
        slope = (slow[2:] - slow[:-2]) / 2 if self.ahead else following - slow[:steps]
        return np.concatenate([following, slope / scale], axis=1)


class SteppedCell:
    """A cell with what it predicted last."""

    def __init__(self, cell: Cell) -> None:
        self.cell = in_numpy(cell)

    def begin(self, y: Array, rows: Array) -> Run:
        """Return its state after measured samples."""
        h = self.cell.initial_state(y, rows)
        return {"h": h, "y": self.cell.observe(h)}

    def advance(self, run: Run, row: Array) -> Run:
        """Return its state one sample later."""
        h = self.cell.step(run["h"], run["y"], row)
        return {"h": h, "y": self.cell.observe(h)}


class SteppedRecurrent(Stepped):
    """One network on the whole band."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.cell = SteppedCell(model.cell)

    def _begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
        run = self.cell.begin(y, self._rows(u))
        return run, run["y"]

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        run = self.cell.advance(run, self._rows(u)[0])
        return run, run["y"]


class _SteppedHybrid(Stepped):
    """A network beside something slower."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.cell = SteppedCell(model.cell)
        self.conditioned, self.slope_scale = model.conditioned, values(model.slope_scale)
        self.ahead = int(model.conditioned and not self.driven)

    def _given(self, u: Array, slow: Array) -> Array:
        rows = self._rows(u)
        if not self.conditioned:
            return rows
        return np.concatenate([rows, self._told(slow, self.slope_scale)], axis=1)


class SteppedResidual(_SteppedHybrid):
    """A network for what something slower leaves."""

    def _begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
        run = self.cell.begin(y - slow[: len(y)], self._given(u, slow))
        return run, run["y"] + slow[len(y)]

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        run = self.cell.advance(run, self._given(u, slow)[0])
        return run, run["y"] + slow[1]


class SteppedFiltered(_SteppedHybrid):
    """Something slower in the low band, a network in the high band."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.pair: ComplementaryPair = model.pair

    def _begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
        pair, warmup, order = self.pair, len(y), self.pair.order
        low, low_state = one_way(pair.b_low, pair.a, slow[: warmup + 1], steady(pair, "low"))
        measured = y[warmup - order :]
        left = measured - low[warmup - order : warmup]
        high_state = state_after(pair.b_high, pair.a, measured, left)
        net = self.cell.begin(y, self._given(u, slow))
        return self._filtered({"net": net, "low": low_state, "high": high_state}, low[warmup])

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        low_state, low = filtered(self.pair.b_low, self.pair.a, run["low"], slow[1])
        net = self.cell.advance(run["net"], self._given(u, slow)[0])
        return self._filtered({"net": net, "low": low_state, "high": run["high"]}, low)

    def _filtered(self, run: Run, low: Array) -> tuple[Run, Array]:
        high_state, high = filtered(self.pair.b_high, self.pair.a, run["high"], run["net"]["y"])
        return {**run, "high": high_state}, low + high


class SteppedSplit(Stepped):
    """Two networks, each on its band.

    The slow one is a sample of its own ahead, between which and the one before the low band is
    interpolated. That needs no input to come, see `models.Split`.
    """

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        if model.filter_output and not self.driven and model.pair.zero_phase:
            raise ValueError(
                "a split model whose output is filtered forwards and backwards cannot be stepped"
            )
        self.pair: ComplementaryPair = model.pair
        self.slow, self.fast = (SteppedCell(network) for network in model.networks)
        self.k: int = model.downsampling
        self.conditioned, self.slope_scale = model.conditioned, values(model.slope_scale)[0]
        self.output = model.pair.one_way() if model.filter_output else None
        self.at_once = self.feedthrough and self.driven and self.k == 1
        self.ahead = int(not self.driven)

    def _begin(self, y: Array, u: Array, slow: Array) -> tuple[Run, Array]:
        k, warmup = self.k, len(y)
        low = both_ways(self.pair, y)
        means = self._rows(u) if self.at_once else self._means(u, warmup % k)
        run: Run = {"slow": self.slow.begin(low[warmup % k :: k], means[: warmup // k])}
        run["current"] = run["slow"]["y"]
        if not self.at_once:
            run["slow"] = self.slow.advance(run["slow"], means[warmup // k])
        run |= {"phase": np.zeros(()), "sum": np.zeros(len(self.u_mean))}
        rows = self._rows(u)
        if self.conditioned:
            told = self._told(np.concatenate([low, *self._low(run)]), self.slope_scale)
            rows = np.concatenate([rows, told], axis=1)
        run["fast"] = self.fast.begin(y - low, rows)
        if self.output is not None:
            _, run["output"] = one_way(
                self.output.b_high, self.output.a, y - low, steady(self.output, "high")
            )
        return self._combined(run)

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        before, run = self._low(run)[0], self._moved(run, u)
        rows = self._rows(u)
        if self.conditioned:
            told = self._told(np.concatenate([before, *self._low(run)]), self.slope_scale)
            rows = np.concatenate([rows, told], axis=1)
        run["fast"] = self.fast.advance(run["fast"], rows[0])
        return self._combined(run)

    def _moved(self, run: Run, u: Array) -> Run:
        """Return the run with its low band one sample later."""
        if self.at_once:
            moved = self.slow.advance(run["slow"], self._rows(u)[0])
            return {**run, "slow": moved, "current": moved["y"]}
        total, phase = run["sum"] + u[1], run["phase"] + 1

        def stepped() -> list[Any]:
            moved = self.slow.advance(run["slow"], total / self.k)
            return [moved, run["slow"]["y"], np.zeros(()), np.zeros(len(self.u_mean))]

        moved, current, phase, total = cond(
            phase >= self.k, stepped, lambda: [run["slow"], run["current"], phase, total]
        )
        return {**run, "slow": moved, "current": current, "phase": phase, "sum": total}

    def _low(self, run: Run) -> list[Array]:
        """Return the low band at the sample to predict, and `ahead` after it, each `(1, ny)`."""
        current = run["current"]
        if self.at_once:
            return [current[None]]
        rise = run["slow"]["y"] - current
        return [(current + rise * ((run["phase"] + i) / self.k))[None]
                for i in range(1 + self.ahead)]  # fmt: skip

    def _combined(self, run: Run) -> tuple[Run, Array]:
        high = run["fast"]["y"]
        if self.output is not None:
            state, high = filtered(self.output.b_high, self.output.a, run["output"], high)
            run = {**run, "output": state}
        return run, self._low(run)[0][0] + high

    def _means(self, u: Array, offset: int) -> Array:
        """Return the mean inputs of the slow steps, see `models.learned`."""
        before = np.broadcast_to(u[:1], (self.k - 1 - offset, u.shape[1]))
        blocks = np.concatenate([before, u]) if len(before) else u
        return blocks.reshape(len(blocks) // self.k, self.k, u.shape[1]).sum(axis=1) / self.k


def filtered(b: Array, a: Array, state: Array, x: Array) -> tuple[Array, Array]:
    """Return the state `(P, ny)` and the output `(ny,)` of a filter after another sample.

    It is SciPy's transposed direct form II.
    """
    y = b[0] * x + state[0]
    moved = np.concatenate([state[1:], np.zeros((1, state.shape[1]))]) if len(state) > 1 else 0.0
    return b[1:, None] * x - a[1:, None] * y + moved, y


def one_way(b: Array, a: Array, x: Array, zi: Array) -> tuple[Array, Array]:
    """Filter `(time, ny)` from the state `zi` for a first sample of 1; return the last state, too.

    The state is multiplied by the first sample.
    """

    def body(state: Array, row: Any) -> tuple[Array, Array]:
        return filtered(b, a, state, row[0])

    state, y = scan(body, zi[:, None] * x[0], [x])
    return y, state


def both_ways(pair: ComplementaryPair, y: Array) -> Array:
    """Return the low band of `(time, ny)` by filtering forwards and backwards."""
    if not pair.zero_phase:
        return one_way(pair.b_low, pair.a, y, steady(pair, "low"))[0]
    p = 3 * len(pair.a) if pair.start == "odd" else 0
    x, n = y, len(y)
    if p:
        head, tail = y[1 : p + 1][::-1], y[::-1][1 : p + 1]
        x = np.concatenate([2 * y[:1] - head, y, 2 * y[n - 1 :] - tail])
    for _ in range(2):
        x = one_way(pair.b_low, pair.a, x, steady(pair, "low"))[0][::-1]
    return x[p : p + n]


def steady(pair: ComplementaryPair, band: str) -> Array:
    """Return the state with which a filter begins, for a first sample of 1."""
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
