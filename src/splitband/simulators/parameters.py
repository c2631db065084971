"""Define simulators with parameters: fixed numbers, ranges to fit, and estimates.

An estimate has standard errors, and remarks on unidentifiable parameters.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, cached_property
from typing import Any, Self

import numpy as np
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr
from splitband.simulators.base import KnownSimulator
from splitband.simulators.unknown import Trained, Unknown

Given = Mapping[str, float | tuple[float, float]]
Point = tuple[Mapping[str, float], Any]
"""Values of all parameters, and the initial state; None for the simulator's own."""
Response = tuple[Array, Array]
"""Measured channels `(time, ny)` and states `(time, nx)`."""

INITIAL = "x0_"
"""Prefix of the names of initial values, which are fitted by record."""
DECADE = 10.0
"""Largest ratio of the ends of a range with a linear scale; wider ranges have a logarithmic one.
A convention."""
Name = tuple[str, int]
"""Name of a parameter, and number of its record; -1 for all records."""

AT_BOUND = 2e-3
"""Distance from a bound of a parameter at the bound, as a share of the range. Rounding."""
MAX_RELATIVE_ERROR = 0.25
"""Largest standard error of an identifiable direction, as a share of the range; a uniform
distribution over the range has 0.29. By eye."""
MIN_NOISE = 1e-3
"""Smallest assumed error of a model, in deviations of the record. Rounding."""
MIN_COMPONENT = 0.2
"""Smallest component of a direction with its parameter named in a remark. By eye."""
DECISIVE = 10.0
"""Least difference in BIC for very strong evidence (Kass and Raftery, 1995). A convention."""
_MOST_LAGS = 0.1
"""Longest lag of the residuals' autocorrelation, as a share of the samples. By eye."""


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
    """The parameters of a simulator in their order.

    `given` maps names to numbers, or to the lower and upper ends of ranges. A range of positive
    numbers over more than a decade is searched on a logarithmic scale.
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
        return tuple(name for name in self.given if len({*self.range(name)}) > 1)

    @property
    def shared(self) -> tuple[str, ...]:
        """Return the names of the fitted parameters common to all records."""
        return tuple(name for name in self.free if not name.startswith(INITIAL))

    @property
    def initial(self) -> tuple[str, ...]:
        """Return the names of the initial values, fitted by record."""
        return tuple(name for name in self.free if name.startswith(INITIAL))

    def logarithmic(self, name: str) -> bool:
        """Return whether a parameter is searched on a logarithmic scale."""
        low, high = self.range(name)
        return low > 0 and high / low > DECADE

    def range(self, name: str) -> tuple[float, float]:
        """Return the ends of a parameter's range, equal for a fixed parameter."""
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
        logarithmic = self.logarithmic(name)
        return self.value_at(name, fraction) * math.log(high / low) if logarithmic else high - low

    def step(self, name: str, value: float, share: float) -> float:
        """Return a step of a value, a share of its range, that does not leave the range."""
        low, high = self.range(name)
        width = value * math.log(high / low) if self.logarithmic(name) else high - low
        step = share * width
        return step if value + step <= high else -step

    def middle(self) -> dict[str, float]:
        """Return all parameters as numbers, fitted ones in the middle of their ranges."""
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
        parameters: dict[str, Any] = {}
        for part in filter(None, (piece.strip() for piece in text.split(","))):
            name, equals, value = (piece.strip() for piece in part.partition("="))
            try:
                ends = [float(end) for end in value.split(":")]
            except ValueError:
                ends = []
            if not equals or not name or len(ends) not in (1, 2) or name in parameters:
                raise InputError(
                    "parameters must be given as NAME=VALUE or NAME=LOW:HIGH, separated by commas, "
                    f"each once, got {part!r}"
                )
            parameters[name] = ends[0] if len(ends) == 1 else (ends[0], ends[1])
        return cls(parameters)

    def __str__(self) -> str:
        """Return the parameters in the form of `read`."""
        texts = []
        for name in self.given:
            ends = [repr(end).removesuffix(".0") for end in dict.fromkeys(self.range(name))]
            texts.append(f"{name}={':'.join(ends)}")
        return ",".join(texts)


