"""A simulator that is a Python function of time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.runtime.options import Written

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class Function(Written):
    """A Python callable, `function(time) -> (time,) or (time, ny)`.

    Attributes
    ----------
    function : What to call.
    key : Identifies it and its parameters in the cache of `run`; without one it is not cached.
    """

    function: Callable[[Array], npt.ArrayLike]
    key: str | None = None

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`."""
        return self.function(time)

    def fingerprint(self) -> str | None:
        """The key."""
        return self.key
