"""Say how a training goes, while it runs and when it has ended."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Progress:
    """Report the progress of a training, after each epoch."""

    task: str
    epoch: int
    epochs: int
    loss: float
    share: float
    """Share of the whole training that is done, 0 to 1."""


@dataclass
class History:
    """Hold the mean loss of each epoch by task, and the run time of a training."""

    losses: dict[str, list[float]] = field(default_factory=dict)
    """The losses of the epochs, followed by those of the rounds of L-BFGS in the same unit."""
    seconds: float = 0.0
    notes: list[str] = field(default_factory=list)
    """What went wrong in training, in words."""
    cut: bool = False
    """Whether a deadline ended the training early."""
