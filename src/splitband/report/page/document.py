"""Write a page as one file for use without a network: text, style, script and plots."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import bokeh
from bokeh.document import Document
from bokeh.embed.util import standalone_docs_json_and_render_items

from splitband.comparison.result import Comparison
from splitband.report.colors import DARK, PALETTE
from splitband.report.page import pages, template
from splitband.report.page.charts import Chart
from splitband.report.page.parts import Page, Usage
from splitband.runtime.files import write_text


def of_comparison(result: Comparison, path: str | Path, usage: Usage | None = None) -> None:
    """Write the page of a comparison, whole or not at all; it shows `usage`."""
    write(pages.of_comparison(result, usage or Usage()), path)


def write(page: Page, path: str | Path) -> None:
    """Write a page, whole or not at all."""
    write_text(path, html(page))


def html(page: Page) -> str:
    """Return the page as HTML."""
    plots = page.plots
    return template("template.html").render(
        page=page,
        embedded=_embedded(plots) if plots else "",
        library=_library() if plots else "",
        style=_part("style.css"),
        script=_part("page.js"),
        light=PALETTE,
        dark=DARK,
    )


def _embedded(plots: Sequence[Chart]) -> str:
    """Return the plots as JSON, safe inside a script; one document, for common ranges."""
    document = Document()
    with document.models.freeze():  # one update for all plots: faster
        for plot in plots:
            document.add_root(plot.figure)
    figures = [plot.figure for plot in plots]
    documents, (item,) = standalone_docs_json_and_render_items(figures)
    described: dict[str, Any] = item.to_json()
    described["roots"] = {plot.figure.id: f"plot-{i}" for i, plot in enumerate(plots)}
    text = json.dumps({"documents": documents, "items": [described]}, separators=(",", ":"))
    return text.replace("<", "\\u003c")


def _part(name: str) -> str:
    return files("splitband.report.page").joinpath(name).read_text(encoding="utf-8")


@cache
def _library() -> str:
    """Return Bokeh's core script, without widgets, tables and formulas."""
    folder = Path(bokeh.__file__).parent / "server" / "static" / "js"
    return (folder / "bokeh.min.js").read_text(encoding="utf-8").replace("</script", "<\\/script")
