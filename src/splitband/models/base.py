"""Define what every model is: networks with tasks to learn, and components to add up."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from splitband.data import Record
from splitband.metrics import spread
from splitband.models.stepping import Stepped
from splitband.networks import Cell
from splitband.runtime.arguments import whole

Signal = TypeVar("Signal", npt.NDArray[Any], Tensor)


@dataclass(frozen=True, eq=False)
class Signals:
    """Hold what a model may know, normalised: `(time, n)` for a record, or `(batch, time, n)`."""

    y: Tensor
    u: Tensor | None = None
    y_sim: Tensor | None = None


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

    Parameters
    ----------
    ny, nu : Measured channels and known inputs.
    """

    y_mean: Tensor
    y_std: Tensor
    u_mean: Tensor
    u_std: Tensor
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

    def simulate(
        self,
        y_warmup: Signal,
        steps: int,
        u: Signal | None = None,
        y_sim: Signal | None = None,
    ) -> Signal:
        """Run free for `steps` samples after a measured warm-up.

        Parameters
        ----------
        y_warmup : Measured samples `(R,)`, `(R, ny)` or `(batch, R, ny)`, NumPy or torch.
        steps : How many samples to simulate.
        u : Known inputs over warm-up and simulation, `(R + steps, nu)`, with a batch if y has one.
        y_sim : A simulator's output over warm-up and simulation, shaped like y, where one is used.

        Returns
        -------
        Signal
            Shaped like `y_warmup`, with `steps` samples; in its units, dtype and device.
        """
        parts = list(self.simulate_components(y_warmup, steps, u, y_sim).values())
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return total

    def simulate_components(
        self,
        y_warmup: Signal,
        steps: int,
        u: Signal | None = None,
        y_sim: Signal | None = None,
    ) -> dict[str, Signal]:
        """Return the parts that `simulate` adds up; the first one carries the record's mean."""
        known = self._normalised(y_warmup, steps, u, y_sim)
        if isinstance(y_warmup, Tensor):
            parts = self.components(known, steps)
        else:
            with torch.no_grad():
                parts = self.components(known, steps)
        scaled = {name: part.double() * self.y_std for name, part in parts.items()}
        first = next(iter(scaled))
        scaled[first] = scaled[first] + self.y_mean
        return {name: self._shaped(part, y_warmup) for name, part in scaled.items()}

    def simulate_unfiltered(
        self, y_warmup: Signal, steps: int, u: Signal | None = None, y_sim: Signal | None = None
    ) -> dict[str, Signal]:
        """Return what the filters of a model are fed with, by name; empty for a model without.

        As for `simulate`, but each part is of the whole signal: they do not add up to it.
        """
        known = self._normalised(y_warmup, steps, u, y_sim)
        with torch.no_grad():
            parts = self.unfiltered(known, steps)
        return {
            name: self._shaped(part.double() * self.y_std + self.y_mean, y_warmup)
            for name, part in parts.items()
        }

    def stepped(self) -> Stepped:
        """Return the model sample by sample; raises ValueError where it cannot run so."""
        raise ValueError(f"{type(self).__name__} cannot be stepped")

    def unfiltered(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return what is filtered after the warm-up; nothing, unless a subclass filters."""
        return {}

    def _shaped(self, values: Tensor, like: Signal) -> Signal:
        """Return `(batch, steps, ny)` as the caller's kind of array."""
        values = values.reshape(*like.shape[:-2], values.shape[1], self.ny)
        values = values[:, 0] if like.ndim == 1 else values
        return values.to(like) if isinstance(like, Tensor) else values.cpu().numpy()

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

    def normalised(self, trajectory: Record) -> Signals:
        """Return the signals of a record as the networks see them, each `(time, n)`."""
        u, y_sim = trajectory.u, trajectory.y_sim
        return Signals(
            self._to_network(trajectory.y, "y"),
            self._to_network(u, "u") if self.nu and u is not None else None,
            None if y_sim is None else self._to_network(y_sim, "y"),
        )

    def _normalised(
        self, y_warmup: Signal, steps: int, u: Signal | None, y_sim: Signal | None
    ) -> Signals:
        steps = whole("steps", steps)
        total = (y_warmup.shape[0] if y_warmup.ndim == 1 else y_warmup.shape[-2]) + steps
        if bool(self.nu) != (u is not None):
            raise ValueError(f"u must be given exactly where the model has inputs, nu = {self.nu}")
        return Signals(
            self._batch(y_warmup, "y_warmup", self.ny, 1),
            None if u is None else self._batch(u, "u", self.nu, total),
            None if y_sim is None else self._batch(y_sim, "y_sim", self.ny, total),
        )

    def _batch(self, x: Signal, name: str, channels: int, samples: int) -> Tensor:
        """Bring `(time,)`, `(time, n)` or `(batch, time, n)` to a normalised batch."""
        shape = tuple(x.shape)
        x = x[:, None] if x.ndim == 1 else x
        x = x[None] if x.ndim == 2 else x
        if x.ndim != 3 or x.shape[-1] != channels or x.shape[1] < samples:
            raise ValueError(
                f"{name} must have {channels} channel(s) and at least {samples} sample(s), shape "
                f"(time, {channels}) or (batch, time, {channels}), got {shape}"
            )
        return self._to_network(x, "u" if name == "u" else "y")

    def _to_network(self, x: npt.NDArray[Any] | Tensor, kind: str) -> Tensor:
        # Subtract in float64: beside a large offset float32 has too few digits for the signal.
        mean, std = getattr(self, f"{kind}_mean"), getattr(self, f"{kind}_std")
        x = x if isinstance(x, Tensor) else torch.from_numpy(np.array(x, dtype=np.float64))
        values = x.to(mean)
        return ((values - mean) / std).to(next(self.parameters()).dtype)


def conditioning(slow: Tensor, scale: Tensor, driven: bool = False) -> Tensor:
    """Return what a slower signal tells a faster network: its value and its slope, side by side.

    The row that acts on the step from one sample to the next holds those of the latter. The slope
    is that between the neighbours on both sides; with known inputs, on which the slow signal may
    depend, that to the sample before, as it would know inputs to come otherwise.

    Parameters
    ----------
    slow : `(..., time, ny)`.
    scale : Of each channel's slope, `(ny,)`, see `slope_scale`.
    driven : Whether the slow signal may depend on known inputs.

    Returns
    -------
    Tensor
        `(..., time, 2 ny)`; the last row acts on no step.
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
    tied = _tied(model)
    model.load_state_dict(found, assign=True)  # which keeps the precision that was saved
    for first, *others in tied:
        for name in others:
            owner, _, attribute = name.rpartition(".")
            setattr(model.get_submodule(owner), attribute, model.get_parameter(first))
    return model


def _tied(model: Model) -> list[list[str]]:
    """Return the names of parameters that are one and the same, for each that has several."""
    names: dict[int, list[str]] = {}
    for name, parameter in model.named_parameters(remove_duplicate=False):
        names.setdefault(id(parameter), []).append(name)
    return [of_one for of_one in names.values() if len(of_one) > 1]


def as_module(cell: Cell) -> nn.Module:
    """Return the cell as what is trained; raises TypeError where it is none."""
    if not isinstance(cell, nn.Module):
        raise TypeError(f"a cell must be an nn.Module, got {type(cell).__name__}")
    return cell
