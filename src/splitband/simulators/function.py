"""Use a Python function of time as a simulator; define the base class for user code."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from splitband.runtime.arrays import Array
from splitband.simulators.base import Start, check_start
from splitband.simulators.code import check_arguments, code_digest, count_arguments
from splitband.simulators.parameters import Adjustable, Given, Point, Response, parameters_class


class UserCode(Adjustable):
    """Define the base of dataclasses that hold user code."""

    @property
    @abstractmethod
    def _functions(self) -> Sequence[tuple[Any, Sequence[str]]]:
        """Return the user's functions, or None, each with the names of its arguments."""

    @property
    def code(self) -> list[Any]:
        """Return the user's functions."""
        return [function for function, _ in self._functions]

    @property
    def driven(self) -> bool:
        """Return whether it takes a record's inputs."""
        return any(count_arguments(each) > names.index("u") for each, names in self._functions)

    @property
    def needs_inputs(self) -> bool:
        """Return whether it takes inputs for no other reason than parameters after them."""
        return any(count_arguments(each) == names.index("p") for each, names in self._functions)

    def _check(self) -> None:
        """Raise ValueError for a wrong start, or arguments in another order."""
        check_start(self.start)
        for function, names in self._functions:
            check_arguments(function, *names)

    def _with(self, **changes: Any) -> Self:
        """Return a copy with changed fields, which other processes recreate as before."""
        made = replace(self, **changes)  # type: ignore[type-var]
        return made.opened_by(vars(self).get("_opened_by"))

    def opened_by(self, function: Callable[[Given], Self] | None) -> Self:
        """Set the function of the parameters by which other processes recreate it; return it.

        Functions from a user's file cannot be pickled.
        """
        vars(self)["_opened_by"] = function
        return self

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Return how other processes recreate it."""
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
    key : Identifier of the function in the cache of `run`; without a key nothing is cached.
    parameters : By name a number, or a range `(low, high)` in which it is fitted; p holds them in
        this order. Those whose names begin with `x0_` are fitted for each record separately.
    start : Time of a record's first sample in s, by default 0, or "record" for its time stamp. A
        function of time alone needs it where the record's clock does not begin at 0.
    """

    function: Callable[..., npt.ArrayLike]
    key: str | None = None
    parameters: Given | None = None
    start: Start | None = None

    def __post_init__(self) -> None:
        """Check the start and the order of the arguments."""
        self._check()

    @property
    def _functions(self) -> Sequence[tuple[Any, Sequence[str]]]:
        return [(self.function, ("time", "u", "p"))]

    def simulate(self, time: Array, u: Array | None = None) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s, with the inputs `(time, nu)`.

        A parameter with a range takes the middle of it.
        """
        inputs = np.empty((len(time), 0)) if u is None else u
        return self._called(time, inputs, self.known.middle())

    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> list[Response]:
        """Return the responses, without states, see `Adjustable`."""
        inputs = np.empty((len(time), 0)) if u is None else u
        found = []
        for values, _ in points:
            y = np.asarray(self._called(time, inputs, values), dtype=float)
            found.append((y[:, None] if y.ndim == 1 else y, np.empty((len(time), 0))))
        return found

    def fingerprint(self) -> str | None:
        """Return the cache key, or None without a `key`."""
        return None if self.key is None else f"{self.key} {self.known}".strip() + self._begins

    def digest(self) -> str | None:
        """Return an identifier of code and start; None for code that cannot be told."""
        code = self.key or code_digest(self.function)
        return None if code is None else code + self._begins

    @property
    def _begins(self) -> str:
        return f" from {self.start}" if self.start else ""

    def _called(self, time: Array, u: Array, values: Mapping[str, float]) -> npt.ArrayLike:
        p = parameters_class(tuple(self.known.given))(*(values[n] for n in self.known.given))
        return self.function(*(time, u, p)[: count_arguments(self.function) or 1])
