"""Define the model of one network on the whole band."""

from __future__ import annotations

from typing import Any

from splitband.models.base import FreeRun, Model, Signals, Task, as_module, inputs_of
from splitband.models.stepping import Run, Stepped, SteppedCell
from splitband.networks import Cell, rollout
from splitband.networks.layers import Tensor
from splitband.runtime.arrays import Array


class SteppedRecurrent(Stepped):
    """The step form of `Recurrent`."""

    def __init__(self, model: Any) -> None:
        super().__init__(model)
        self.cell = SteppedCell(model.cell)

    def _begin(self, y: Array, u: Array, slow: Array) -> Run:
        return self.cell.begin(y, self._rows(u))

    def _advance(self, run: Run, u: Array, slow: Array) -> tuple[Run, Array]:
        run = self.cell.advance(run, self._rows(u)[0])
        return run, run["y"]


class Recurrent(Model):
    """One network on the whole band, the paper's baseline (Sec. 4.1).

    cell : The network.
    feedthrough : The step to a sample also uses the inputs at its time: the cell has twice the
        model's inputs, see `base.with_next_input`. The paper has no inputs.
    """

    steps = SteppedRecurrent

    def __init__(self, cell: Cell, feedthrough: bool = False) -> None:
        super().__init__(cell.ny, inputs_of(cell, 0, feedthrough))
        self.cell, self.feedthrough = cell, feedthrough

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Return the network's free run."""
        return {"network": rollout(self.cell, *self._run(known, steps))}

    def tasks(self, record: Signals) -> list[Task]:
        """Return one task, with the record as the target."""
        return [Task("network", as_module(self.cell), record, record.y, self._run)]

    def _run(self, known: Signals, steps: int) -> FreeRun:
        return known.y, steps, self._rows(known.u)
