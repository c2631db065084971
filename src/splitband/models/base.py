"""Define the interface of all models: networks with training tasks, and components to sum."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias, cast

import numpy as np

from splitband.metrics import spread
from splitband.models.stepping import Stepped
from splitband.networks import Cell, rollout
from splitband.networks.layers import Tensor, nn, torch
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.optional import HOW, has_torch


@dataclass(frozen=True, eq=False)
class Signals:
    """A model's normalised signals: `(time, n)` for a record, or `(batch, time, n)`."""

    y: Tensor
    u: Tensor | None = None
    y_sim: Tensor | None = None

    def map(self, function: Callable[[Tensor], Tensor]) -> Signals:
        """Apply a function to all signals."""
        u, y_sim = (None if s is None else function(s) for s in (self.u, self.y_sim))
        return Signals(function(self.y), u, y_sim)


FreeRun: TypeAlias = tuple[Tensor, int, Tensor | None]
"""What `rollout` takes: the measured samples of the warm-up, a number of samples, known inputs."""


@dataclass(frozen=True, eq=False)
class Task:
    """The training of one network.

    name : For messages and loss curves.
    network : The network to train.
    known : Signals to cut windows from, aligned with the record.
    target : The desired output, `(time, ny)`, aligned with the record.
    run : Maps the signals of a batch of windows, `y` over the warm-up only, and a number of samples
        of the output to the network's free run.
    stride : The output holds every `stride`-th sample, the first right after the warm-up.
    output : Maps the network's free run and the same two to the output, `(batch, samples, ny)`, of
        which each sample is an affine function of the free run; by default it is the free run.
    """

    name: str
    network: nn.Module
    known: Signals
    target: Tensor
    run: Callable[[Signals, int], FreeRun]
    stride: int = 1
    output: Callable[[Tensor, Signals, int], Tensor] | None = None

    def simulate(self, known: Signals, steps: int) -> Tensor:
        """Return the output of a batch of windows."""
        free = rollout(cast("Cell", self.network), *self.run(known, steps))
        return free if self.output is None else self.output(free, known, steps)

    def tangent(self, slopes: Tensor, known: Signals, steps: int) -> Tensor:
        """Return the derivatives of the output of one window by some parameters, `(n, steps, ny)`.

        `slopes` are those of the network's free run.
        """
        if self.output is None:
            return slopes
        many = known.map(lambda signal: signal.expand(len(slopes), -1, -1))
        without = self.output(torch.zeros_like(slopes[:1]), known, steps)
        return self.output(slopes, many, steps) - without


