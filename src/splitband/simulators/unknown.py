"""Define unknown terms of an equation: small networks of quantities of its states and inputs.

A term is `w = g(z)` with one hidden layer, `g(z) = V tanh(W s + b) + c`, where `s` are the
quantities `z`, less their centre and divided by their width. An odd term is `g(z) - g(-z)`, an
increasing one has the squares of its weights V and W (Sill, Monotonic Networks, NIPS 1997). Outside
the range in training, each unit goes on along its tangent.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.metrics import BEYOND
from splitband.records.signals import bare_name
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr
from splitband.simulators.user_code import count_arguments

_POINTS = 101
"""Points of a curve. Layout."""


@dataclass(frozen=True, eq=False)
class Trained:
    """The state of a trained term.

    Attributes
    ----------
    weights : Weights of the network, `(weights,)`: W, b, V, and c unless the term is odd.
    centre, width : Of each quantity, `(quantities,)`.
    scale : Of each output, `(outputs,)`.
    low, high : Range of each quantity in the training record, `(quantities,)`, from whose ends the
        term goes on straight; infinite if it is not known yet.
    """

    weights: Array
    centre: Array
    width: Array
    scale: Array
    low: Array
    high: Array

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        count = len(np.atleast_1d(self.centre))
        for name in ("centre", "width", "low", "high"):
            check_shape(name, getattr(self, name), count)
        finite = self.weights, self.centre, self.width, self.scale
        if not (all(np.isfinite(a).all() for a in finite) and (self.width > 0).all()):
            raise InputError("an unknown term must have finite weights and positive widths")
        if not (self.low <= self.high).all():
            raise InputError("an unknown term must have low <= high")

    def clipped(self, z: Array) -> Array:
        """Return quantities `(..., quantities)`, clipped to the range of the training record."""
        known = np.isfinite(self.low).all() and np.isfinite(self.high).all()
        return np.clip(z, self.low, self.high) if known else z


@dataclass(frozen=True, eq=False, repr=False)
class Unknown(WithRepr):
    """An unknown term of an `Ode`: a network that is trained with the equation's parameters.

    Attributes
    ----------
    of : `of(x, u)` returns the quantities of which the term is a function, as a list, from the
        states x and the inputs u at one time; it is written with NumPy. Or their names: "x1",
        "x2", ... for states, or those of a record's inputs and of the channels that are states.
        By default all states and inputs.
    outputs : Number of outputs.
    hidden : Number of hidden units; 0 for a term that stays as before training.
    odd : Whether the term changes its sign with that of all quantities, as friction does.
    increasing : Whether each output increases with each quantity.
    bounded : Range `(low, high)` of the outputs.
    names : Names of the quantities with units for messages and drawings, such as "speed [m/s]".
    trained : State of the trained term. A fit keeps a given state, and trains a term that has
        none. Before training, a term is 0, or the middle of `bounded` if that excludes 0.

    Examples
    --------
    A mass on a spring, with a friction of which only the sign is known.

    >>> def sliding(t, x, u, p, w):
    ...     return [x[1], (u[0] - p.k * x[0] - w[0]) / 2.0]
    >>> friction = sb.Unknown(lambda x, u: [x[1]], odd=True, increasing=True)
    >>> rig = sb.Ode(sliding, [0.1, 0.0], parameters={"k": (1, 100)}, unknown=friction)
    """

    of: Callable[[Any, Any], Any] | Sequence[str] | None = None
    outputs: int = 1
    hidden: int = 8
    odd: bool = False
    increasing: bool = False
    bounded: tuple[float, float] | None = None
    names: Sequence[str] = ()
    trained: Trained | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check the options, and the state of a trained term."""
        named = isinstance(self.of, tuple | list) and all(isinstance(n, str) for n in self.of)
        if not (self.of is None or (named and self.of) or count_arguments(self.of) == 2):
            raise InputError(
                "of must be a function of (x, u) that returns a list of quantities, such as "
                f'lambda x, u: [x[1]], or names such as ["x2"], got {self.of!r}'
            )
        for name, least in (("outputs", 1), ("hidden", 0)):
            if not isinstance(number := getattr(self, name), int) or number < least:
                raise InputError(f"{name} must be a whole number from {least} on, got {number!r}")
        if self.bounded is not None:
            low, high = (*self.bounded,) if np.shape(self.bounded) == (2,) else (np.nan, np.nan)
            if not (np.isfinite([low, high]).all() and low < high):
                raise InputError(
                    f"bounded must be two numbers (low, high) with low < high, got {self.bounded!r}"
                )
            if self.odd and low != -high:
                raise InputError(
                    "bounded must be symmetric, (-high, high), for an odd term, got "
                    f"{self.bounded!r}"
                )
        if isinstance(self.names, str):
            raise InputError(f"names must be a sequence of texts, got {self.names!r}")
        if (trained := self.trained) is not None:
            count = len(trained.centre)
            check_shape("weights", trained.weights, self.size(count))
            check_shape("scale", trained.scale, self.outputs)
            if self.names and len(self.names) != count:
                raise InputError(
                    f"names must be one for each of the {count} quantities, got {self.names!r}"
                )

    @property
    def free(self) -> bool:
        """Return whether a fit trains the term."""
        return self.trained is None and self.hidden > 0

    def without(self) -> Self:
        """Return the term as it is before training, and stays."""
        return replace(self, hidden=0, trained=None)

    def resolved(self, states: int, columns: Sequence[str], inputs: Sequence[str]) -> Self:
        """Return the term with a function in place of the names of quantities.

        Parameters
        ----------
        states : Number of states.
        columns : Names of the channels, if these are the first states, else none.
        inputs : Names of the inputs.

        Raises
        ------
        ValueError
            For a name that is neither a state nor an input.
        """
        if callable(self.of):
            return self
        numbers = [f"x{i + 1}" for i in range(states)]
        labels = [*columns, *numbers[len(columns) :], *inputs]
        if self.of is None:
            return replace(self, names=tuple(labels)) if columns and not self.names else self
        places: list[int] = []
        for name in self.of:
            means = {i for i, at in enumerate(numbers) if at == name}
            means |= {i for i, label in enumerate(labels) if name in (label, bare_name(label))}
            if len(means) != 1:
                raise InputError(
                    f"of (--unknown) must name states, {', '.join(numbers)}, or inputs of the "
                    f"record, {', '.join(inputs) or 'of which there are none'}: got {name}"
                    + (", which names several" if means else "")
                )
            places += means
        named = self.names or tuple(labels[place] for place in places)
        return replace(self, of=Chosen(tuple(places)), names=named)

    def size(self, quantities: int) -> int:
        """Return the number of weights of a term of so many quantities."""
        units = self.hidden * (quantities + 1 + self.outputs)
        return units if self.odd else units + self.outputs

    def quantities(self, x: Array, u: Array | None) -> Array:
        """Return the quantities at states `(time, nx)` and inputs `(time, nu)`.

        Returns
        -------
        Array
            `(time, quantities)`.
        """
        u = np.empty((len(x), 0)) if u is None else u
        rows = [np.asarray(self._of(*row), dtype=float) for row in zip(x, u, strict=True)]
        if rows[0].ndim != 1 or not rows[0].size:
            raise InputError(
                "of must return a list of quantities, such as [x[1]], got the shape "
                f"{rows[0].shape}"
            )
        return np.stack(rows)

    def begun(self, z: Array, scale: npt.ArrayLike = 1.0, seed: int = 0) -> Trained:
        """Return the state at the beginning of a training: a term of nearly 0.

        The hidden units are spread over the range of the quantities (Nguyen and Widrow, 1990).

        Parameters
        ----------
        z : Quantities on the training record, `(time, quantities)`.
        scale : Of the outputs, `(outputs,)` or a number.
        seed : Of the random weights.
        """
        rng, count = np.random.default_rng(seed), z.shape[1]
        low, high = _range(z, self.odd)
        first = rng.normal(size=(self.hidden, count))
        steep = 0.7 * self.hidden ** (1 / count)
        first *= steep / np.linalg.norm(first, axis=1, keepdims=True)
        bias = steep * rng.uniform(-1, 1, self.hidden)
        second, last = np.zeros((self.outputs, self.hidden)), np.zeros(self.outputs)
        if self.increasing:  # of the squares, of which 0 is a stationary point
            first, second = np.sqrt(np.abs(first)), np.full(second.shape, 0.1)
        parts = [first, bias, second, *([] if self.odd else [last])]
        width = 0.5 * (high - low)
        return Trained(
            np.concatenate([part.ravel() for part in parts]),
            0.5 * (high + low),
            np.where(width > 0, width, 1.0),
            np.full(self.outputs, scale, dtype=float),
            np.full(count, -np.inf),
            np.full(count, np.inf),
        )

    def holding(self, z: Array) -> Self:
        """Return a trained term that goes on straight outside the range of `(time, nz)`."""
        assert self.trained is not None
        low, high = _range(z, self.odd)
        return replace(self, trained=replace(self.trained, low=low, high=high))

    def value(self, z: Any) -> Any:
        """Return the outputs `(..., outputs)` for quantities `(..., quantities)`.

        It is the definition, in traceable code (`runtime.tracing`).
        """
        trained = self.trained
        if trained is None:
            return self._squashed(np.zeros(self.outputs))
        count = len(trained.centre)
        cuts = np.cumsum([self.hidden * count, self.hidden, self.hidden * self.outputs])
        first, bias, second, last = np.split(trained.weights, cuts)
        first, second = first.reshape(-1, count), second.reshape(self.outputs, -1)
        if self.increasing:
            first, second = first**2, second**2
        end = trained.clipped(z)
        total = ((end - trained.centre) / trained.width) @ first.T
        along = ((z - end) / trained.width) @ first.T
        units = np.tanh(bias + total)
        units = units + (1 - units**2) * along
        if self.odd:
            mirrored = np.tanh(bias - total)
            units = units - mirrored + (1 - mirrored**2) * along
        found = units @ second.T
        return self._squashed((found if self.odd else found + last) * trained.scale)

    def at(self, x: Any, u: Any) -> Any:
        """Return the outputs, `(outputs,)`, for states `(nx,)` and inputs `(nu,)`; traceable."""
        if self.trained is None:
            return self.value(None)
        quantities = self._of(x, u)
        if len(quantities) != len(self.trained.centre):
            raise InputError(
                f"of must return {len(self.trained.centre)} quantities, as in training, got "
                f"{len(quantities)}"
            )
        return self.value(np.stack([quantities[i] for i in range(len(quantities))]))

    def curve(
        self,
        quantity: int,
        at: npt.ArrayLike | None = None,
        z: npt.ArrayLike | None = None,
        members: Sequence[Trained] = (),
    ) -> UnknownCurve:
        """Return the outputs over one quantity, see `GreyBox.unknown_curve`.

        `members` are the states of further trainings.
        """
        assert self.trained is not None
        low, high, count = self.trained.low, self.trained.high, len(self.trained.centre)
        known, middle = np.isfinite(high - low), self.trained.centre
        with np.errstate(invalid="ignore"):
            middle = np.where(known, 0.5 * (low + high), middle)
        others = middle if at is None else np.asarray(at, dtype=float)
        check_shape("at", others, count)
        if not 0 <= quantity < count:
            raise InputError(f"quantity must be from 0 to {count - 1}, got {quantity}")
        if z is None and not known[quantity]:
            raise InputError(f"z must be given: the range of {self.label(quantity)} is not known")
        ends = float(low[quantity]), float(high[quantity])
        along = np.linspace(*ends, _POINTS) if z is None else np.atleast_1d(np.asarray(z, float))
        every = np.tile(others, (len(along), 1))
        every[:, quantity] = along
        each = [replace(self, trained=state).value(every) for state in (self.trained, *members)]
        found, names = np.stack(each), {self.label(i): float(x) for i, x in enumerate(others)}
        del names[self.label(quantity)]
        return UnknownCurve(
            self.label(quantity),
            ends,
            along,
            each[0],
            found.min(axis=0),
            found.max(axis=0),
            len(each),
            names,
        )

    def leaves(self, x: Array, u: Array | None) -> list[str]:
        """Return sentences on quantities that leave their range in training, at states and inputs.

        `x` and `u` are `(time, nx)` and `(time, nu)`.
        """
        if self.trained is None:
            return []
        z, sentences = self.quantities(x, u), []
        low, high = self.trained.low, self.trained.high
        excess = np.maximum(low - z, z - high)
        for i in np.flatnonzero(excess.max(axis=0) > BEYOND * (high - low)):
            n, ends = int(excess[:, i].argmax()), f"{low[i]:.4g} to {high[i]:.4g}"
            sentences.append(
                f"{self.label(int(i))} of an unknown term is {z[n, i]:.4g} at sample {n + 1} of "
                f"the prediction, where it was {ends} in training: the term is not known there"
            )
        return sentences

    def ranges(self) -> dict[str, tuple[float, float]]:
        """Return the ranges in training of the quantities of a trained term, by name."""
        if self.trained is None:
            return {}
        ends = zip(self.trained.low.tolist(), self.trained.high.tolist(), strict=True)
        return {self.label(i): each for i, each in enumerate(ends)}

    def __str__(self) -> str:
        """Return a description of a trained term."""
        each = (
            f"{name} from {low:.4g} to {high:.4g}" for name, (low, high) in self.ranges().items()
        )
        return f"an unknown term of {', '.join(each)}"

    def label(self, quantity: int) -> str:
        """Return the name of a quantity in messages and drawings."""
        return self.names[quantity] if self.names else f"quantity {quantity + 1}"

    def _of(self, x: Any, u: Any) -> Any:
        return self.of(x, u) if callable(self.of) else np.concatenate([x, u])

    def _squashed(self, value: Any) -> Any:
        """Return values within `bounded`, with the slope 1 at 0."""
        if self.bounded is None:
            return value
        low, high = self.bounded
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
        zero = -middle / half if low < 0 < high else 0.0
        steep = 1 / (half * (1 - zero**2))
        return middle + half * np.tanh(np.arctanh(zero) + value * steep)


