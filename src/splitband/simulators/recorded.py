"""Use a simulator's exported output, from a file or an array."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from splitband.data import Aligned, Grid, Record, Stamp, aligned
from splitband.data.alignment import reach
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr, saved


@saved
@dataclass(frozen=True, eq=False, repr=False)
class Recorded(WithRepr):
    """Hold the exported output of a simulator, at its own times.

    Attributes
    ----------
    y : `(time,)` or `(time, ny)`.
    sampling_time : In s.
    start : Time stamp of the first sample; None if it begins with the record.
    name : Name in messages.
    """

    y: npt.ArrayLike
    sampling_time: float
    start: Stamp | None = None
    name: str = "the exported trajectory"
    own_times: ClassVar[bool] = True
    """Marks a simulator with its own sampling times, which is interpolated to those of a record."""

    @classmethod
    def of(cls, trajectory: Record) -> Recorded:
        """Return the channels of a record as a simulator's output, with its time stamps."""
        return cls(trajectory.y, trajectory.sampling_time, trajectory.start)

    def on(self, grid: Grid) -> Aligned:
        """Return the simulation at other times; raises ValueError if it does not cover them."""
        y = np.asarray(self.y, float)
        y = y[:, None] if y.ndim == 1 else y
        return aligned(self.name, y, self._grid, grid)

    def reach(self, grid: Grid) -> int:
        """Return how many times it covers, from the first of the grid on.

        Raises ValueError if their time stamps cannot be compared.
        """
        try:
            return reach(self._grid, grid)
        except ValueError as error:
            raise InputError(f"{self.name}: {error}") from None

    def note(self, grid: Grid) -> str:
        """Return a description of the resampling to these times; empty without any."""
        covered = min(grid.samples, self.reach(grid))
        return self.on(replace(grid, samples=covered)).note if covered > 0 else ""

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Return the simulation at `time` in s, on the same clock if it has stamps in s."""
        step = float(time[1] - time[0]) if len(time) > 1 else self.sampling_time
        return self.on(Grid(float(time[0]), step, len(time))).values

    @property
    def _grid(self) -> Grid:
        return Grid(self.start, self.sampling_time, len(np.asarray(self.y)))
