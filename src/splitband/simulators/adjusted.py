"""Run a simulator with fitted parameters, from an initial state estimated from a history."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.simulators.least_squares import likely_state
from splitband.simulators.parameters import MIN_NOISE, Adjustable, Estimate, Point, Response
from splitband.simulators.shooting import Experiment
from splitband.simulators.unknown import Trained
from splitband.simulators.user_code import failure, is_ours, place

FAILED = 1e9
"""The same limit in deviations of the noise, for the larger residuals of a wrong state. Rounding.
"""
MOST_STATES = 500
"""Largest number of stored training states, as prior and as starting points. Bounds the time."""
_TRIED, _MOST_ROUNDS = 3, 50
"""Number of stored states with the closest outputs as starts for an initial state, and largest
number of steps per start. Bounds the time."""


@dataclass(frozen=True, eq=False)
class Adjusted:
    """A simulator with fitted parameter values.

    Attributes
    ----------
    simulator : The simulator with the ranges of the fit; None in a saved model.
    values : Values of all parameters; initial values are those of the first training record.
    noise : RMSE by channel in training, `(ny,)`.
    states, outputs : States `(n, nx)` and outputs `(n, ny)` of the first training record, at most
        `MOST_STATES` rows.
    terms : States of the unknown terms.
    members : Those of further trainings that fit as well, one training after another.
    """

    simulator: Any
    values: dict[str, float]
    noise: Array
    states: Array = field(default_factory=lambda: np.empty((0, 0)))
    outputs: Array = field(default_factory=lambda: np.empty((0, 0)))
    terms: tuple[Trained, ...] = ()
    members: tuple[Trained, ...] = ()

    @classmethod
    def of(
        cls, simulator: Adjustable, estimate: Estimate, experiments: Sequence[Experiment]
    ) -> Self:
        """Return the fitted simulator; `experiments` are those of the fit."""
        middle = simulator.known.middle()
        simulator = simulator.taught(estimate.terms)
        values = {name: estimate.values.get(name, x) for name, x in middle.items()}
        deviation = np.nanstd(np.concatenate([e.y for e in experiments]), axis=0)
        noise = np.maximum(np.array(estimate.rmse), MIN_NOISE * np.maximum(deviation, 1e-300))
        usual = cls(simulator, values, noise)
        outputs, states = usual.response(experiments[0].time, experiments[0].u)
        rows = np.linspace(0, len(states) - 1, min(len(states), MOST_STATES)).round().astype(int)
        rows = rows[np.isfinite(states[rows]).all(axis=1)]
        terms = tuple(term.trained for term in simulator.terms if term.trained)
        usual = replace(usual, states=states[rows], outputs=outputs[rows])
        return replace(usual, terms=terms, members=estimate.members)

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
        """Return channels, states, and the next step size; see `Ode.advance`.

        Raises ValueError if the run fails.
        """
        simulator = self._given
        state = simulator.initial(self.values) if state is None else state
        with _running():
            y, x, size = simulator.advance(self.values, state, time, u, size)
        return self._finite(y, time), x, size

    def beginning(self, history: Experiment) -> Array | None:
        """Estimate the initial state of a history; None for a simulator without one.

        The estimate fits the history and a prior from the training states. The prior has the weight
        of one sample per state, and decides if the history does not determine the state. For a
        black box, the initial values take the place of the state.
        """
        parameters = self._given.known
        if not self.simulator.states and not parameters.initial:
            return None
        if not self.simulator.states:
            low, high = np.transpose([parameters.range(name) for name in parameters.initial])
            return self._searched(history, [0.5 * (low + high)], 0.5 * (low + high), high - low)
        mean, spread = self.states.mean(axis=0), self.states.std(axis=0)
        spread = np.maximum(spread, 1e-6 * np.maximum(np.abs(mean), 1e-6))
        distance = np.nansum(((self.outputs - history.y[:1]) / self.noise) ** 2, axis=1)
        similar = self.states[np.argsort(distance, kind="stable")[:_TRIED]]
        return self._searched(history, [*similar, mean], mean, spread)

    @property
    def _given(self) -> Any:
        """Return the simulator; raises ValueError for a saved model without it."""
        return self.simulator.require()

    def _finite(self, y: Array, time: Array) -> Array:
        """Return the channels; raises ValueError for non-finite values."""
        good = np.isfinite(y).all(axis=1)
        if not good.all():
            raise InputError(self._given.unfinished(float(time[np.argmin(good)])))
        return y

    def _began(self, state: Any) -> Point:
        """Return parameters and initial state for `Adjustable.respond`."""
        if state is None or self.simulator.states:
            return self.values, state
        return {**self.values, **dict(zip(self.simulator.known.initial, state, strict=True))}, None

    def _searched(
        self, history: Experiment, begin: Sequence[Array], mean: Array, spread: Array
    ) -> Array:
        """Search from several states, and return the most likely result."""
        names = () if self.simulator.states else self.simulator.known.initial

        def run(state: Array, slopes: bool) -> tuple[Array, Array]:
            simulator, point = self.simulator, self._began(state)
            with np.errstate(all="ignore"), _running():
                if slopes:
                    found = simulator.derivatives(history.time, history.u, point, names)
                    return found[0], found[2][..., : len(state)]
                return simulator.respond(history.time, history.u, [point])[0]

        how = run, history.y, self.noise, mean, spread
        minima = [likely_state(*how, state, _MOST_ROUNDS, FAILED) for state in begin]
        return min(minima, key=lambda minimum: minimum[1])[0]


@contextmanager
def _running() -> Iterator[None]:
    """Turn errors of user code into a ValueError with the place."""
    try:
        yield
    except Exception as error:
        if is_ours(error) or (isinstance(error, InputError) and not place(error)):
            raise
        raise InputError(f"the simulator failed: {failure(error)}") from error
