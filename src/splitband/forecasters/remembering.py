"""Remember results of slow functions, each computed once and sent to other processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

import numpy as np
import torch

from splitband.runtime.threads import one_thread
from splitband.training.checkpoints import key_of

Result = TypeVar("Result")


class Remembered(Generic[Result]):
    """Compute a function of arrays and numbers, or of lists of them, once for the same arguments.

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
        key = key_of(*_parts(arguments))
        if key not in self.results:
            with one_thread():
                self.learn({key: self.function(*arguments)})
        return self.results[key]

    def learn(self, results: Mapping[str, Result]) -> None:
        """Take over `results` of another process."""
        self.results |= results
        for key in [*self.results][: -self.most]:
            del self.results[key]


def _parts(value: Any) -> Iterator[Any]:
    """Yield what lists hold, arrays as tensors."""
    if isinstance(value, list | tuple):
        for part in value:
            yield from _parts(part)
    else:
        yield torch.from_numpy(np.array(value)) if isinstance(value, np.ndarray) else value
