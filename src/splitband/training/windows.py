"""Cut windows from training records: views of the signals in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from splitband.models import Signals, Task
from splitband.records import Record
from splitband.training.settings import checked_starts


@dataclass(frozen=True, eq=False)
class WindowSet:
    """The windows of training records, one record after the other.

    starts : First samples of the windows, counted over all records.
    measured : Mask of the samples in the loss, `(time, ny)`; None for all samples.
    """

    starts: Tensor
    measured: Tensor | None


def windows_in(records: Sequence[Record], window: int, warmup: int) -> WindowSet:
    """Return all windows within a record with a complete warm-up and a measured sample after it."""
    starts = checked_starts(records, window, warmup)
    measured = np.concatenate([~np.isnan(record.y_with_gaps) for record in records])
    return WindowSet(
        torch.from_numpy(starts), None if measured.all() else torch.from_numpy(measured)
    )


def joined(tasks: Sequence[Task]) -> Task:
    """Join one network's tasks on several records, one after the other."""
    if len(tasks) == 1:
        return tasks[0]

    def end_to_end(signals: Sequence[Tensor | None]) -> Tensor | None:
        parts = [signal for signal in signals if signal is not None]
        return torch.cat(parts) if len(parts) == len(signals) else None

    inputs = [task.known for task in tasks]
    whole = Signals(
        torch.cat([of_record.y for of_record in inputs]),
        end_to_end([of_record.u for of_record in inputs]),
        end_to_end([of_record.y_sim for of_record in inputs]),
    )
    return replace(tasks[0], known=whole, target=torch.cat([task.target for task in tasks]))


def windows(task: Task, window: int, warmup: int) -> tuple[Signals, Tensor]:
    """Return views of a window from every sample on: the known signals, and the target."""
    signals = task.known.map(lambda signal: _views(signal, window))
    return replace(signals, y=signals.y[:, :warmup]), targets(task.target, task, window, warmup)


def targets(signal: Tensor, task: Task, window: int, warmup: int) -> Tensor:
    """Return the predicted samples of a signal `(time, n)`, by window, on the target's device."""
    return _views(signal.to(task.target.device), window)[:, warmup :: task.stride]


def select(signals: Signals, batch: Tensor) -> Signals:
    """Return the windows of a batch, copied."""
    return signals.map(lambda signal: signal[batch])


def _views(signal: Tensor, window: int) -> Tensor:
    return signal.unfold(0, window, 1).transpose(1, 2)
