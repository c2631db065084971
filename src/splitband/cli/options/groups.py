"""Groups of options as parameters of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from typing import Any, get_type_hints


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """A command for typer: each field of a parameter that is a dataclass is an option of its own.

    Options that several commands share are so written down once, in the order of the fields.
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    parameters = []
    for parameter in inspect.signature(command).parameters.values():
        if parameter.name not in groups:
            parameters.append(parameter.replace(annotation=hints[parameter.name]))
            continue
        of_group = get_type_hints(groups[parameter.name], include_extras=True)
        parameters += [
            parameter.replace(
                name=field.name, default=field.default, annotation=of_group[field.name]
            )
            for field in fields(groups[parameter.name])
        ]

    @wraps(command)
    def expanded(**given: Any) -> None:
        for name, group in groups.items():
            assert isinstance(group, type)
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    # What has a default comes last, as in any signature.
    parameters.sort(key=lambda p: p.default is not inspect.Parameter.empty)
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
    expanded.__signature__ = inspect.Signature(keywords)  # type: ignore[attr-defined]
    expanded.__annotations__ = {p.name: p.annotation for p in parameters}
    return expanded