def _ends(name: str, value: Any) -> tuple[float, float]:
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return float(value), float(value)
    try:
        low, high = map(float, value)
    except (TypeError, ValueError):
        low, high = math.nan, math.nan
    if low == high:
        raise InputError(f"a range must have two different ends, got {name}={value!r}")
    return low, high


class Adjustable(WithRepr, KnownSimulator, ABC):
    """A simulator with parameters to fit.

    Attributes
    ----------
    parameters : By name a number, or a range `(low, high)`.
    states : Number of states of an initial state; 0 for a black box.
    difference : Finite-difference step, as a share of a parameter's range.
    survives : Whether no run can end its process.
    remarks : Remarks on the runs after `precise`.
    """

    parameters: Given | None
    states = 0
    difference = 1e-6
    survives = False
    remarks: Sequence[str] = ()

    @cached_property
    def known(self) -> Parameters:
        """Return the parameters, checked."""
        return Parameters(dict(self.parameters or {}))

    @property
    @abstractmethod
    def driven(self) -> bool:  # type: ignore[override]
        """Return whether the simulator takes a record's inputs."""

    def initial(self, values: Mapping[str, float]) -> Array:
        """Return the state at the record's first sample, `(states,)`."""
        return np.empty(0)

    @property
    def resolved_terms(self) -> Sequence[Unknown]:
        """Return the unknown terms, as functions of states and inputs."""
        return ()

    @property
    def weights(self) -> Array:
        """Return the weights of the unknown terms, one after another."""
        return np.empty(0)

    def weighted(self, weights: Array) -> Self:
        """Return a copy with these weights of the unknown terms."""
        return self

    @property
    def adjustable(self) -> bool:  # type: ignore[override]
        """Return whether the simulator has parameters or needs inputs, and so a `GreyBox`."""
        return bool(self.known.given) or self.driven

    @abstractmethod
    def respond(self, time: Array, u: Array | None, points: Sequence[Point]) -> Sequence[Response]:
        """Return the responses at several neighbouring points; `u` is `(time, nu)`.

        Failed values are NaN.
        """

    def derivatives(
        self, time: Array, u: Array | None, point: Point, names: Sequence[str]
    ) -> tuple[Array, Array, Array, Array]:
        """Return channels and states at a point, and their derivatives.

        By the parameters of these names, by the initial state and by the weights of unknown
        terms, one after another, `(time, ny, n)` and `(time, nx, n)`; by default they are
        differences of whole responses.
        """
        values, state = point
        ((y, x),) = self.respond(time, u, [point])
        sizes = np.abs(np.where(np.isfinite(x), x, 0.0)).max(axis=0, initial=0.0)
        moved: list[Point] = []
        steps: list[float] = []
        for name in names:
            steps.append(self.known.step(name, values[name], self.difference))
            moved.append(({**values, name: values[name] + steps[-1]}, state))
        for i in range(self.states):
            steps.append(self.difference * (sizes[i] or 1.0))
            moved.append((values, state + steps[-1] * (np.arange(self.states) == i)))
        others = [*self.respond(time, u, moved)] if moved else []
        for i in range(len(self.weights)):
            steps.append(self.difference)
            beside = self.weights + steps[-1] * (np.arange(len(self.weights)) == i)
            others += self.weighted(beside).respond(time, u, [point])
        pairs = [*zip(others, steps, strict=True)]
        dy, dx = (
            np.stack([np.zeros_like(at), *((other[i] - at) / step for other, step in pairs)], -1)
            for i, at in enumerate((y, x))
        )
        return y, x, dy[..., 1:], dx[..., 1:]

    @abstractmethod
    def _with(self, **changes: Any) -> Self:
        """Return a copy with changed options."""

    def fixed(self, values: Mapping[str, float]) -> Self:
        """Return a copy with some parameters set to these values."""
        return self._with(parameters=dict(self.known.fixed(values).given))

    def coarse(self) -> Self:
        """Return the simulator for a search."""
        return self

    def precise(self) -> Self:
        """Return the simulator for the last steps of a fit and for standard errors."""
        return self

    def otherwise(self) -> Any:
        """Return a copy with the other course of inputs between samples; None without one."""
        return None

    def unfinished(self, time: float) -> str:
        """Return the message for non-finite values from `time` in s on."""
        return f"the simulator must return finite values, got others from {time:g} s on"


