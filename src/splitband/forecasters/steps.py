"""Define the step form of a forecaster, of which streams and exported programs are folds.

    state = steps.begin(history)
    state, y = steps.advance(state, u, y_sim)   # predict the next sample
    state = steps.correct(state, y_measured)    # where it was measured

A channel that was not measured is NaN, and keeps the model's own prediction. Time and memory of a
sample are constant. Between the same samples, a forecast is that of `Forecaster.predict`. The code
can be traced, see `runtime.tracing`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, final

import numpy as np

from splitband.forecasters.prediction import ForecastContext
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import cond

State = dict[str, Any]
"""The state of a model at a sample, arrays by name; it is never changed in place."""


class NotSteppedError(InputError):
    """Report that a forecaster has no step form; the message gives the reason."""


class Steps(ABC):
    """Define the step form of a fitted forecaster.

    Attributes
    ----------
    ahead : Samples by which a simulator's output must be known in advance, 0 or 1.
    simulated : Whether a simulator's output is given with each sample.
    warmup : Number of samples that must be observed before a step, if the state is `begin(None)`.
    note : What a user of an exported program must know, in sentences; empty for nothing.
    """

    ahead: int = 0
    simulated: bool = False
    warmup: int = 0
    note: str = ""

    @abstractmethod
    def begin(self, history: ForecastContext | None) -> State:
        """Return the state after a history; None is for one of which nothing is known."""

    @abstractmethod
    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        """Return the state one sample later, and its prediction; see `advance`.

        The state before is one of `warmed_up`. No value depends on whether another one is NaN: the
        step is as smooth as the model.
        """

    def warmed_up(self, state: State) -> State:
        """Return the state with the warm-up done for which measured samples have come in."""
        return state

    def advance(
        self, state: State, u: Array, y_sim: Array, needed: Any = True
    ) -> tuple[State, Array]:
        """Return the state one sample later, and its prediction `(ny,)`.

        The prediction is NaN where too few samples have been observed.

        Parameters
        ----------
        state : At the sample before.
        u : Inputs of this sample, `(nu,)`.
        y_sim : A simulator's output at this sample and `ahead` more, `(1 + ahead, ny)`; without
            columns for a model that needs none.
        needed : Whether the prediction is used; not where all channels are measured and `correct`
            takes none of it, so that a network may leave it out.
        """
        return self.run(self.warmed_up(state), u, y_sim)

    def correct(self, state: State, y: Array) -> State:
        """Return the state that takes into account a measured sample, `(ny,)`, NaN in gaps."""
        return state


def tick(steps: Steps, state: State, y: Array, u: Array, y_sim: Array) -> tuple[State, Array]:
    """Return the state after a sample, measured or not, and what was predicted for it."""
    gaps = np.isnan(y)
    state, predicted = steps.advance(state, u, y_sim, needed=gaps.any())
    measured = np.logical_not(gaps).any()
    return cond(measured, lambda: steps.correct(state, y), lambda: state), predicted


@final
class GivenSteps(Steps):
    """Take a simulator's output, which is given with each sample, times a gain plus an offset."""

    simulated = True

    def __init__(self, gain: Array, offset: Array) -> None:
        self.gain, self.offset = gain, offset

    def begin(self, history: ForecastContext | None) -> State:
        return {}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        return state, y_sim[0] * self.gain + self.offset


class DelayLine:
    """Delay each input by some samples; before the first one, the inputs are held."""

    def __init__(self, delays: Sequence[int]) -> None:
        self.delays, self.longest = tuple(delays), max(delays, default=0)

    def begin(self, u: Array | None) -> State:
        """Return the line after inputs `(time, n)`, or one that is empty."""
        if not self.longest:
            return {}
        past, filled = np.zeros((self.longest, len(self.delays))), 0.0
        if u is not None and len(u):
            before = np.repeat(u[:1], max(self.longest - len(u), 0), axis=0)
            past, filled = np.concatenate([before, u[-self.longest :]]), 1.0
        return {"past": past, "filled": np.array(filled)}

    def move(self, line: State, u: Array) -> tuple[State, Array]:
        """Return the line one sample later, and the delayed inputs `(n,)`."""
        if not self.longest:
            return line, u
        past = np.where(line["filled"] > 0, line["past"], u[None])
        rows = np.concatenate([past, u[None]])
        late = [rows[self.longest - delay, i] for i, delay in enumerate(self.delays)]
        return {"past": rows[1:], "filled": np.ones(())}, np.stack(late)
