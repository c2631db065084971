"""Say at which time a simulator begins, which inputs drive it, and what of it is measured."""

from __future__ import annotations

import inspect
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, TypeVar

from splitband.data import Stamp
from splitband.data.signals import bare_name
from splitband.data.timing import in_words, seconds_of
from splitband.simulators.sources import check_open, wanted_arguments

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
    """Return the simulator for records with these channels and inputs, see `Fmu.matched`.

    Raises ValueError for one that needs inputs, which the records do not have, and for one that may
    be meant to take those that they have.
    """
    match = getattr(simulator, "matched", None)
    found: Any_simulator = simulator if match is None else match(columns, inputs)
    driven, name = is_driven(found), getattr(found, "name", "") or type(found).__name__
    if not inputs and getattr(found, "needs_inputs", driven):
        raise ValueError(
            f"simulator {name} takes inputs, of which the record has none: name them (--inputs), "
            "or leave the argument out"
        )
    if inputs and not driven:
        check_undriven(found, name, inputs)
    return found


def check_undriven(simulator: Any, name: str, inputs: Sequence[str] = ()) -> None:
    """Raise ValueError for a simulator that is not driven, but may be meant to take the inputs."""
    code = [] if hasattr(simulator, "driven") else [getattr(simulator, "simulate", None)]
    named = {bare_name(each) for each in inputs}
    for function in getattr(simulator, "code", code):
        arguments = [each for each in _arguments(function).values() if _is_open(each, named)]
        check_open([str(each.replace(annotation=each.empty)) for each in arguments], name)


def _is_open(argument: inspect.Parameter, inputs: Collection[str]) -> bool:
    """Return whether an argument that can be left out may be a record's inputs."""
    gathers = argument.kind in (argument.VAR_POSITIONAL, argument.VAR_KEYWORD)
    return gathers or argument.default is None or argument.name in inputs


def check_places(function: Any, *places: str) -> None:
    """Raise ValueError if arguments of the user's function have the names of other places."""
    given = {name: i for i, name in enumerate(_places(function))}
    if any(given.get(name, places.index(name)) != places.index(name) for name in ("u", "p")):
        raise ValueError(
            f"a simulator's function must have the arguments ({', '.join(places)}), in this order "
            f"and without gaps: got ({', '.join(given)})"
        )


def origin(simulator: Any, stamp: Stamp | None) -> float:
    """Return the time in s at which a simulator runs at a record's first sample.

    Raises ValueError where that can be two things: for a function of time alone that does not say
    whether it means the record's clock.
    """
    start, begin = check_start(getattr(simulator, "start", None)), seconds_of(stamp)
    if start == "record":
        if stamp is not None and not isinstance(stamp, float):
            raise ValueError(
                'start (--simulator-start) must be a number of seconds, not "record", for a record '
                f"whose clock shows dates: it begins at {in_words(stamp)}"
            )
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
    places = _places(function)
    required = sum(each.default is each.empty for each in places.values())
    return wanted_arguments([*places], required)


def _places(function: Any) -> dict[str, inspect.Parameter]:
    """Return the positional arguments of a function; none if they are unknown."""
    kinds = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD
    return {name: each for name, each in _arguments(function).items() if each.kind in kinds}


def _arguments(function: Any) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):
        return {}