@dataclass(frozen=True, eq=False)
class UnknownCurve:
    """The outputs of a trained term over one of its quantities.

    Attributes
    ----------
    quantity : Name of the quantity.
    range : Its lowest and highest value in training, outside which the term is not known.
    z, w : Values of the quantity `(points,)`, and the outputs there, `(points, outputs)`.
    low, high : Lowest and highest outputs of all trainings that fit as well, `(points, outputs)`.
    trainings : Number of these trainings.
    others : Values of the other quantities, by name.
    """

    quantity: str
    range: tuple[float, float]
    z: Array
    w: Array
    low: Array
    high: Array
    trainings: int
    others: dict[str, float]

    def to_frame(self) -> pd.DataFrame:
        """Return a table: outputs, and their lowest and highest values, over the quantity."""
        columns = {f"w{o}": w for o, w in enumerate(self.w.T)}
        for end, values in (("low", self.low), ("high", self.high)):
            columns |= {f"w{o} {end}": w for o, w in enumerate(values.T)}
        return pd.DataFrame(columns, index=pd.Index(self.z, name=self.quantity))


@dataclass(frozen=True)
class Chosen:
    """A function of (x, u): the elements at some places of the states and inputs."""

    places: tuple[int, ...]

    def __call__(self, x: Any, u: Any) -> Any:
        """Return the elements, `(places,)`; traceable."""
        return np.concatenate((x, u))[np.array(self.places)]


