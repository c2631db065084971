"""Define a state-space network in innovations form: a linear model and layers of tanh units."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from splitband.networks import plain
from splitband.networks.cell import are_plain, check_sizes
from splitband.networks.in_numpy import dense, linear, values
from splitband.networks.layers import Tensor, nn, torch
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.optional import has_torch
from splitband.runtime.options import WithRepr

if TYPE_CHECKING:
    from splitband.linear.model import Realisation

_RADIUS = 0.95
"""Absolute value of the poles of a cell with random weights. Checked by halving and doubling.
"""
_TURN = 0.3
"""Standard deviation of the random rotation angles, in radians per sample. Checked by
halving and doubling."""
_OBSERVED = 0.5
"""Share of a prediction error by which the initial observer corrects the output. By eye."""
MOST_LAYERS = 100
"""Largest number of layers of f and of g. A saved cell with more is forged: building it would take
long."""
MOST_ENCODED = 10
"""Largest number of warm-up samples in the estimate of the first state. Bounds the time."""
_NONLINEAR = 0.1
"""Factor on torch's initial output weights of f and g, and once more on those of a cell with the
weights of a linear model; 0 would make all units equal. By eye."""


class StateSpace(WithRepr, nn.Module):
    """A linear state-space model with a layer of tanh units in both equations.

    x_{n+1} = A x_n + B u_n + f(x_n, u_n) + a + K e_n and y_{n+1} = C x_{n+1} + D u_n +
    g(x_{n+1}, u_n) + c, where u_n is the row of inputs for the step from n to n + 1. With
    feedthrough the row has the inputs of both samples (see `base.with_next_input`), so that the
    output depends on the input at its own time. f and g are weighted sums of tanh units.

    e_n is the fed sample minus the predicted one. In the warm-up, K makes the cell an observer of
    the measured system. In a free run the fed sample is the predicted one and e_n is exactly zero:
    the cell simulates. The state of the cell is x and the predicted y, side by side.

    The state at the first sample of the warm-up is a trained affine map of the first `encoded`
    samples and inputs. The prediction of the first sample uses the first row of inputs in place of
    an earlier one.

    Parameters
    ----------
    states : Size of x.
    hidden : Tanh units of a layer; 0 for a linear model.
    ny : Measured channels.
    nu : Known inputs in a row.
    layers : Hidden layers of f and of g. The compiled kernel has one.
    encoded : Warm-up samples in the estimate of the first state; 0 for a trained constant.

    Raises
    ------
    ValueError
        For sizes that are no whole numbers, or too small.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> settings = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    >>> sb.Single(sb.StateSpace(2, 4), settings).fit(record, seed=0).predict(20).y.shape
    (20, 1)
    """

    label, words = "state-space", "state-space network"

    def __init__(
        self,
        states: int = 4,
        hidden: int = 8,
        ny: int = 1,
        nu: int = 0,
        layers: int = 1,
        encoded: int = 0,
    ) -> None:
        super().__init__()
        check_sizes(nu, ny=ny, states=states)
        whole("layers", layers, 1, MOST_LAYERS)
        if hidden < 0:
            raise InputError(f"hidden must not be negative, got {hidden}")
        self.ny, self.nu, self.states, self.hidden, self.layers = ny, nu, states, hidden, layers
        self.encoded = whole("encoded", encoded, 0)
        self.f, self.g = (self._layers(states + nu) for _ in range(2))
        self.transition = nn.Linear(states + nu + hidden, states)
        """[A, B, the weights of f] and a."""
        self.observation = nn.Linear(states + nu + hidden, ny)
        """[C, D, the weights of g] and c."""
        self.gain = nn.Parameter(torch.empty(states, ny))
        """K."""
        self.first = nn.Parameter(torch.zeros(states, encoded * (ny + nu)))
        self.first_bias = nn.Parameter(torch.zeros(states))
        """Weights and biases of the map to the state at the first sample."""
        if has_torch():  # else the weights are those of a saved cell
            self._begin()

    def sized(self, ny: int, nu: int, warmup: int) -> StateSpace:
        """Return a new cell with as many states, units and layers, for warm-ups of this length."""
        encoded = min(warmup, MOST_ENCODED)
        return StateSpace(self.states, self.hidden, ny, nu, self.layers, encoded)

    def variants(self) -> list[StateSpace]:
        """Return templates of this size, with fewer, and with more states and units."""
        n, units = self.states, self.hidden
        sizes = (n, units), (n + 2, units + units // 2), (max(1, n // 2), units), (n, 2 * units)
        return [StateSpace(*size, self.ny, self.nu, self.layers) for size in sizes]

    def set_linear(
        self,
        a: npt.ArrayLike,
        b: npt.ArrayLike,
        c: npt.ArrayLike,
        d: npt.ArrayLike,
        k: npt.ArrayLike | None = None,
    ) -> None:
        """Make the cell a linear model, in place: f, g and the offsets become zero.

        The hidden layers keep their weights, as a start for training.

        Parameters
        ----------
        a, b, c, d : `(states, states)`, `(states, nu)`, `(ny, states)` and `(ny, nu)`. In a model
            with feedthrough a row is [u_n, u_{n+1}]: B is then [B, 0] and D is [0, D].
        k : Gain of the observer `(states, ny)`; by default zero.

        Raises
        ------
        ValueError
            For a matrix of another shape.
        """
        shapes = {
            "a": (self.states, self.states),
            "b": (self.states, self.nu),
            "c": (self.ny, self.states),
            "d": (self.ny, self.nu),
            "k": (self.states, self.ny),
        }
        gain = np.zeros(shapes["k"]) if k is None else k
        matrices = {
            name: np.asarray(values, dtype=np.float64)
            for name, values in zip(shapes, (a, b, c, d, gain), strict=True)
        }
        for name, shape in shapes.items():
            if matrices[name].shape != shape:
                raise InputError(f"{name} must be {shape}, got {matrices[name].shape}")
        with torch.no_grad():
            for layer, parts in ((self.transition, "ab"), (self.observation, "cd")):
                linear = np.concatenate([matrices[part] for part in parts], axis=1)
                layer.weight.zero_()
                layer.weight[:, : self.states + self.nu] = torch.from_numpy(linear)
                layer.bias.zero_()
            self.gain.copy_(torch.from_numpy(matrices["k"]))

    def begin_linear(self, model: Realisation, first: tuple[Array, Array] | None = None) -> None:
        """Begin as a linear model, in place, with small output weights of f and g.

        Parameters
        ----------
        model : Its B and D have a column for every input of a row.
        first : Weight and bias of the map from the `encoded` samples to the first state.
        """
        units = slice(self.states + self.nu, None)
        layers = self.transition, self.observation
        weights = [_NONLINEAR * layer.weight.detach()[:, units] for layer in layers]
        self.set_linear(model.a, model.b, model.c, model.d)
        with torch.no_grad():
            for layer, weight in zip(layers, weights, strict=True):
                layer.weight[:, units] = weight
            self.transition.bias.copy_(torch.from_numpy(model.drift))
            self.observation.bias.copy_(torch.from_numpy(model.offset))
            if model.gain is not None:
                self.gain.copy_(torch.from_numpy(model.gain))
            if first is not None:
                self.first.copy_(torch.from_numpy(first[0]))
                self.first_bias.copy_(torch.from_numpy(first[1]))

    def penalised(self) -> list[Tensor]:
        """Return the weights of f and g; the linear part has no penalty."""
        units = slice(self.states + self.nu, None)
        out = [layer.weight[:, units] for layer in (self.transition, self.observation)]
        return [*self.f.parameters(), *self.g.parameters(), *out]

    def growth(self) -> float:
        """Return the largest pole of A: up to 1, as f is bounded, free runs are bounded, too."""
        a = self.transition.weight[:, : self.states].detach().double()
        return float(torch.linalg.eigvals(a).abs().max())

    def size_in_words(self) -> str:
        """Return the numbers of states and units, for tables."""
        return f"{self.states} states, {self.hidden} hidden units"

    def initial_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        """Run over the measured samples from `first_state`, as an observer."""
        x = self.first_state(y_warmup, u)
        h = self._with_output(x, None if u is None else u[:, 0])
        for n in range(y_warmup.shape[1]):
            h = self.step(h, y_warmup[:, n], None if u is None else u[:, n])
        return h

    def first_state(self, y_warmup: Tensor, u: Tensor | None = None) -> Tensor:
        """Estimate the state at the first sample; raises ValueError for too short a warm-up."""
        n = self.encoded
        if y_warmup.shape[1] < n:
            raise InputError(f"the warm-up must have at least {n} samples, got {y_warmup.shape[1]}")
        samples = y_warmup[:, :n] if u is None else torch.cat([y_warmup[:, :n], u[:, :n]], dim=-1)
        return nn.functional.linear(samples.flatten(1), self.first, self.first_bias)

    def step(self, h: Tensor, y: Tensor, u: Tensor | None = None) -> Tensor:
        """Take one step of [x, the predicted y], shape `(batch, states + ny)`."""
        x, predicted = h.split([self.states, self.ny], dim=-1)
        moved = _mixed(self.f, self.transition, x, u)
        return self._with_output(moved + (y - predicted) @ self.gain.T, u)

    def observe(self, h: Tensor) -> Tensor:
        """Return the predicted y."""
        return h[:, self.states :]

    def fusable(self) -> bool:
        """Return whether the layers have their original types, with one layer of units or none."""
        kinds = (nn.Linear, nn.Tanh) if self.hidden else ()
        layers = [*self.f.children(), *self.g.children()]
        return len(self.f) == len(self.g) == len(kinds) and are_plain(
            (self.f, nn.Sequential),
            (self.g, nn.Sequential),
            (self.transition, nn.Linear),
            (self.observation, nn.Linear),
            *zip(layers, kinds * 2, strict=True),
        )

    def in_numpy(self) -> plain.PlainStateSpace | None:
        """Return the cell in NumPy; None where its layers have been replaced."""
        f, g = dense(self.f), dense(self.g)
        moves, out = self.transition, self.observation
        if f is None or g is None or not are_plain((moves, nn.Linear), (out, nn.Linear)):
            return None
        gain = values(self.gain)
        first = values(self.first), values(self.first_bias)
        layers = linear(moves), linear(out)
        return plain.PlainStateSpace(f, g, *layers, gain, first, self.encoded)

    def fused_rollout(self, y_warmup: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
        """Compute the rollout in one compiled call on the CPU."""
        from splitband.kernels.state_space import state_space_rollout  # noqa: PLC0415  numba is slow to load

        x0, none = self.first_state(y_warmup, u), self.gain.new_empty
        units: list[Tensor] = [p for layers in (self.f, self.g) for p in layers.parameters()]
        units = units or 2 * [none(0, self.states + self.nu), none(0)]
        out = (p for layer in (self.transition, self.observation) for p in layer.parameters())
        weights = (*units, *out, self.gain)
        return state_space_rollout(x0, y_warmup, steps, u, *weights)

    def fused_jacobian(
        self, y_warmup: Tensor, steps: int, u: Tensor | None = None
    ) -> Iterator[Array]:
        """Yield for each row the derivatives of its rollout by `parameters()`, in float64.

        Of the shape `(steps, ny, parameters)`; the array is used again for a later row.
        """
        from splitband.kernels.rollouts import run_jobs  # noqa: PLC0415  numba is slow to load
        from splitband.kernels.state_space_jacobian import jacobian  # noqa: PLC0415

        batch, warmup, _ = y_warmup.shape
        u = y_warmup.new_empty(batch, warmup + steps, 0) if u is None else u
        encoded = torch.cat([y_warmup[:, : self.encoded], u[:, : self.encoded]], dim=-1).flatten(1)
        signals = map(_double, (encoded, self.first_state(y_warmup, u), y_warmup, u))
        rows, together = [*zip(*signals, strict=True)], max(1, min(torch.get_num_threads(), batch))
        none = [np.empty((0, self.states + self.nu)), np.empty(0)]
        f, g, moves, out = (
            [*map(_double, layers.parameters())] or none
            for layers in (self.f, self.g, self.transition, self.observation)
        )
        weights = (*f, *g, *moves, *out, _double(self.gain))
        count = sum(p.numel() for p in self.parameters())
        slopes = np.empty((together, steps, self.ny, count))
        for i in range(0, batch, together):
            jobs = [(row, weights, of_row) for row, of_row in zip(rows[i:], slopes, strict=False)]
            run_jobs(jacobian, jobs)
            yield from slopes[: len(jobs)]

    def _layers(self, width: int) -> nn.Sequential:
        """Return the hidden layers of f or g."""
        layers: list[nn.Module] = []
        for i in range(self.layers if self.hidden else 0):
            layers += [nn.Linear(self.hidden if i else width, self.hidden), nn.Tanh()]
        return nn.Sequential(*layers)

    def _begin(self) -> None:
        """Draw weights: stable slow poles, an observer of y, and small f and g."""
        n, linear = self.states, self.states + self.nu
        with torch.no_grad():
            turn = _TURN * torch.randn(n, n)
            a = _RADIUS * torch.linalg.matrix_exp((turn - turn.T) / 2**0.5)
            self.transition.weight[:, :n] = a
            for layer in (self.transition, self.observation):
                layer.weight[:, linear:] *= _NONLINEAR
                layer.bias.zero_()
            c = self.observation.weight[:, :n]
            self.gain.copy_(_OBSERVED * a @ torch.linalg.pinv(c))

    def _with_output(self, x: Tensor, u: Tensor | None) -> Tensor:
        """Return the state of the cell, [x, the predicted y]."""
        return torch.cat([x, _mixed(self.g, self.observation, x, u)], dim=-1)


def _double(weight: Tensor) -> Array:
    return weight.detach().double().contiguous().numpy()


def _mixed(layers: nn.Sequential, out: nn.Linear, x: Tensor, u: Tensor | None) -> Tensor:
    """Return a linear map of x, u and the outputs of tanh units on x and u."""
    row = x if u is None else torch.cat([x, u], dim=-1)
    return out(torch.cat([row, layers(row)], dim=-1) if len(layers) else row)
