"""A page as one file: text, style, script and plots, so that it needs no network."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import bokeh
from bokeh.document import Document
from bokeh.embed.util import standalone_docs_json_and_render_items
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from splitband.report.colors import DARK, PALETTE
from splitband.report.page.parts import Page, Plot
from splitband.runtime.files import replacing


def write(page: Page, path: str | Path) -> None:
    """Write a page, whole or not at all."""
    text = html(page)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def html(page: Page) -> str:
    """The whole file."""
    plots = page.plots
    return _template().render(
        page=page,
        ids={id(plot): f"plot-{i}" for i, plot in enumerate(plots)},
        embedded=_embedded(plots) if plots else "",
        library=_library() if plots else "",
        style=_part("style.css"),
        script=_part("page.js"),
        light=PALETTE,
        dark=DARK,
    )


def _embedded(plots: list[Plot]) -> str:
    """The plots as JSON, in one document so that their ranges are shared, safe inside a script."""
    document = Document()
    with document.models.freeze():  # once for all of them, or it takes long
        for plot in plots:
            document.add_root(plot.figure)
    figures = [plot.figure for plot in plots]
    documents, (item,) = standalone_docs_json_and_render_items(figures)
    described: dict[str, Any] = item.to_json()
    described["roots"] = {plot.figure.id: f"plot-{i}" for i, plot in enumerate(plots)}
    text = json.dumps({"documents": documents, "items": [described]}, separators=(",", ":"))
    return text.replace("<", "\\u003c")


@cache
def _template() -> Template:
    loader = PackageLoader("splitband.report.page", "")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["ref"] = id
    return environment.get_template("template.html")


def _part(name: str) -> str:
    return files("splitband.report.page").joinpath(name).read_text(encoding="utf-8")


@cache
def _library() -> str:
    """The script that draws: the core of Bokeh alone, without widgets, tables and formulas."""
    folder = Path(bokeh.__file__).parent / "server" / "static" / "js"
    return (folder / "bokeh.min.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
