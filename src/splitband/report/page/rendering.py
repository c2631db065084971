"""Fill the templates of pages; without Bokeh, so that a notebook shows a table at once."""

from __future__ import annotations

from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined, Template


@cache
def template(name: str) -> Template:
    """Return a template of this folder."""
    environment = Environment(
        loader=PackageLoader("splitband.report.page", ""), autoescape=True,
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template(name)


def macros() -> Any:
    """Return the macros that pages and notebooks share."""
    return template("macros.html").module
