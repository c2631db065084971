"""Define what every model is: networks with tasks to learn, and components to add up."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from splitband.data import Record
from splitband.metrics import spread
from splitband.models.stepping import Stepped
from splitband.networks import Cell
from splitband.runtime.arrays import Array


@dataclass(frozen=True, eq=False)
class Signals:
    """Hold what a model may know, normalised: `(time, n)` for a record, or `(batch, time, n)`."""

    y: Tensor
    u: Tensor | None = None
    y_sim: Tensor | None = None

    def map(self, function: Callable[[Tensor], Tensor]) -> Signals:
        """Return what a function makes of each signal."""
        u, y_sim = (None if s is None else function(s) for s in (self.u, self.y_sim))
        return Signals(function(self.y), u, y_sim)


@dataclass(frozen=True, eq=False)
class Task:
    """Describe one network's share of the training.

    Attributes
    ----------
    name : For messages and loss curves.
    network : Whose parameters are trained.
    known : What windows are cut from, aligned with the record.
    target : What the output is compared with, `(time, ny)`, aligned with the record.
    simulate : Maps what is known of a batch of windows, `y` over the warm-up only, and a number
        of samples to the network's share of them, `(batch, samples, ny)`.
    stride : The output holds every `stride`-th sample, the first right after the warm-up.
    """

    name: str
    network: nn.Module
    known: Signals
    target: Tensor
    simulate: Callable[[Signals, int], Tensor]
    stride: int = 1


class Model(nn.Module, ABC):
    """Simulate what was learned from a record; subclasses say what the components are.

    `ny` and `nu`: measured channels and known inputs.
    """

    y_mean: Tensor
    y_std: Tensor
    u_mean: Tensor
    u_std: Tensor
    feedthrough = False
    """Whether the step to a sample knows the inputs of that sample, too."""
    conditioned = False
    """Whether a network is told what is slower."""
    beside_simulator = False
    """Whether a simulator's output is a part of it."""
    steps: ClassVar[type[Stepped] | None] = None
    """What runs it sample by sample."""
    units_kept = False
    """Whether `adapt_to` leaves mean and deviation as they are, which the weights are made for."""

    def __init__(self, ny: int, nu: int) -> None:
        super().__init__()
        self.ny, self.nu = ny, nu
        for name, size in (("y", ny), ("u", nu)):
            self.register_buffer(f"{name}_mean", torch.zeros(size, dtype=torch.float64))
            self.register_buffer(f"{name}_std", torch.ones(size, dtype=torch.float64))

    @abstractmethod
    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the parts of a simulation, to be added: `steps` samples after `known.y`."""

    @abstractmethod
    def tasks(self, record: Signals) -> list[Task]:
        """Return what each network has to learn from a normalised record."""

    def simulate_components(
        self, y_warmup: Array, steps: int, u: Array | None = None, y_sim: Array | None = None
    ) -> dict[str, Array]:
        """Run free after a measured warm-up; return the parts to add up, each `(steps, ny)`.

        The first one carries the record's mean.

        Parameters
        ----------
        y_warmup : Measured samples `(R, ny)`.
        steps : How many samples to simulate.
        u : Known inputs over warm-up and simulation, `(R + steps, nu)`.
        y_sim : A simulator's output over both, `(R + steps, ny)`, where one is used.
        """
        with torch.no_grad():
            parts = self.components(self._batch_of_one(y_warmup, u, y_sim), steps)
        scaled = {name: part[0].double() * self.y_std for name, part in parts.items()}
        first = next(iter(scaled))
        scaled[first] = scaled[first] + self.y_mean
        return {name: part.cpu().numpy() for name, part in scaled.items()}

    def simulate_unfiltered(
        self, y_warmup: Array, steps: int, u: Array | None = None, y_sim: Array | None = None
    ) -> dict[str, Array]:
        """Return what the filters of a model are fed with, by name; empty for a model without.

        As for `simulate_components`, but each part is of the whole signal: they do not add up.
        """
        with torch.no_grad():
            parts = self.unfiltered(self._batch_of_one(y_warmup, u, y_sim), steps)
        return {
            name: (part[0].double() * self.y_std + self.y_mean).cpu().numpy()
            for name, part in parts.items()
        }

    def stepped(self) -> Stepped:
        """Return the model sample by sample; raises ValueError where it cannot run so."""
        if self.steps is None:
            raise ValueError(f"{type(self).__name__} cannot be stepped")
        return self.steps(self)

    def unfiltered(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return what is filtered after the warm-up; nothing, unless a subclass filters."""
        return {}

    def adapt_to(self, records: Sequence[Record], normalize: bool = True) -> None:
        """Take from the training records what is not learned by gradient: here, the units.

        With `normalize`, that is the mean and the standard deviation of each channel.
        """
        inputs = [record.u for record in records if record.u is not None]
        if not normalize or self.units_kept:
            return
        for name, signals in (("y", [record.seen for record in records]), ("u", inputs)):
            if signals:
                values = np.concatenate(signals)
                getattr(self, f"{name}_mean").copy_(torch.from_numpy(np.nanmean(values, axis=0)))
                getattr(self, f"{name}_std").copy_(torch.from_numpy(spread(values)))

    def normalised(self, record: Record) -> Signals:
        """Return the signals of a record as the networks see them, each `(time, n)`."""
        return self._signals(record.y, record.u if self.nu else None, record.y_sim)

    def _rows(self, u: Tensor | None) -> Tensor | None:
        """Return the inputs of the steps between samples."""
        return with_next_input(u) if self.feedthrough and u is not None else u

    def _signals(self, y: Array, u: Array | None, y_sim: Array | None) -> Signals:
        return Signals(
            self._to_network(y, "y"),
            None if u is None else self._to_network(u, "u"),
            None if y_sim is None else self._to_network(y_sim, "y"),
        )

    def _batch_of_one(self, y: Array, u: Array | None, y_sim: Array | None) -> Signals:
        return self._signals(y, u, y_sim).map(lambda signal: signal[None])

    def _to_network(self, x: Array, kind: str) -> Tensor:
        # Subtract in float64: beside a large offset float32 has too few digits for the signal.
        mean, std = getattr(self, f"{kind}_mean"), getattr(self, f"{kind}_std")
        values = torch.from_numpy(np.array(x, dtype=np.float64)).to(mean)
        return ((values - mean) / std).to(next(self.parameters()).dtype)


