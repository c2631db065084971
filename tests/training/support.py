"""What several tests of training share."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from splitband import GRU, Record, TrainingSettings
from splitband.models import Model, Recurrent, Signals, Task
from splitband.models.base import FreeRun
from splitband.runtime.arrays import Array
from splitband.training import History, fit
from splitband.training.optimizers import Adam
from tests.signals import QUICK, SETUP, TRAIN, record
from tests.support import untrained

RECIPE = TrainingSettings.paper(
    40, QUICK.warmup, 4, 16, learning_rate=0.01, one_cycle=True, clip=0.5, growth=0.6
)


def trained(settings: TrainingSettings = RECIPE) -> tuple[Model, History]:
    """A split model of the usual record, and its training."""
    model = untrained("split-gru-conditioned", record()[:TRAIN], SETUP, 3)
    return model, fit(model, record()[:TRAIN], settings, 3)


def parameters(model: Model) -> Tensor:
    """All weights of a model, one after the other."""
    return torch.cat([p.detach().flatten() for p in model.parameters()])


def seen_by_adam(
    monkeypatch: pytest.MonkeyPatch, look: Callable[[dict[str, Any]], Any]
) -> list[Any]:
    """What `look` finds in the optimizer's parameter group before each step."""
    seen: list[Any] = []
    step = Adam.step

    def watched(self: Adam, *arguments: Any, **options: Any) -> Any:
        seen.append(look(self.param_groups[0]))
        return step(self, *arguments, **options)

    monkeypatch.setattr(Adam, "step", watched)
    return seen


def starts_of(ys: Sequence[Array], window: int, warmup: int) -> list[int]:
    """Where windows begin by definition, the samples of all records counted through."""
    found, before = [], 0
    for y in ys:
        for start in range(len(y) - window + 1):
            warm = all(np.isfinite(y[start + n]).all() for n in range(warmup))
            something = any(np.isfinite(y[start + n]).any() for n in range(warmup, window))
            if warm and something:
                found.append(before + start)
        before += len(y)
    return found


GAPS = (slice(30, 36), 70)


def fitted(records: Record | Sequence[Record], method: str = "gru", **changes: Any) -> Model:
    one = records if isinstance(records, Record) else records[0]
    model = untrained(method, one, SETUP, 2)
    fit(model, records, TrainingSettings.paper(**{**vars(QUICK), "epochs": 3, **changes}), seed=2)
    return model


class Watched(Recurrent):
    """Keeps how long each batch of windows was simulated, and their first samples."""

    def __init__(self, hidden_size: int = 4) -> None:
        super().__init__(GRU(hidden_size, 1))
        self.asked: list[int] = []
        self.batches: list[list[int]] = []

    def tasks(self, record: Signals) -> list[Task]:
        def watched(run: Callable[[Signals, int], FreeRun], known: Signals, steps: int) -> FreeRun:
            self.asked.append(steps)
            self.batches.append([round(float(y)) for y in known.y[:, 0, 0]])
            return run(known, steps)

        return [replace(t, run=partial(watched, t.run)) for t in super().tasks(record)]
