"""Figures in the documents are those of the result files."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import pytest

from docs.figures_in_text import FIGURE, ROOT, filled, pages

GRU = "{results/demo[methods][gru][forecast_rmse][0]:.2f}"
PAGES = [str(page.relative_to(ROOT)) for page in pages()]


@pytest.mark.parametrize("page", PAGES)
def test_the_figures_of_a_page_are_those_of_the_result_files(page: str) -> None:
    """Where they are not: `make figures`."""
    text = (ROOT / page).read_text(encoding="utf-8")
    stale = [
        line
        for line in difflib.ndiff(text.splitlines(), filled(text).splitlines())
        if line[0] in "+-"
    ]
    assert stale == []


@pytest.mark.parametrize("page", PAGES)
def test_no_digits_touch_a_figure(page: str) -> None:
    """Such as what is left of a number that was typed in."""
    text = (ROOT / page).read_text(encoding="utf-8")
    assert re.findall(r"[\d.]<!--=.*|<!--/-->\.?\d.*", text) == []


def test_a_stale_figure_is_written_again_and_the_text_around_it_stays() -> None:
    text = f"A GRU has <!--={GRU}-->9.99<!--/--> m, at 1.5 Hz.\n"
    assert filled(text) == text.replace("9.99", "2.05")
    table = f"<!--={GRU}-->\n| 1 |\n<!--/-->\n"
    assert filled(table) == table.replace("| 1 |", "2.05")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"a <!--={GRU}-->1", "must stand between"),
        ("a 1<!--/-->", "must stand between"),
        (f"a\n<!--={GRU}-->1<!--/--> m", "must not begin with"),
        ("a <!--={results/none[x]}-->1<!--/-->", "results/none"),
        ("a <!--={results/demo[nothing]}-->1<!--/-->", "nothing"),
        ("a <!--={results/demo[methods].gru}-->1<!--/-->", "gru"),
    ],
)
def test_what_cannot_be_written_is_refused(text: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        filled(text)


def test_figures_do_not_show_in_a_viewer() -> None:
    """By the Markdown parser of the site: inline, and around tables, comments print nothing."""
    markdown = pytest.importorskip("markdown_it", reason="pip install 'splitband[docs]'")
    parser = markdown.MarkdownIt("commonmark").enable("table")
    for page in PAGES:
        text = Path(ROOT / page).read_text(encoding="utf-8")
        bare = FIGURE.sub(r"\3\4\5", text)
        shown, expected = (
            " ".join(re.sub(r"<!--.*?-->", "", parser.render(t), flags=re.DOTALL).split())
            for t in (text, bare)
        )
        assert shown == expected, page
