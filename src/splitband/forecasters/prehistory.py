"""Estimate the samples before a history that is shorter than a network's warm-up.

Not in the paper. Networks are trained with warm-ups of one length. Where fewer samples are known,
the samples before them are estimated: the warm-up has to be probable in the training records, and
the network has to simulate the known samples well after it. This is regularised least squares for
the initial state, on signals in place of states, which works for every model;
docs/howto/validation.md has what it is worth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from splitband import models
from splitband.records import Record
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.optional import require_torch
from splitband.training.settings import window_starts

if TYPE_CHECKING:
    from torch import Tensor

    from splitband.models import Model

COMPONENTS = 16
"""Largest number of principal components of a warm-up. Bounds the time."""
MOST_WINDOWS = 2000
"""Largest number of training warm-ups that are used: bounds the time."""
SMALLEST_ERROR = 1e-3
"""Lower limit of the error of a simulation, as a share of the standard deviation: a smaller
training error is too optimistic. By eye."""


@dataclass(frozen=True, eq=False)
class Prehistory:
    """Hold the distribution of warm-ups in the training records, as the model sees them.

    mean : Of the normalised outputs, inputs and, where there is a base, its output,
        `(warmup, ny + nu)` or `(warmup, ny + nu + ny)`.
    root : Principal directions, scaled so that their coefficients have a variance of 1,
        `(components, *mean.shape)`.
    error : RMSE of the model's simulations, normalised.
    """

    mean: Array
    root: Array
    error: float

    def check(self, model: Model, warmup: int) -> None:
        """Raise ValueError where it does not match the model and its warm-up."""
        check_shape("mean of the prehistory", self.mean, warmup, sum(_widths(model)))
        check_shape("root of the prehistory", self.root, None, *self.mean.shape)

    @classmethod
    def of(
        cls, model: Model, records: Sequence[Record], warmup: int, error: float
    ) -> Prehistory | None:
        """Return the distribution in the training records; None for fewer than two warm-ups."""
        import torch  # noqa: PLC0415  a loaded model that is not asked does not need it

        signals = []
        for seen in map(model.normalised, records):
            used = seen.y, seen.u, seen.y_sim if model.uses_simulator else None
            every = torch.cat([each for each in used if each is not None], dim=-1)
            signals.append(every.double().cpu().numpy())
        starts = window_starts(records, warmup + 1, warmup)
        if len(starts) < 2:
            return None
        kept = np.linspace(0, len(starts) - 1, min(len(starts), MOST_WINDOWS)).round().astype(int)
        rows = starts[kept][:, None] + np.arange(warmup)
        windows = np.concatenate(signals)[rows]
        mean = windows.mean(axis=0)
        flat = (windows - mean).reshape(len(windows), -1)
        # Eigenvectors of the covariance: an SVD of all rows takes five times as long.
        variance, directions = np.linalg.eigh(flat.T @ flat / len(flat))
        largest = np.argsort(variance)[::-1][:COMPONENTS]
        root = np.sqrt(variance[largest].clip(0))[:, None] * directions[:, largest].T
        return cls(mean, root.reshape(-1, *mean.shape), max(error, SMALLEST_ERROR))

    def completed(
        self, model: Model, y: Array, u: Array | None, slow: Array | None
    ) -> tuple[Array, Array | None, Array | None]:
        """Return signals with estimated rows before them, so that `y` is a whole warm-up."""
        require_torch("a history shorter than the warm-up of a network")
        import torch  # noqa: PLC0415  see `of`

        samples = len(y)
        past_u, past_slow = (None if x is None else x[:samples] for x in (u, slow))
        history = Record(y, 1.0, u=past_u, y_sim=past_slow)
        known = model.normalised(history)
        mean, root = (torch.from_numpy(x).to(known.y) for x in (self.mean, self.root))

        def guessed(z: Tensor) -> tuple[Tensor, ...]:
            return (mean + torch.tensordot(z, root, dims=1)).split(_widths(model), dim=-1)

        def unlikely(values: Array) -> tuple[float, Array]:
            z = torch.from_numpy(values).to(known.y).requires_grad_()
            before, *others = guessed(z)
            later = (
                None if x is None else torch.cat([guess, x])[None]
                for guess, x in zip(others, (known.u, known.y_sim), strict=True)
            )
            parts = model.components(models.Signals(before[None], *later), samples)
            left = (sum(parts.values()) - known.y) / self.error
            loss = (left**2).sum() + (z**2).sum()
            (slope,) = torch.autograd.grad(loss, z)
            return loss.item(), slope.double().cpu().numpy()

        start = np.zeros(len(root))
        found = scipy.optimize.minimize(unlikely, start, jac=True, method="L-BFGS-B").x
        first, *others = guessed(torch.from_numpy(found).to(known.y))
        of_y, of_u = (model.y_mean, model.y_std), (model.u_mean, model.u_std)
        return (
            _before(y, first[samples:], *of_y),
            None if u is None else _before(u, others[0][samples:], *of_u),
            None if slow is None else _before(slow, others[1][samples:], *of_y),
        )


def _widths(model: Model) -> list[int]:
    """Return the numbers of outputs, inputs, and outputs of the base."""
    return [model.ny, model.nu, model.ny if model.uses_simulator else 0]


def _before(known: Array, guess: Tensor, mean: Tensor, std: Tensor) -> Array:
    """Return a signal preceded by rows that are given normalised."""
    return np.concatenate([(guess.double() * std + mean).cpu().numpy(), known])
