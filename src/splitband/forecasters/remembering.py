"""Remember results of slow functions, each computed once and sent to other processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

import numpy as np
import torch

from splitband.runtime.threads import one_thread
from splitband.training.checkpoints import key_of

Result = TypeVar("Result")


class Remembered(Generic[Result]):
    """Compute a function of arrays and numbers once for the same arguments.

    Arguments are compared by content. It is computed on one thread, so that the result is the same
    to the bit in whichever process that is.

    Parameters
    ----------
    function : What to compute; its results must not depend on anything else.
    most : How many results to keep, the latest ones.

    Attributes
    ----------
    results : By a hash of the arguments.
    """

    def __init__(self, function: Callable[..., Result], most: int = 64) -> None:
        self.function, self.most = function, most
        self.results: dict[str, Result] = {}

    def __call__(self, *arguments: Any) -> Result:
        """Return `function(*arguments)`."""
        parts = (torch.from_numpy(np.array(a)) if isinstance(a, np.ndarray) else a
                 for a in arguments)  # fmt: skip
        key = key_of(*parts)
        if key not in self.results:
            with one_thread():
                self.learn({key: self.function(*arguments)})
        return self.results[key]

    def learn(self, results: Mapping[str, Result]) -> None:
        """Take over `results` of another process."""
        self.results |= results
        for key in [*self.results][: -self.most]:
            del self.results[key]
