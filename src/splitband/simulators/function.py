"""Use a Python function of time as a simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.runtime.options import Written

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class Function(Written):
    """Call a Python function, `function(time) -> (time,) or (time, ny)`.

    Attributes
    ----------
    function : What to call.
    key : Identifies it and its parameters in the cache of `run`; without one it is not cached.
    """

    function: Callable[[Array], npt.ArrayLike]
    key: str | None = None

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Simulate the measured channels at the times `time` in s."""
        return self.function(time)

    def fingerprint(self) -> str | None:
        """Return the cache key."""
        return self.key