# ---------------------------------------------------------------- estimates


@dataclass(frozen=True, eq=False)
class Estimate:
    """The values of fitted parameters, with standard errors.

    Attributes
    ----------
    values : Values by name; initial values of further records as `x0_1, record 2`.
    errors : Standard errors, corrected for the autocorrelation of the residuals; NaN for parameters
        at a bound or not identifiable.
    correlations : Correlations of the estimated values, `(n, n)`, in their order; NaN as above.
    rmse : RMSE by channel over the training samples.
    remarks : Parameters not identifiable or at a bound, and other fits as good.
    window : Samples of the windows of the simulation; 0 for the whole record.
    terms, members : States of the trained unknown terms, and of further trainings that fit as
        well, one training after another.
    starts : Number of starting points with the same fit, and of all fitted ones.
    cut : Whether the deadline passed before the last starting point.
    doubt : Sentence on the other course of inputs between samples, if the record favours it.
    """

    values: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    correlations: Array = field(default_factory=lambda: np.empty((0, 0)))
    rmse: tuple[float, ...] = ()
    remarks: tuple[str, ...] = ()
    window: int = 0
    starts: tuple[int, int] = (0, 0)
    cut: bool = False
    doubt: str = ""
    terms: tuple[Trained, ...] = ()
    members: tuple[Trained, ...] = ()

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        if (
            not np.isfinite([*self.values.values()]).all()
            or self.values.keys() != self.errors.keys()
        ):
            raise InputError(f"an estimate must have finite values with errors, got {self.values}")

    def __str__(self) -> str:
        """Return the values with their standard errors, the doubt and the remarks."""
        remarks = [*filter(None, [self.doubt]), *self.remarks]
        pairs = self.values.items()
        lines = [f"{name} = {_rounded(value, self.errors[name])}" for name, value in pairs]
        return "; ".join([", ".join(lines), *remarks] if lines else remarks)

    def as_json(self) -> dict[str, Any]:
        """Return the content of result files."""
        return {
            "values": self.values,
            "standard_errors": {k: None if np.isnan(e) else e for k, e in self.errors.items()},
            "correlations": [
                [None if np.isnan(c) else round(float(c), 4) for c in row]
                for row in self.correlations
            ],
            "doubt": self.doubt or None,
            "remarks": [*self.remarks],
            "window": self.window or None,
            "starts_that_agree": self.starts[0],
            "starts": self.starts[1],
        }


def _rounded(value: float, error: float) -> str:
    if not np.isfinite(error) or error <= 0:
        return f"{value:.4g}"
    digits = int(np.floor(np.log10(error)))
    decimals = max(1 - digits, 0)
    if abs(value) < 1e5 and decimals < 8:
        return f"{value:.{decimals}f} ± {error:.{decimals}f}"
    return f"{value:.5g} ± {error:.2g}"