def conditioning(slow: Tensor, scale: Tensor, driven: bool = False) -> Tensor:
    """Return what a slower signal tells a faster network: its value and its slope, side by side.

    The row that acts on the step from one sample to the next holds those of the latter. The slope
    is that between the neighbours on both sides; with known inputs, on which the slow signal may
    depend, that to the sample before, as it would know inputs to come otherwise.

    Returns `(..., time, 2 ny)`; the last row acts on no step.

    Parameters
    ----------
    slow : `(..., time, ny)`.
    scale : Of each channel's slope, `(ny,)`, see `slope_scale`.
    driven : Whether the slow signal may depend on known inputs.
    """
    values = torch.cat([slow, _slope(slow, driven) / scale.to(slow)], dim=-1)[..., 1:, :]
    return torch.cat([values, values[..., -1:, :]], dim=-2)


def with_next_input(u: Tensor) -> Tensor:
    """Return each row of the inputs with the next one behind it, `(..., time, 2 nu)`.

    The step from n to n + 1 then knows the inputs of both samples, as it must where an input acts
    on the output at once (direct feedthrough). The last row acts on no step.
    """
    following = torch.cat([u[..., 1:, :], u[..., -1:, :]], dim=-2)
    return torch.cat([u, following], dim=-1)


def concat_inputs(u: Tensor | None, given: Tensor) -> Tensor:
    """Return the known inputs, if any, and `given` behind them, as far as both go."""
    if u is None:
        return given
    rows = min(u.shape[-2], given.shape[-2])
    return torch.cat([u[..., :rows, :], given[..., :rows, :]], dim=-1)


def slope_scale(slow: Sequence[Tensor], driven: bool = False) -> Tensor:
    """Return the deviation of each channel's slope in records `(time, ny)`; 1 for a constant.

    `driven` as for `conditioning`.
    """
    spread = torch.cat([_slope(of_record.double(), driven) for of_record in slow]).std(dim=0)
    return torch.where(spread > 0, spread, torch.ones_like(spread))


def _slope(x: Tensor, backward: bool) -> Tensor:
    """Return the slope by sample, from the neighbours on both sides, or from the sample before."""
    if x.shape[-2] < 2:
        return torch.zeros_like(x)
    if backward:
        steps = x.diff(dim=-2)
        return torch.cat([steps[..., :1, :], steps], dim=-2)
    return torch.gradient(x, dim=-2)[0]


def inputs_of(cell: Cell, told: int, feedthrough: bool) -> int:
    """Return the inputs of a model by those of its network; `told` come from the model itself.

    Raises ValueError where the network has too few, or with feedthrough an odd number.
    """
    nu = cell.nu - told
    if nu < 0:
        raise ValueError(
            f"a conditioned network must have at least 2 ny = {told} inputs, for the "
            f"simulator's value and slope, got nu = {cell.nu}"
        )
    if feedthrough and nu % 2:
        raise ValueError(
            f"with feedthrough a network must have each input twice, of a sample and of the next, "
            f"got nu = {nu}"
        )
    return nu // 2 if feedthrough else nu


def with_weights(build: Callable[[], Model], weights: Mapping[str, Any]) -> Model:
    """Return a model with these weights, its tied parameters tied.

    It is built on the meta device first, where shapes take no memory, and compared with the
    weights: what is not of them is refused in a ValueError.
    """
    try:
        with torch.device("meta"):
            expected = build().state_dict()
    except RuntimeError:  # a cell of the user's own may compute with values
        expected = build().state_dict()
    left_out = ("u_low", "u_high")  # they were saved once; the forecaster knows the inputs' range
    found = {name: torch.as_tensor(x) for name, x in weights.items() if name not in left_out}
    shapes, needed = ({k: tuple(t.shape) for k, t in of.items()} for of in (found, expected))
    if shapes != needed:
        name = min(k for k in shapes | needed if shapes.get(k) != needed.get(k))
        raise ValueError(
            f"{name} of the weights must be {needed.get(name)}, got {shapes.get(name)}"
        )
    for name, tensor in found.items():
        floating = tensor.dtype in (torch.float32, torch.float64)
        wanted = expected[name].dtype
        if not (floating if wanted.is_floating_point else tensor.dtype == wanted):
            raise ValueError(f"weights must be float32 or float64: {name} is {tensor.dtype}")
    model = build()
    # In place, so that what is tied stays so; the precision is the one that was saved.
    for name, tensor in model.state_dict(keep_vars=True).items():
        tensor.data = found[name]
    return model


def as_module(cell: Cell) -> nn.Module:
    """Return the cell as what is trained; raises TypeError where it is none."""
    if not isinstance(cell, nn.Module):
        raise TypeError(f"a cell must be an nn.Module, got {type(cell).__name__}")
    return cell
