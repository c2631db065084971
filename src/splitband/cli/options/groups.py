"""Let a command take groups of options as dataclasses."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import is_dataclass
from functools import wraps
from typing import Any, get_type_hints

import typer


def panel(title: str) -> Callable[..., Any]:
    """Return a function that creates options in one panel of the help.

    It takes the help text, the name of the value, the default to show if it differs from the
    actual one, the names of the option, and further arguments of `typer.Option`.
    """

    def option(
        does: str, value: str | None = None, usual: str | bool = True, *names: str, **more: Any
    ) -> Any:
        return typer.Option(
            *names, help=does, metavar=value, show_default=usual, rich_help_panel=title, **more
        )

    return option


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command for typer in which each field of a dataclass parameter is an option.

    Thus options that several commands share are defined once. Groups may be nested.
    """
    # Parameters with a default come last, as in any signature.
    options = sorted(_options(command), key=lambda option: option.default is not option.empty)

    @wraps(command)
    def expanded(**given: Any) -> None:
        command(**_grouped(command, given))

    expanded.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in options}
    return expanded


def _options(owner: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    hints = get_type_hints(owner, include_extras=True)
    for parameter in inspect.signature(owner).parameters.values():
        hint = hints[parameter.name]
        if is_dataclass(hint) and isinstance(hint, type):
            yield from _options(hint)
        else:
            yield parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY)


def _grouped(owner: Callable[..., Any], given: Mapping[str, Any]) -> dict[str, Any]:
    hints = get_type_hints(owner)
    return {
        name: hints[name](**_grouped(hints[name], given))
        if is_dataclass(hints[name])
        else given[name]
        for name in inspect.signature(owner).parameters
    }
