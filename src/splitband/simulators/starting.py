"""Say at which time a simulator begins, which inputs drive it, and what of it is measured."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from typing import Any, Literal, TypeVar

from splitband.data import Stamp
from splitband.data.timing import in_words, seconds_of
from splitband.simulators.sources import wanted_arguments

Start = float | Literal["record"]
"""Time of a record's first sample in s, or "record" for its time stamp."""

Any_simulator = TypeVar("Any_simulator")


def check_start(start: Any) -> Any:
    """Return a simulator's `start` if it is one; raises ValueError otherwise."""
    if start is None or start == "record":
        return start
    try:
        seconds = math.nan if isinstance(start, bool) else float(start)
    except (TypeError, ValueError):
        seconds = math.nan
    if not math.isfinite(seconds):
        raise ValueError(f'start must be a number of seconds or "record", got {start!r}')
    return seconds


def is_driven(simulator: Any) -> bool:
    """Return whether a simulator takes a record's inputs: its own word, or `simulate(time, u)`."""
    driven = getattr(simulator, "driven", None)
    return count_arguments(simulator.simulate) > 1 if driven is None else bool(driven)


def matched(
    simulator: Any_simulator, columns: Sequence[str], inputs: Sequence[str]
) -> Any_simulator:
    """Return the simulator for records with these channels and inputs, see `Fmu.matched`."""
    match = getattr(simulator, "matched", None)
    found: Any_simulator = simulator if match is None else match(columns, inputs)
    return found


def origin(simulator: Any, stamp: Stamp | None) -> float:
    """Return the time in s at which a simulator runs at a record's first sample.

    Raises ValueError where that can be two things: for a function of time alone that does not say
    whether it means the record's clock.
    """
    start, begin = check_start(getattr(simulator, "start", None)), seconds_of(stamp)
    if start == "record":
        return begin
    if start is None and begin and not is_driven(simulator):
        assert stamp is not None
        raise ValueError(
            f'start must be given (--simulator-start) for a function of time: "record" if it means '
            f"the record's clock, which begins at {in_words(stamp)}, 0 if its time begins at the "
            "first sample"
        )
    return float(start or 0.0)


def count_arguments(function: Any) -> int:
    """Return the number of arguments that a function is to be given; 0 if it is unknown."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    try:
        given = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return 0
    places = [each for each in given if each.kind in kinds]
    required = sum(each.default is each.empty for each in places)
    return wanted_arguments([each.name for each in places], required)
