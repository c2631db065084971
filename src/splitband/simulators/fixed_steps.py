"""Integrate a fitted equation by equal steps, in traceable code (`runtime.tracing`).

An exported program would need much code for adaptive steps. With enough equal steps per sample it
is as exact as the solver. The inputs of the training record determine their number.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.tracing import scan
from splitband.simulators.adjusted import Adjusted
from splitband.simulators.functions import Ode
from splitband.simulators.user_code import count_arguments, failure

PRECISE = 1e-11, 1e-13
"""Tolerances of the reference solution. Rounding."""
TARGET = 1e-9
"""Largest difference from the reference, as a share of a channel's range. A convention."""
MOST_STEPS = 64
"""Largest number of steps per sample. Bounds the time of a program."""
MAX_NOISE_SHARE = 1e-3
"""Largest difference with `MOST_STEPS`, as a share of the model's error in training. By eye."""
_INSTEAD = (
    "; a hybrid on it can take its output as y_sim instead: save it, and export what "
    "sb.load(folder) returns without the simulator"
)


@dataclass(frozen=True, eq=False)
class FixedSteps:
    """An integrator of an equation by equal steps of Dormand and Prince's method of order 5.

    Attributes
    ----------
    ode : The equation, for the channels of a record.
    values : Values of all parameters.
    width : Time between two samples in s.
    count : Steps from one sample to the next.
    """

    ode: Ode
    values: Mapping[str, float]
    width: float
    count: int

    def advance(self, x: Array, time: Any, before: Array, u: Array) -> Array:
        """Return the state one sample later, `(nx,)`.

        Parameters
        ----------
        x : State at the sample before, `(nx,)`.
        time : Time of the sample before in s.
        before, u : Inputs of the sample before and of the new one, `(nu,)`.
        """

        def step(x: Array, row: Any) -> tuple[Array, None]:
            return self._step(x, row[0], time, before, u), None

        if self.count == 1:
            return step(x, [0.0])[0]
        state: Array = scan(step, x, [np.arange(self.count) / self.count])[0]
        return state

    def observed(self, x: Array, u: Array) -> Array:
        """Return the channels of a state, `(ny,)`."""
        observe: Any = self.ode.observe
        arguments = x[None], u[None], self.ode.p(self.values)
        with _traceable():
            channels = observe(*arguments[: count_arguments(observe) or 1])
            rows: Array = channels if hasattr(channels, "ndim") else np.stack([*channels])
        return rows[0] if rows.ndim > 1 else rows

    def _step(self, x: Array, begin: Any, time: Any, before: Array, u: Array) -> Array:
        """Return the state after a step from `begin` on, a share of the interval."""
        from splitband.kernels.ode import NODES, WEIGHTS  # noqa: PLC0415  numba is slow to load

        size = self.width / self.count
        slopes: list[Array] = []
        for weights, node in zip(WEIGHTS[:-1], NODES[:-1], strict=True):
            share = begin + node / self.count
            now = before
            if len(u) and self.ode.hold == "linear":
                now = before + share * (u - before)
            stage = _moved(x, size, weights, slopes)
            slopes.append(self._slope(time + share * self.width, stage, now))
        return _moved(x, size, WEIGHTS[-1], slopes)

    def _slope(self, time: Any, x: Array, u: Array) -> Array:
        """Return the right-hand side, `(nx,)`."""
        rhs, states = self.ode.rhs, self.ode.states
        arguments: tuple[Any, ...] = time, x, u, self.ode.p(self.values)
        with _traceable():
            if self.ode.terms:
                arguments = *arguments, self.ode.outputs(x, u)
            slopes = rhs(*arguments[: count_arguments(rhs) or 2])
            slope: Array = np.stack([slopes[i] for i in range(len(slopes))])
        if slope.shape != (states,):
            raise InputError(
                f"the equation must return {states} number(s) to be exported, got the shape "
                f"{slope.shape}"
            )
        return slope


def enough_steps(
    adjusted: Adjusted, time: Array, u: Array | None, window: int, spread: Array
) -> int:
    """Return the fewest steps per sample with the accuracy of a precise solution.

    Parameters
    ----------
    adjusted : A fitted `Ode` with the method RK45.
    time, u : Times of the training record in s, `(time,)`, and its inputs, `(time, nu)`.
    window : Samples after which the comparison restarts from the precise state; 0 for none.
    spread : Ranges of the channels, `(ny,)`.

    Raises
    ------
    ValueError
        If `MOST_STEPS` are not enough: the equation needs an adaptive solver.

    Warns
    -----
    UserWarning
        If the model itself, with coarse tolerances, differs from the precise solution.
    """
    ode: Ode = adjusted.simulator
    y, x = replace(adjusted, simulator=replace(ode, tolerances=PRECISE)).response(time, u)
    length, count = window or len(time) - 1, 1

    def differs(solved: Callable[..., Any], option: float) -> Array:
        """Return the largest difference of another solution, `(ny,)`."""
        most = np.zeros(y.shape[1])
        for begin in range(0, len(time) - 1, length):
            part = slice(begin, begin + length + 1)
            inputs = None if u is None else u[part]
            other = solved(adjusted.values, x[begin], time[part], inputs, option)[0]
            apart = np.nan_to_num(np.abs(other - y[part]), nan=np.inf)
            most = np.maximum(most, apart.max(axis=0))
        return most

    enough = MAX_NOISE_SHARE * adjusted.noise
    if ((coarse := differs(ode.advance, 0.0)) > enough).any():
        warnings.warn(
            f"the tolerances of the equation, {ode.tolerances}, are too coarse for the program to "
            "agree with the model: it solves the equation precisely, which differs by up to "
            f"{np.max(coarse / adjusted.noise):.1g} of the model's error; fit it with smaller ones",
            stacklevel=2,
        )
    while ((left := differs(ode.stepped, count)) > TARGET * spread).any():
        if count == MOST_STEPS:
            break
        count *= 2
    if (left <= np.maximum(TARGET * spread, enough)).all():
        return count
    raise InputError(
        f"the equation needs an adaptive solver, which a program has not: by {MOST_STEPS} steps a "
        f"sample it is up to {np.max(left / spread):.1g} of the range beside the solution, as a "
        f"stiff equation is, or one that jumps{_INSTEAD}"
    )


def _moved(x: Array, size: Any, weights: Array, slopes: list[Array]) -> Array:
    """Return a state plus weighted slopes, for a step of this size."""
    for weight, slope in zip(weights, slopes, strict=False):
        if weight:
            x = x + size * weight * slope
    return x


@contextmanager
def _traceable() -> Iterator[None]:
    """Turn errors of a user's equation into a ValueError with advice."""
    try:
        with np.errstate(all="ignore"):
            yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"the equation cannot be exported: {failure(error)}; it must be written with NumPy's "
            "functions (np.where for if, np.maximum for max, np.sin for math.sin) and return a "
            f"list{_INSTEAD}"
        ) from error
