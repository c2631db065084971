"""Simulate forecasts in torch, in batches and with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, final

import numpy as np
import torch
from torch import Tensor, nn

from splitband.forecasters.prediction import ForecastContext, continued, extrapolated, median
from splitband.models import Model, Signals
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster


@final
class TorchSimulation(nn.Module):
    """Simulate a fitted forecaster from one history on, as a torch module.

    `Forecaster.as_torch` returns one. It is differentiable with respect to the inputs and the
    weights of networks.

    Attributes
    ----------
    simulation : Module of the forecaster, for batches.
    nu : The number of inputs.
    """

    def __init__(self, simulation: nn.Module, nu: int) -> None:
        super().__init__()
        self.simulation, self.nu = simulation, nu

    def forward(self, u: Tensor) -> Tensor:
        """Return the samples after the history.

        Parameters
        ----------
        u : Future inputs in measured units, `(steps, nu)`, or a batch of them,
            `(batch, steps, nu)`.

        Returns
        -------
        Tensor
            `(steps, ny)` or `(batch, steps, ny)` in measured units, float64.

        Raises
        ------
        ValueError
            For another shape.
        """
        if u.ndim not in (2, 3) or u.shape[-1] != self.nu or not u.shape[-2]:
            raise InputError(
                f"u must be (steps, {self.nu}) or (batch, steps, {self.nu}), got {tuple(u.shape)}"
            )
        y: Tensor = self.simulation(u if u.ndim == 3 else u[None])
        return y if u.ndim == 3 else y[0]


class Affine(nn.Module):
    """Simulate a fitted forecaster that is `affine`, from what is known at the origin."""

    def __init__(self, forecaster: Forecaster, known: ForecastContext) -> None:
        super().__init__()
        self._forecaster, self._known = forecaster, known

    def forward(self, u: Tensor) -> Tensor:
        """Return the samples `(batch, steps, ny)` for inputs `(batch, steps, nu)`.

        They are the response to zero inputs plus the convolution with the impulse responses.
        """
        steps, nu = u.shape[1:]
        free = self._simulated(np.zeros((steps, nu)))
        y = free.to(u.device).expand(len(u), -1, -1)
        if not nu:
            return y
        impulses = np.zeros((nu, steps, nu))
        impulses[range(nu), 0, range(nu)] = 1.0
        responses = torch.stack([self._simulated(each) - free for each in impulses]).to(u.device)
        # Zero-padded, as the convolution is not circular.
        spectrum = torch.fft.rfft(u.double(), 2 * steps, dim=1)
        gains = torch.fft.rfft(responses, 2 * steps, dim=1)
        both = torch.einsum("bfi,ifo->bfo", spectrum, gains)
        return y + torch.fft.irfft(both, 2 * steps, dim=1)[:, :steps]

    def _simulated(self, u: Array) -> Tensor:
        known, past = self._known, self._known.u
        inputs = None if past is None else np.concatenate([past, u])
        if known.y_sim is not None:
            n = len(known.y)
            continued("y_sim", known.y_sim[:n], known.y_sim[n:], None, len(u))
        known = replace(known, steps=len(u), u=inputs)
        return torch.from_numpy(extrapolated(self._forecaster, known)[0])


class ModelSimulation(nn.Module):
    """Simulate a copy of a trained model, from a warm-up of outputs, inputs and the base's output.

    The origin is `since` samples after its end. `late` are inputs before the origin, not delayed,
    at least as many as the longest of the `delays`; `base` simulates that of a hybrid.
    """

    def __init__(
        self,
        model: Model,
        warmup: tuple[Array, Array | None, Array | None],
        since: int,
        late: Array,
        delays: Sequence[int],
        base: nn.Module | None,
    ) -> None:
        super().__init__()
        self.model, self.base = deepcopy(model), base
        self._since, self._delays = since, tuple(delays)
        for name, signal in zip(("y", "u", "y_sim", "late"), (*warmup, late), strict=True):
            rows = None if signal is None else torch.tensor(signal)
            self.register_buffer(f"_{name}", rows, persistent=False)

    def forward(self, u: Tensor) -> Tensor:
        """Return the samples after the history, see `Affine`."""
        model, batch, steps = self.model, len(u), u.shape[1]
        slow = None if self.base is None else self.base(u)
        known = Signals(
            self._normalised("y", self._rows("_y", batch, None)),
            self._normalised("u", self._rows("_u", batch, self._delayed(u))) if model.nu else None,
            None if slow is None else self._normalised("y", self._rows("_y_sim", batch, slow)),
        )
        parts = model.components(known, self._since + steps)
        y = torch.stack([*parts.values()]).sum(dim=0)[:, self._since :]
        return y.double() * model.y_std + model.y_mean

    def _rows(self, name: str, batch: int, ahead: Tensor | None) -> Tensor:
        past = getattr(self, name).expand(batch, -1, -1)
        return past if ahead is None else torch.cat([past, ahead.to(past)], dim=1)

    def _delayed(self, u: Tensor) -> Tensor:
        if not any(self._delays):
            return u
        given, before = self._rows("_late", len(u), u), u.shape[1]
        return torch.stack(
            [given[:, given.shape[1] - before - delay :][:, :before, i]
             for i, delay in enumerate(self._delays)], dim=2,
        )  # fmt: skip

    def _normalised(self, kind: str, signal: Tensor) -> Tensor:
        mean, std = getattr(self.model, f"{kind}_mean"), getattr(self.model, f"{kind}_std")
        return ((signal - mean) / std).to(next(self.model.parameters()).dtype)


class Median(nn.Module):
    """Simulate the median of several simulations."""

    def __init__(self, members: Sequence[nn.Module]) -> None:
        super().__init__()
        self.members = nn.ModuleList(members)

    def forward(self, u: Tensor) -> Tensor:
        """Return the median of the members' simulations."""
        simulated = [member(u) for member in self.members]
        found: Tensor = median(simulated, torch.minimum, torch.maximum)
        return found
