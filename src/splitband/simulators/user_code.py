"""What simulators have in common that are Python code of their user's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, Self

from splitband.runtime.options import Written
from splitband.simulators.parameters import Given, Parameters


class UserCode(Written):
    """A dataclass with code of the user's and a field `parameters`."""

    parameters: Given | None

    @cached_property
    def known(self) -> Parameters:
        """Return the parameters, checked."""
        return Parameters(dict(self.parameters or {}))

    def fixed(self, values: Mapping[str, float]) -> Self:
        """Return it with these values of parameters."""
        made = replace(self, parameters=dict(self.known.fixed(values).given))  # type: ignore[type-var]
        return made.opened_by(vars(self).get("_opened_by"))

    def precise(self) -> Self:
        """Return it for derivatives; see `Adjustable`."""
        return self

    def opened_by(self, function: Callable[[Given], Self] | None) -> Self:
        """Return it, for other processes to make by a function of its parameters.

        What a file of the user's defines cannot be sent to them.
        """
        vars(self)["_opened_by"] = function
        return self

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Say how other processes make it."""
        function = vars(self).get("_opened_by")
        if function is None:
            return super().__reduce_ex__(protocol)
        return function, (dict(self.parameters or {}),)
