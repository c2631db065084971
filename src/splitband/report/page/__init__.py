"""Write results as one self-contained HTML file."""

from functools import cache
from typing import Any

NAME = "report.html"
"""Name of the page's file in the folder of a result."""


@cache
def template(name: str) -> Any:
    """Return a template of this folder."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415  loads slowly

    loader = PackageLoader("splitband.report.page", "")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.trim_blocks = environment.lstrip_blocks = True
    return environment.get_template(name)
