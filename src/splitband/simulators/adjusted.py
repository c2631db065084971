"""Run a simulator with fitted parameters, from an initial state estimated from a history."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError
from splitband.runtime.errors import InputError
from splitband.runtime.options import saved
from splitband.simulators.code import failure, place
from splitband.simulators.estimate import Estimate
from splitband.simulators.parameters import Adjustable, Point, Response
from splitband.simulators.shooting import BAD, STATE_STEP, Experiment, best_state

MOST_STATES = 500
"""Most training states that are kept, as prior and as starting points of searches. By eye."""
_TRIED = 3
"""Number of kept states, those with the closest outputs, from which a search for an initial state
starts. By eye."""
_MOST_RUNS = 50
"""Most evaluations in a search for an initial state. By eye."""
_LEAST_NOISE = 1e-3
"""Smallest assumed error of a simulator, as a share of a channel's deviation. By eye."""


@saved
@dataclass(frozen=True, eq=False)
class Adjusted:
    """Run a simulator with the fitted parameter values.

    Attributes
    ----------
    simulator : The simulator with the ranges of the fit; None in a saved model.
    values : Value of every parameter; initial values are those of the first training record.
    noise : RMSE of each channel in training, `(ny,)`.
    states, outputs : States `(n, nx)` and outputs `(n, ny)` of the first training record, at most
        `MOST_STATES` rows.
    """

    simulator: Any
    values: dict[str, float]
    noise: Array
    states: Array = field(default_factory=lambda: np.empty((0, 0)))
    outputs: Array = field(default_factory=lambda: np.empty((0, 0)))

    @classmethod
    def of(
        cls, simulator: Adjustable, estimate: Estimate, experiments: Sequence[Experiment]
    ) -> Self:
        """Return the fitted simulator; `experiments` are those of the fit."""
        values = {
            name: estimate.values.get(name, x) for name, x in simulator.known.middle().items()
        }
        deviation = np.nanstd(np.concatenate([each.y for each in experiments]), axis=0)
        scale = np.maximum(deviation, 1e-300)
        noise = np.maximum(np.array(estimate.rmse), _LEAST_NOISE * scale)
        usual = cls(simulator, values, noise)
        outputs, states = usual.response(experiments[0].time, experiments[0].u)
        rows = np.linspace(0, len(states) - 1, min(len(states), MOST_STATES)).round().astype(int)
        rows = rows[np.isfinite(states[rows]).all(axis=1)]
        return replace(usual, states=states[rows], outputs=outputs[rows])

    def response(self, time: Array, u: Array | None, state: Any = None) -> Response:
        """Simulate channels and states at `time` in s, by default from the fitted initial state.

        Raises ValueError if the run fails.
        """
        simulator = self._given
        with _running():
            y, x = simulator.respond(time, u, [self._began(state)])[0]
        return self._finite(y, time), x

    def advance(
        self, state: Any, time: Array, u: Array | None, size: float = 0.0
    ) -> tuple[Array, Array, float]:
        """Return channels, states, and the step size to go on with; see `Ode.advance`.

        Raises ValueError if the run fails.
        """
        simulator = self._given
        state = simulator.initial(self.values) if state is None else state
        with _running():
            y, x, size = simulator.advance(self.values, state, time, u, size)
        return self._finite(y, time), x, size

    def beginning(self, history: Experiment) -> Array | None:
        """Estimate the initial state of a history; None for a simulator without one.

        The estimate fits the history and a prior from the training states, which weighs as much as
        one sample per state and decides where the history does not determine the state. For a
        black box, the fitted initial values take the place of the state.
        """
        names = self._given.known.initial
        usual = self.states
        if not self.simulator.states:
            if not names:
                return None
            low, high = np.transpose([self.simulator.known.range(name) for name in names])
            return self._searched(history, [0.5 * (low + high)], 0.5 * (low + high), high - low)
        mean, spread = usual.mean(axis=0), usual.std(axis=0)
        spread = np.maximum(spread, 1e-6 * np.maximum(np.abs(mean), 1e-6))
        return self._searched(history, [*self._similar(history), mean], mean, spread)

    @property
    def _given(self) -> Any:
        """Return the simulator; raises ValueError if a saved model has not been given it."""
        if not hasattr(self.simulator, "respond"):
            self.simulator.simulate(None)
        return self.simulator

    def _finite(self, y: Array, time: Array) -> Array:
        """Return the channels; raises ValueError for values that are not finite."""
        good = np.isfinite(y).all(axis=1)
        if not good.all():
            raise InputError(self._given.unfinished(float(time[np.argmin(good)])))
        return y

    def _began(self, state: Any) -> Point:
        """Return parameters and initial state as `Adjustable.respond` takes them."""
        if state is None or self.simulator.states:
            return self.values, state
        return {**self.values, **dict(zip(self.simulator.known.initial, state, strict=True))}, None

    def _similar(self, history: Experiment) -> list[Array]:
        """Return the training states whose outputs are closest to a history's first sample."""
        first = history.y[:1]
        distance = np.nansum(((self.outputs - first) / self.noise) ** 2, axis=1)
        return [self.states[n] for n in np.argsort(distance, kind="stable")[:_TRIED]]

    def _searched(
        self, history: Experiment, begin: Sequence[Array], mean: Array, spread: Array
    ) -> Array:
        """Search from several states, and return the most likely result."""

        def errors(states: Sequence[Array]) -> list[Array]:
            points = [self._began(state) for state in states]
            with np.errstate(all="ignore"), _running():
                found = self.simulator.respond(history.time, history.u, points)
            return [np.concatenate([self._errors(history.y, y), (state - mean) / spread])
                    for (y, _), state in zip(found, states, strict=True)]  # fmt: skip

        step = max(STATE_STEP, self.simulator.difference)
        found = [best_state(errors, state, spread, step, _MOST_RUNS) for state in begin]
        return min(found, key=lambda each: each[1])[0]

    def _errors(self, measured: Array, y: Array) -> Array:
        """Return the errors of a simulation divided by the noise, `(samples * ny,)`, 0 in gaps."""
        errors = np.nan_to_num((y - measured) / self.noise, nan=BAD, posinf=BAD, neginf=-BAD)
        return np.asarray(np.where(np.isnan(measured), 0.0, np.clip(errors, -BAD, BAD)).ravel())


@contextmanager
def _running() -> Iterator[None]:
    """Turn errors of user code into a ValueError that states the place."""
    try:
        yield
    except DeadlineError:
        raise
    except Exception as error:
        if isinstance(error, ValueError) and not place(error):
            raise  # raised by this package
        raise InputError(f"the simulator failed: {failure(error)}") from error
