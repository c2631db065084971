"""Use Python code of the user's as a simulator: here a function of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array
from splitband.runtime.options import Written
from splitband.simulators.parameters import Given, Parameters, Point, Response, parameters_class
from splitband.simulators.sources import code_digest, count_arguments


class UserCode(Written):
    """Define a dataclass with code of the user's and a field `parameters`."""

    parameters: Given | None

    @cached_property
    def known(self) -> Parameters:
        """Return the parameters, checked."""
        return Parameters(dict(self.parameters or {}))

    def fixed(self, values: Mapping[str, float]) -> Self:
        """Return it with these values of parameters."""
        return self._with(parameters=dict(self.known.fixed(values).given))

    def _with(self, **changes: Any) -> Self:
        """Return it with other fields, for other processes to make as before."""
        made = replace(self, **changes)  # type: ignore[type-var]
        return made.opened_by(vars(self).get("_opened_by"))

    def precise(self) -> Self:
        """Return it for derivatives; see `Adjustable`."""
        return self

    def opened_by(self, function: Callable[[Given], Self] | None) -> Self:
        """Return it, for other processes to make by a function of its parameters.

        What a file of the user's defines cannot be sent to them.
        """
        vars(self)["_opened_by"] = function
        return self

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Say how other processes make it."""
        function = vars(self).get("_opened_by")
        if function is None:
            return super().__reduce_ex__(protocol)
        return function, (dict(self.parameters or {}),)


@dataclass(frozen=True, eq=False, repr=False)
class Function(UserCode):
    """Call a Python function of time, whose parameters may be fitted to a record.

    Attributes
    ----------
    function : `function(time, u, p) -> (time,) or (time, ny)`, or without the last or the last two
        arguments: times in s `(time,)`, inputs `(time, nu)`, and parameters by name (`p.k`).
    key : Identifies it and its parameters in the cache of `run`; without one it is not cached.
    parameters : By name a number, or a range `(low, high)` in which it is fitted; p holds them in
        this order. Each record has its own of those whose names begin with `x0_`.
    """

    function: Callable[..., npt.ArrayLike]
    key: str | None = None
    parameters: Given | None = None

    states = 0
    difference = 1e-6

    @property
    def adjustable(self) -> bool:
        """Return whether it has to be fitted, or needs inputs: a `GreyBox` runs it."""
        return bool(self.known.given) or count_arguments(self.function) > 1

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s.

        A parameter with a range is in the middle of it.
        """
        return self._called(time, np.empty((len(time), 0)), self.known.middle())

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """See `Adjustable`: there are no states."""
        inputs = np.empty((len(time), 0)) if u is None else u
        found = []
        for values, _ in points:
            y = np.asarray(self._called(time, inputs, values), dtype=float)
            found.append((y[:, None] if y.ndim == 1 else y, np.empty((len(time), 0))))
        return found

    def fingerprint(self) -> str | None:
        """Return the cache key."""
        return None if self.key is None else f"{self.key} {self.known}".strip()

    def digest(self) -> str:
        """Return what its response depends on besides the parameters' values."""
        return self.key or code_digest(self.function)

    def _called(self, time: Array, u: Array, values: Mapping[str, float]) -> npt.ArrayLike:
        p = parameters_class(tuple(self.known.given))(*(values[n] for n in self.known.given))
        return self.function(*(time, u, p)[: count_arguments(self.function) or 1])
