"""Train on windows of a record: free runs from a warm-up are compared with measurements."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from splitband.models import Model
from splitband.records import Record
from splitband.runtime.deadlines import Deadline, current
from splitband.runtime.errors import InputError
from splitband.runtime.memory import freed_memory_kept
from splitband.training.network import NetworkTraining
from splitband.training.settings import History, Progress, TrainingSettings
from splitband.training.windows import joined, windows_in


def fit(
    model: Model,
    records: Record | Sequence[Record],
    settings: TrainingSettings,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
) -> History:
    """Train a model in place (Ensinger et al. 2023, Eq. 10, training, and Eq. 12, hybrid loss).

    A window lies within one record, its warm-up has no gap, and its loss counts measured samples
    only. An epoch with a diverging (see `DIVERGED`) or non-finite loss is repeated from its start
    with half the learning rate, and the history notes the restart. At the deadline of the job
    (`runtime.deadlines`) training stops with the current weights; several networks share the
    remaining time equally.

    model : The model, with initial parameters.
    records : The training record, without samples to predict, or several records of one system.
    seed : Fixes the order of the windows.
    progress : Called after each epoch.
    """
    records = [records] if isinstance(records, Record) else [*records]
    chosen = windows_in(records, settings.window, settings.warmup)
    model.adapt_to(records, settings.normalize)
    began = time.perf_counter()
    history = History()
    signals = [model.normalised(record) for record in records]
    tasks = [joined(of_records) for of_records in zip(*map(model.tasks, signals), strict=True)]
    for task in tasks:
        if settings.warmup < task.stride:
            raise InputError(
                f"warmup must be at least {task.stride} samples for the {task.name}, which is "
                f"down-sampled by {task.stride}, got {settings.warmup}"
            )
    for done, task in enumerate(tasks):
        # All networks get the same seed: a training does not depend on the other ones.
        deadline = Deadline.after(current().left / (len(tasks) - done))
        training = NetworkTraining(task, chosen, settings, seed, deadline, driven=model.nu > 0)
        losses = history.losses[task.name] = training.losses
        with freed_memory_kept():
            while not training.over:
                training.advance()
                if progress is not None:
                    part = 1 if training.over else len(losses) / training.passes
                    share = (done + part) / len(tasks)
                    progress(Progress(task.name, len(losses), training.passes, losses[-1], share))
        training.end()
        history.notes += [f"{task.name}: {note}" for note in training.notes]
        history.cut |= training.cut
    history.seconds = time.perf_counter() - began
    return history
