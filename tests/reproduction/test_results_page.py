"""docs/results/README.md is made of the run files as a whole."""

from __future__ import annotations

import re
from functools import cache

import pytest

from reproduction.fill import PAGES, RESULTS, Page


@cache
def _results_page() -> str:
    page = Page(RESULTS)
    return str(page.fill((PAGES / "results.md").read_text(encoding="utf-8")))


def test_the_results_page_is_made_of_the_tables() -> None:
    """Where it is not: `python -m reproduction.fill`."""
    assert (RESULTS / "README.md").read_text(encoding="utf-8") == _results_page()


@pytest.mark.parametrize("name", ["results.md", "causes.md"])
def test_no_figure_of_the_results_page_is_typed_in(name: str) -> None:
    text = (PAGES / name).read_text(encoding="utf-8")
    assert re.findall(r".*\d.*", re.sub(r"\{\{.+?\}\}", "", text, flags=re.DOTALL)) == []


def test_the_results_page_refuses_what_it_does_not_know() -> None:
    page = Page(RESULTS)
    with pytest.raises(SystemExit, match="asks for guess"):
        page.fill("{{guess v/gru}}")