def uncertainty(
    names: Sequence[Name],
    parameters: Parameters,
    fractions: Array,
    errors: Array,
    information: Array,
) -> tuple[Array, Array, list[str]]:
    """Return the standard errors of fitted values, their correlations, and remarks.

    Parameters at a bound or not identifiable have NaN.

    Parameters
    ----------
    names, parameters : Names of the fitted parameters, and all parameters.
    fractions : Positions of the fitted parameters in their ranges, 0 to 1, `(n,)`.
    errors : `(samples, ny)`, in units of the noise; NaN in gaps.
    information : Normal matrix of the `fractions`, in units of the noise, with all else optimal,
        `(n, n)`.
    """
    at_bound, remarks = np.zeros(len(fractions), dtype=bool), []
    for i, (name, fraction) in enumerate(zip(names, fractions, strict=True)):
        at_bound[i] = not AT_BOUND <= fraction <= 1 - AT_BOUND
        if at_bound[i]:
            side, end = ("upper", 1) if fraction > 0.5 else ("lower", 0)
            bound = parameters.range(name[0])[end]
            remarks.append(f"{labelled(name)} is at its {side} bound, {bound:.4g}")
    slopes = np.array([parameters.slope(n, p) for (n, _), p in zip(names, fractions, strict=True)])
    free = np.flatnonzero(~at_bound)
    strengths, directions = np.linalg.eigh(information[np.ix_(free, free)])
    known = strengths > 1 / MAX_RELATIVE_ERROR**2
    factor = directions[:, known] / np.sqrt(strengths[known])
    measured = int((~np.isnan(errors)).sum())
    variance = float(np.nansum(errors**2)) / max(measured - len(fractions), 1)
    covariance = np.full((len(fractions), len(fractions)), np.nan)
    covariance[np.ix_(free, free)] = factor @ factor.T * variance * _correlated(errors)
    for direction in directions[:, ~known].T:
        involved = np.flatnonzero(np.abs(direction) > MIN_COMPONENT)
        lost = free[involved]
        covariance[lost] = covariance[:, lost] = np.nan
        values = np.array([parameters.value_at(names[i][0], fractions[i]) or 1.0 for i in lost])
        changes = direction[involved] * slopes[lost] / values
        remarks.append(_remark([labelled(names[i]) for i in lost], changes))
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlations = covariance / np.outer(deviations, deviations)
        pairs = np.argwhere(np.triu(np.abs(correlations) > 0.99, 1))
    remarks += [
        f"{labelled(names[i])} and {labelled(names[j])} are correlated by {correlations[i, j]:.3f}"
        for i, j in pairs
    ]
    return deviations * np.abs(slopes), correlations, remarks


def favours(residuals: Array, others: Array) -> bool:
    """Return whether the residuals of another fit, with as many parameters, are decisively smaller.

    The difference in BIC is that of the log likelihoods. Residuals are `(samples, ny)` in
    deviations of the channels, NaN in gaps; correlated ones count for fewer samples.
    """
    samples = (~np.isnan(residuals)).sum(axis=0) / _correlated(residuals)
    squares = [np.nanmean(errors**2, axis=0) for errors in (residuals, others)]
    before, after = np.maximum(squares, MIN_NOISE**2)
    return bool((samples * np.log(before / after)).sum() > DECISIVE)


def _correlated(residuals: Array) -> float:
    """Return the number of residual samples per independent sample, at least 1."""
    most = 1.0
    for channel in residuals.T:
        r = channel[~np.isnan(channel)]
        n = len(r)
        if n < 20 or not np.any(r):
            continue
        lags = max(int(_MOST_LAGS * n), 1)
        products = scipy.signal.correlate(r, r, method="fft")[n - 1 :]
        rho = products[1 : lags + 1] / products[0]
        insignificant = np.flatnonzero(rho < 3 / np.sqrt(n))
        end = int(insignificant[0]) if len(insignificant) else lags
        most = max(most, 1 + 2 * float(rho[:end].sum()))
    return most


def labelled(name: Name) -> str:
    """Return the name of a parameter for messages."""
    return name[0] if name[1] < 1 else f"{name[0]}, record {name[1] + 1}"


def _remark(names: Sequence[str], changes: Array) -> str:
    """Return a remark about a direction with relative `changes` of the values."""
    if len(names) == 1:
        return f"the record does not tell {names[0]}: its value does not matter"
    sentence = f"the record does not tell {', '.join(names[:-1])} and {names[-1]} apart"
    if len(names) > 2 or abs(abs(changes[0] / changes[1]) - 1) > 0.1:
        return sentence
    return f"{sentence}: only their {'product' if changes[0] * changes[1] < 0 else 'ratio'} matters"
