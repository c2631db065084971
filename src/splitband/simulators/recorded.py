"""A simulator's trajectory that was exported to a file or array."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.data import Aligned, Grid, Record, Stamp, aligned
from splitband.data.alignment import reach
from splitband.runtime.options import Written

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Recorded(Written):
    """An exported trajectory: a simulation made elsewhere, at times of its own.

    Attributes
    ----------
    y : `(time,)` or `(time, ny)`.
    sampling_time : In s.
    start : Time stamp of the first sample; None for one that begins with the record.
    """

    y: npt.ArrayLike
    sampling_time: float
    start: Stamp | None = None

    @classmethod
    def of(cls, trajectory: Record) -> Recorded:
        """The trajectory of a file that `read` has read, with its time stamps."""
        return cls(trajectory.y, trajectory.sampling_time, trajectory.start)

    def on(self, grid: Grid) -> Aligned:
        """The trajectory at other times; raises ValueError where it does not cover them."""
        y = np.asarray(self.y, float)
        y = y[:, None] if y.ndim == 1 else y
        return aligned("the exported trajectory", y, self._grid, grid)

    def reach(self, grid: Grid) -> int:
        """How many times, counted on from the first of the grid, it covers."""
        return reach(self._grid, grid)

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`; with time stamps in s, `time` is on the same clock."""
        step = float(time[1] - time[0]) if len(time) > 1 else self.sampling_time
        return self.on(Grid(float(time[0]), step, len(time))).values

    @property
    def _grid(self) -> Grid:
        return Grid(self.start, self.sampling_time, len(np.asarray(self.y)))
