"""Cache the results of slow functions, which are computed once and sent to other processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Generic, TypeVar

from splitband.runtime.keys import key_of
from splitband.runtime.threads import one_thread

Result = TypeVar("Result")


class Cached(Generic[Result]):
    """Cache a function of arrays and numbers, or of lists of them.

    Arguments are compared by content. The function runs on one thread, so that its result is equal
    to the bit in every process.

    Parameters
    ----------
    function : What to compute; its results must depend on its arguments only.
    most : Number of results to keep; the oldest are dropped.

    Attributes
    ----------
    results : By a hash of the arguments.
    """

    def __init__(self, function: Callable[..., Result], most: int = 64) -> None:
        self.function, self.most = function, most
        self.results: dict[str, Result] = {}

    def __call__(self, *arguments: Any) -> Result:
        """Return `function(*arguments)`, computed at the first call."""
        key = key_of(*_parts(arguments))
        if key not in self.results:
            with one_thread():
                self.learn({key: self.function(*arguments)})
        return self.results[key]

    def forget(self, *arguments: Any) -> None:
        """Drop the result for these arguments."""
        self.results.pop(key_of(*_parts(arguments)), None)

    def learn(self, results: Mapping[str, Result]) -> None:
        """Add `results`, such as those of another process."""
        self.results |= results
        for key in [*self.results][: -self.most]:
            del self.results[key]


def _parts(value: Any) -> Iterator[Any]:
    """Yield the elements of nested lists."""
    if isinstance(value, list | tuple):
        for part in value:
            yield from _parts(part)
    else:
        yield value