def packed(terms: Sequence[Unknown]) -> tuple[Array, Array, Any]:
    """Return weights, scaling and layout of terms, as `kernels.terms.evaluate` takes them.

    The weights are those of all terms, one after another; a term before training has none.
    """
    theta, scaling, layout = [np.empty(0)], [], []
    for term in terms:
        bounds = np.array(term.bounded or (0.0, 0.0), dtype=float)
        none = np.empty(0)
        given = term.trained or Trained(none, none, none, np.ones(term.outputs), none, none)
        hidden = term.hidden if term.trained else 0
        theta.append(given.weights)
        scaling += [given.centre, given.width, given.low, given.high, given.scale, bounds]
        flags = term.odd, term.increasing, term.bounded is not None
        layout.append([len(given.centre), hidden, term.outputs, *map(int, flags)])
    joined = np.concatenate(scaling) if scaling else np.empty(0)
    return np.concatenate(theta), joined, np.array(layout, dtype=np.int64).reshape(-1, 6)


def _range(z: Array, odd: bool) -> tuple[Array, Array]:
    """Return the ends of the range of quantities, symmetric for an odd term."""
    low, high = np.nanmin(z, axis=0), np.nanmax(z, axis=0)
    if odd:
        high = np.maximum(np.abs(low), np.abs(high))
        low = -high
    return low, high
