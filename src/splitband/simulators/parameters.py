"""Define simulators with parameters: fixed numbers, and ranges in which they are fitted."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Self

import numpy as np

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr

Given = Mapping[str, float | tuple[float, float]]
Point = tuple[Mapping[str, float], Any]
"""Values of all parameters, and the initial state; None for the simulator's own."""
Response = tuple[Array, Array]
"""Measured channels `(time, ny)` and states `(time, nx)`."""

INITIAL = "x0_"
"""Prefix of the names of initial values, which are fitted for each record separately."""
DECADE = 10.0
"""A range is searched on a logarithmic scale if its ends differ by more than this factor.
By eye."""


@cache
def parameters_class(names: tuple[str, ...]) -> Any:
    """Return the named-tuple class of the argument `p` of user functions.

    A value is `p.k` or, in code that is not compiled, `p["k"]`.
    """
    plain = namedtuple("p", names)  # type: ignore[misc]

    def item(self: Any, key: Any) -> Any:
        if not isinstance(key, str):
            return tuple.__getitem__(self, key)
        if key not in names:
            raise KeyError(f"no parameter {key}: there are {', '.join(names) or 'none'}")
        return getattr(self, key)

    return type("p", (plain,), {"__slots__": (), "__getitem__": item})


@dataclass(frozen=True)
class Parameters:
    """Hold the parameters of a simulator in their order.

    `given` maps each name to a number, or to the lower and upper end of a range. A range of
    positive numbers of more than a decade is searched on a logarithmic scale.
    """

    given: Given = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check names, numbers and ranges."""
        for name, value in self.given.items():
            if not isinstance(name, str) or not name:
                raise InputError(f"parameters must have names, got {name!r}")
            low, high = _ends(name, value)
            if not (math.isfinite(low) and math.isfinite(high)) or low > high:
                raise InputError(
                    f"parameters must be finite numbers or ranges (low, high) with low < high, "
                    f"got {name}={value!r}"
                )

    @property
    def free(self) -> tuple[str, ...]:
        """Return the names of the fitted parameters."""
        return tuple(name for name, value in self.given.items() if not _is_number(value))

    @property
    def shared(self) -> tuple[str, ...]:
        """Return the names of the fitted parameters that all records share."""
        return tuple(name for name in self.free if not name.startswith(INITIAL))

    @property
    def initial(self) -> tuple[str, ...]:
        """Return the names of the fitted initial values, separate for each record."""
        return tuple(name for name in self.free if name.startswith(INITIAL))

    def logarithmic(self, name: str) -> bool:
        """Return whether a parameter is searched on a logarithmic scale."""
        low, high = self.range(name)
        return low > 0 and high / low > DECADE

    def range(self, name: str) -> tuple[float, float]:
        """Return the ends of a parameter's range; they are equal for a fixed one."""
        return _ends(name, self.given[name])

    def value_at(self, name: str, fraction: float) -> float:
        """Return the value of a parameter at a relative position in its range, 0 to 1."""
        low, high = self.range(name)
        if self.logarithmic(name):
            return float(low * (high / low) ** fraction)
        return float(low + fraction * (high - low))

    def slope(self, name: str, fraction: float) -> float:
        """Return the derivative of the value with respect to its relative position."""
        low, high = self.range(name)
        if self.logarithmic(name):
            return self.value_at(name, fraction) * math.log(high / low)
        return high - low

    def middle(self) -> dict[str, float]:
        """Return every parameter as a number, a fitted one in the middle of its range."""
        return {name: self.value_at(name, 0.5) for name in self.given}

    def fixed(self, values: Mapping[str, float]) -> Parameters:
        """Return the parameters with some of them set to numbers."""
        unknown = [name for name in values if name not in self.given]
        if unknown:
            raise InputError(f"parameters must be out of {', '.join(self.given)}, got {unknown[0]}")
        return Parameters({**self.given, **values})

    @classmethod
    def read(cls, text: str) -> Parameters:
        """Parse ranges and numbers in the form `k=0.1:10,c=0.05`.

        Raises ValueError for another form.
        """
        given: dict[str, Any] = {}
        for part in filter(None, (each.strip() for each in text.split(","))):
            name, equals, said = (each.strip() for each in part.partition("="))
            try:
                ends = [float(end) for end in said.split(":")]
            except ValueError:
                ends = []
            if not equals or not name or len(ends) not in (1, 2) or name in given:
                raise InputError(
                    "parameters must be given as NAME=VALUE or NAME=LOW:HIGH, separated by commas, "
                    f"each once, got {part!r}"
                )
            given[name] = ends[0] if len(ends) == 1 else (ends[0], ends[1])
        return cls(given)

    def __str__(self) -> str:
        """Return the parameters in the form that `read` takes."""
        return ",".join(
            f"{name}={':'.join(map(_text, _ends(name, value)[: 1 if _is_number(value) else 2]))}"
            for name, value in self.given.items()
        )


def _text(value: float) -> str:
    """Return the shortest text that parses to the same number."""
    return repr(float(value)).removesuffix(".0")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _ends(name: str, value: Any) -> tuple[float, float]:
    if _is_number(value):
        return float(value), float(value)
    try:
        low, high = map(float, value)
    except (TypeError, ValueError):
        low, high = math.nan, math.nan
    if low == high:
        raise InputError(f"a range must have two different ends, got {name}={value!r}")
    return low, high


class Adjustable(WithRepr, ABC):
    """Define simulators whose parameters can be fitted.

    Attributes
    ----------
    parameters : By name a number, or a range `(low, high)`.
    start : Time of a record's first sample in s, "record" for its time stamp, or None.
    states : Number of states that a run can start from; 0 for a black box.
    difference : Finite-difference step, as a share of a parameter's range.
    advances : Whether `advance`, see `Ode`, goes on from a state as one long run does.
    """

    parameters: Given | None
    start: Any
    states = 0
    difference = 1e-6
    advances = False

    @cached_property
    def known(self) -> Parameters:
        """Return the parameters, checked."""
        return Parameters(dict(self.parameters or {}))

    @property
    @abstractmethod
    def driven(self) -> bool:
        """Return whether it takes a record's inputs."""

    @property
    def adjustable(self) -> bool:
        """Return whether it has parameters or needs inputs, and so a `GreyBox` to run it."""
        return bool(self.known.given) or self.driven

    @abstractmethod
    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> Sequence[Response]:
        """Return the responses at several neighbouring points; `u` is `(time, nu)`.

        Values that cannot be computed are NaN.
        """

    @abstractmethod
    def digest(self) -> str | None:
        """Return an identifier of the response, without the values of parameters, if it has one."""

    @abstractmethod
    def _with(self, **changes: Any) -> Self:
        """Return a copy with changed options."""

    def fixed(self, values: Mapping[str, float]) -> Self:
        """Return a copy with some parameters set to these values."""
        return self._with(parameters=dict(self.known.fixed(values).given))

    def precise(self) -> Self:
        """Return the simulator for the last steps of a fit and for standard errors."""
        return self

    def unfinished(self, time: float) -> str:
        """Return what is wrong where values are not finite from `time` in s on."""
        return f"the simulator must return finite values, got others from {time:g} s on"
