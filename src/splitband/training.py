"""Training on windows of a record: free runs from a warm-up, compared with what was measured."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import torch
from torch import Tensor

from splitband.data import Trajectory
from splitband.models import Model, Signals, Task
from splitband.threads import one_torch_thread


@dataclass(frozen=True)
class Settings:
    """How to train.

    Attributes
    ----------
    window : Samples of a sub-trajectory, warm-up included; one starts at every sample.
    warmup : R, its measured samples that set the initial state.
    epochs : Passes over all windows (the paper's "training steps").
    batch_size : Windows to a step.
    learning_rate : Of Adam, at the beginning.
    milestones : `(epoch, learning rate)` pairs: the rate from that epoch on.
    normalize : Scale each channel by mean and standard deviation of the training record.
    """

    window: int = 150
    warmup: int = 30
    epochs: int = 300
    batch_size: int = 50
    learning_rate: float = 1e-3
    milestones: tuple[tuple[int, float], ...] = ()
    normalize: bool = True

    def __post_init__(self) -> None:
        """Check ranges."""
        for name in ("warmup", "epochs", "batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.window <= self.warmup:
            raise ValueError(
                f"window must be longer than the warm-up of {self.warmup} samples, "
                f"got {self.window}"
            )
        for epoch, _ in self.milestones:
            if epoch < 0:
                raise ValueError(f"milestones must be at epochs from 0 on, got {epoch}")
        for rate in (self.learning_rate, *(rate for _, rate in self.milestones)):
            if not 0 < rate < float("inf"):
                raise ValueError(f"learning rates must be positive, got {rate}")


@dataclass(frozen=True)
class Progress:
    """Where a training run is: sent after each epoch."""

    task: str
    epoch: int
    epochs: int
    loss: float


@dataclass
class History:
    """What a training run did: the mean loss of each epoch by task, and its run time."""

    losses: dict[str, list[float]] = field(default_factory=dict)
    seconds: float = 0.0


def fit(
    model: Model,
    trajectory: Trajectory,
    settings: Settings | None = None,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
) -> History:
    """Train a model in place (paper, Eqs. 12 and 14).

    Parameters
    ----------
    model : What to train; its initial parameters are the caller's.
    trajectory : The training record, and nothing else: cut it before.
    settings : How.
    seed : For the order of the windows.
    progress : Called after each epoch.

    Raises
    ------
    ValueError
        For a record shorter than a window, or of other channels than the model's.
    FloatingPointError
        When the loss is no longer finite.
    """
    settings = settings or Settings()
    _check_record(model, trajectory, settings)
    model.adapt_to(trajectory, settings.normalize)
    began = time.perf_counter()
    history = History()
    record = model.normalised(trajectory)
    for task in model.tasks(record):
        generator = torch.Generator().manual_seed(seed)  # a network does not depend on the others
        losses = history.losses.setdefault(task.name, [])
        for loss in _train(task, settings, generator):
            losses.append(loss)
            if progress is not None:
                progress(Progress(task.name, len(losses), settings.epochs, loss))
    history.seconds = time.perf_counter() - began
    return history


def _train(task: Task, settings: Settings, generator: torch.Generator) -> Iterator[float]:
    """Train one network; yield the mean loss of each epoch."""
    known, target = _windows(task, settings)
    steps = target.shape[1]
    optimizer = torch.optim.Adam(task.network.parameters(), lr=settings.learning_rate)
    rates = dict(settings.milestones)
    for epoch in range(settings.epochs):
        for group in optimizer.param_groups:
            group["lr"] = rates.get(epoch, group["lr"])
        total = 0.0
        for batch in torch.randperm(len(target), generator=generator).split(settings.batch_size):
            with one_torch_thread():
                seen, wanted = _select(known, batch), target[batch]
            optimizer.zero_grad(set_to_none=True)
            loss = _rmse(task.simulate(seen, steps), wanted)
            loss.backward()
            with one_torch_thread():
                optimizer.step()
            total += loss.item() * len(batch)
        mean = total / len(target)
        if not mean < float("inf"):
            raise FloatingPointError(
                f"training of the {task.name} diverged in epoch {epoch + 1}: the loss is {mean}; "
                f"lower the learning rate ({settings.learning_rate:g})"
            )
        yield mean


def _windows(task: Task, settings: Settings) -> tuple[Signals, Tensor]:
    """All windows of stride 1 as views: what is known of each, and what is to be reproduced."""

    def views(x: Tensor) -> Tensor:
        return x.unfold(0, settings.window, 1).transpose(1, 2)

    u, y_sim = (None if s is None else views(s) for s in (task.known.u, task.known.y_sim))
    known = Signals(views(task.known.y)[:, : settings.warmup], u, y_sim)
    return known, views(task.target)[:, settings.warmup :: task.stride]


def _select(known: Signals, batch: Tensor) -> Signals:
    u, y_sim = (None if s is None else s[batch] for s in (known.u, known.y_sim))
    return Signals(known.y[batch], u, y_sim)


def _rmse(prediction: Tensor, target: Tensor) -> Tensor:
    # A norm, not the root of a mean: its gradient at zero error is zero, not NaN.
    return torch.linalg.vector_norm(prediction - target) / target.numel() ** 0.5


def _check_record(model: Model, trajectory: Trajectory, settings: Settings) -> None:
    if (trajectory.ny, trajectory.nu) != (model.ny, model.nu):
        raise ValueError(
            f"the record must have the model's {model.ny} channel(s) and {model.nu} input(s), "
            f"got {trajectory.ny} and {trajectory.nu}"
        )
    if len(trajectory) < settings.window:
        raise ValueError(
            f"window must fit into the training record of {len(trajectory)} samples, "
            f"got {settings.window}"
        )