class Model(nn.Module, ABC):
    """A simulator of a system, learned from records; subclasses define the components.

    `ny` and `nu`: measured channels and known inputs.
    """

    y_mean: Tensor
    y_std: Tensor
    u_mean: Tensor
    u_std: Tensor
    feedthrough = False
    """Whether the step to a sample also uses the inputs at its time."""
    conditioned = False
    """Whether one component is an input of the other component's network."""
    uses_simulator = False
    """Whether a simulator's output is a component of the model."""
    steps: ClassVar[type[Stepped]]
    """Class of the model's step form."""
    units_kept = False
    """Whether `adapt_to` keeps the scaling of earlier training."""

    def __init__(self, ny: int, nu: int) -> None:
        super().__init__()
        self.ny, self.nu = ny, nu
        for name, size in (("y", ny), ("u", nu)):
            self.register_buffer(f"{name}_mean", torch.zeros(size, dtype=torch.float64))
            self.register_buffer(f"{name}_std", torch.ones(size, dtype=torch.float64))

    @abstractmethod
    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the summands of a simulation: `steps` samples after `known.y`."""

    @abstractmethod
    def tasks(self, record: Signals) -> list[Task]:
        """Return the networks' training tasks for a normalised record."""

    def simulate_components(
        self, y_warmup: Array, steps: int, u: Array | None = None, y_sim: Array | None = None
    ) -> dict[str, Array]:
        """Simulate after a measured warm-up; return the summands, `(steps, ny)`, by name.

        The first component includes the record's mean.

        y_warmup : Measured samples `(R, ny)`.
        steps : Number of samples to simulate.
        u : Known inputs over warm-up and simulation, `(R + steps, nu)`.
        y_sim : A simulator's output over warm-up and simulation, `(R + steps, ny)`.
        """
        if not has_torch():
            return {"simulation": self._stepped_without_torch().simulate(y_warmup, steps, u, y_sim)}
        with torch.no_grad():
            parts = self.components(self._batch_of_one(y_warmup, u, y_sim), steps)
        scaled = {name: part[0].double() * self.y_std for name, part in parts.items()}
        first = next(iter(scaled))
        scaled[first] = scaled[first] + self.y_mean
        return {name: part.cpu().numpy() for name, part in scaled.items()}

    def simulate_unfiltered(
        self, y_warmup: Array, steps: int, u: Array | None = None, y_sim: Array | None = None
    ) -> dict[str, Array]:
        """Return the signals before a model's filters, by name; their sum has no meaning.

        Empty for a model without filters. Parameters as for `simulate_components`.
        """
        with torch.no_grad():
            parts = self.unfiltered(self._batch_of_one(y_warmup, u, y_sim), steps)
        return {
            name: (part[0].double() * self.y_std + self.y_mean).cpu().numpy()
            for name, part in parts.items()
        }

    def stepped(self) -> Stepped:
        """Return the model's step form; raises ValueError without one."""
        return self.steps(self)

    def _stepped_without_torch(self) -> Stepped:
        try:
            return self.stepped()
        except InputError as error:
            raise InputError(f"{error}; without steps it needs torch: {HOW}") from None

    def unfiltered(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the signals before the filters, after the warm-up; empty without filters."""
        return {}

    def adapt_to(self, records: Sequence[Record], normalize: bool = True) -> None:
        """Fit the parameters without a gradient, here the scaling, to the training records.

        With `normalize`: mean and standard deviation by channel and input.
        """
        inputs = [record.u for record in records if record.u is not None]
        if not normalize or self.units_kept:
            return
        outputs = [record.y_with_gaps for record in records]
        of_y, of_u = (self.y_mean, self.y_std, outputs), (self.u_mean, self.u_std, inputs)
        for mean, std, signals in (of_y, of_u):
            if signals:
                values = np.concatenate(signals)
                mean.copy_(torch.from_numpy(np.nanmean(values, axis=0)))
                std.copy_(torch.from_numpy(spread(values)))

    def normalised(self, record: Record) -> Signals:
        """Return the normalised signals of a record, `(time, n)`."""
        return self._signals(record.y, record.u if self.nu else None, record.y_sim)

    def _rows(self, u: Tensor | None) -> Tensor | None:
        """Return the inputs of the steps between samples."""
        return with_next_input(u) if self.feedthrough and u is not None else u

    def _signals(self, y: Array, u: Array | None, y_sim: Array | None) -> Signals:
        of_y, of_u = (self.y_mean, self.y_std), (self.u_mean, self.u_std)
        return Signals(
            self._to_network(y, *of_y),
            None if u is None else self._to_network(u, *of_u),
            None if y_sim is None else self._to_network(y_sim, *of_y),
        )

    def _batch_of_one(self, y: Array, u: Array | None, y_sim: Array | None) -> Signals:
        return self._signals(y, u, y_sim).map(lambda signal: signal[None])

    def _to_network(self, x: Array, mean: Tensor, std: Tensor) -> Tensor:
        # Subtract in float64: beside a large offset, float32 has too few digits for the signal.
        values = torch.from_numpy(np.array(x, dtype=np.float64)).to(mean)
        return ((values - mean) / std).to(next(self.parameters()).dtype)


def conditioning(slow: Tensor, scale: Tensor, driven: bool = False) -> Tensor:
    """Return value and slope of a slow signal, the inputs of a network conditioned on it.

    The row for the step from n to n + 1 holds value and slope at n + 1. The slope is a central
    difference. If the slow signal may depend on known inputs, it is a backward difference: a
    central one would use future inputs.

    Returns `(..., time, 2 ny)`; the last row acts on no step.

    slow : `(..., time, ny)`.
    scale : Scale of the slope by channel, `(ny,)`, see `slope_scale`.
    driven : Whether the slow signal may depend on known inputs.
    """
    values = value_and_slope(slow, scale, driven)[..., 1:, :]
    return torch.cat([values, values[..., -1:, :]], dim=-2)


def value_and_slope(signal: Tensor, scale: Tensor, driven: bool = False) -> Tensor:
    """Return a signal and its scaled slope, `(..., time, 2 ny)`; see `conditioning`."""
    return torch.cat([signal, _slope(signal, driven) / scale.to(signal)], dim=-1)


def with_next_input(u: Tensor) -> Tensor:
    """Return rows of inputs followed by their next rows, `(..., time, 2 nu)`.

    The step from n to n + 1 then has the inputs of both samples, for direct feedthrough. The last
    row acts on no step.
    """
    following = torch.cat([u[..., 1:, :], u[..., -1:, :]], dim=-2)
    return torch.cat([u, following], dim=-1)


def concat_inputs(u: Tensor | None, extra: Tensor) -> Tensor:
    """Return the known inputs, if any, and `extra` ones, up to the end of the shorter signal."""
    if u is None:
        return extra
    rows = min(u.shape[-2], extra.shape[-2])
    return torch.cat([u[..., :rows, :], extra[..., :rows, :]], dim=-1)


def slope_scale(slow: Sequence[Tensor], driven: bool = False) -> Tensor:
    """Return the slope's standard deviation by channel of records `(time, ny)`; 1 if constant."""
    spread = torch.cat([_slope(of_record.double(), driven) for of_record in slow]).std(dim=0)
    return torch.where(spread > 0, spread, torch.ones_like(spread))


def _slope(x: Tensor, backward: bool) -> Tensor:
    """Return the slope per sample, as central or as backward differences."""
    if x.shape[-2] < 2:
        return torch.zeros_like(x)
    if backward:
        steps = x.diff(dim=-2)
        return torch.cat([steps[..., :1, :], steps], dim=-2)
    return torch.gradient(x, dim=-2)[0]


def inputs_of(cell: Cell, extra: int, feedthrough: bool) -> int:
    """Return the number of a model's inputs: its network's without the `extra` ones."""
    nu = cell.nu - extra
    return nu // 2 if feedthrough else nu


def with_weights(build: Callable[[], Model], weights: Mapping[str, Any]) -> Model:
    """Return a model with these weights; tied parameters stay tied.

    Names, shapes and types are compared first, with a model on the meta device, without memory.
    Raises ValueError for other ones.
    """
    try:
        with torch.device("meta"):
            expected = build().state_dict()
    except RuntimeError:  # a user's own cell may compute with values, which meta tensors lack
        expected = build().state_dict()
    tensors = {name: torch.as_tensor(x) for name, x in weights.items()}
    shapes, needed = ({k: tuple(t.shape) for k, t in of.items()} for of in (tensors, expected))
    if shapes != needed:
        name = min(k for k in shapes | needed if shapes.get(k) != needed.get(k))
        raise InputError(
            f"{name} of the weights must be {needed.get(name)}, got {shapes.get(name)}"
        )
    for name, tensor in tensors.items():
        floating = tensor.dtype in (torch.float32, torch.float64)
        wanted = expected[name]
        if not (floating if torch.is_floating_point(wanted) else tensor.dtype == wanted.dtype):
            raise InputError(f"weights must be float32 or float64: {name} is {tensor.dtype}")
    kinds = {(expected[name].dtype, tensor.dtype) for name, tensor in tensors.items()}
    if len(kinds) > len({wanted for wanted, _ in kinds}):
        raise InputError(f"weights must be of one precision, got {sorted(map(str, kinds))}")
    model = build()
    # In place: tied parameters stay tied, and the saved precision remains.
    for name, tensor in model.state_dict(keep_vars=True).items():
        tensor.data = tensors[name]
    return model


def as_module(cell: Cell) -> nn.Module:
    """Return the cell, typed as a module; raises TypeError for another object."""
    if not isinstance(cell, nn.Module):
        raise TypeError(f"a cell must be an nn.Module, got {type(cell).__name__}")
    return cell
