"""Figures in the documents: each is in a file of results, where a test looks it up.

docs/results/README.md is made of the run files as a whole. The other documents are written by hand;
a sentence of theirs that states a figure stands in `tests/reproduction/quotes.py`.
"""

from __future__ import annotations

import re
from functools import cache

import pytest

from reproduction.fill import Page
from tests.reproduction.quotes import (
    DEVIATIONS,
    NO_RESULT,
    RELIABILITY,
    RESULTS,
    ROOT,
    RULES,
    TUNING,
    WHOLE,
    one_line,
    quotes,
)

DOCUMENTS = (*WHOLE, DEVIATIONS, RELIABILITY, RULES, TUNING)


@cache
def _document(name: str) -> str:
    return one_line((ROOT / name).read_text(encoding="utf-8"))


def _not_found(document: str, text: str) -> list[str]:
    """The sentences that are not in the document with the figures of the files."""
    return [q.text for q in quotes() if q.document == document and q.text not in text]


def _unknown(document: str, text: str) -> list[str]:
    """The decimal numbers that no sentence, as the files have it, accounts for."""
    for known in (*NO_RESULT, *(q.text for q in quotes() if q.document == document)):
        text = text.replace(known, "")
    return re.findall(r".{0,40}\d\.\d+.{0,20}", text)


@pytest.mark.parametrize("document", DOCUMENTS)
def test_a_quoted_figure_is_the_one_in_its_file(document: str) -> None:
    assert _not_found(document, _document(document)) == []


@pytest.mark.parametrize("document", WHOLE)
def test_every_decimal_number_is_looked_up(document: str) -> None:
    """One that fails here wants an entry in `quotes`, or in `NO_RESULT`."""
    assert _unknown(document, _document(document)) == []


def test_editing_any_figure_is_noticed() -> None:
    for document in WHOLE:
        text = _document(document)
        places = [m.end() - 1 for m in re.finditer(r"\d\.\d+", text)]
        assert len(places) > 1
        for at in places:
            edited = text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :]
            noticed = _not_found(document, edited) or _unknown(document, edited)
            assert noticed, text[at - 40 : at + 20]


@cache
def _results_page() -> str:
    page = Page(RESULTS)
    return str(page.fill((RESULTS / "page.md").read_text(encoding="utf-8")))


def test_the_results_page_is_made_of_the_tables() -> None:
    """Where it is not: `python -m reproduction.fill`."""
    assert (RESULTS / "README.md").read_text(encoding="utf-8") == _results_page()


@pytest.mark.parametrize("name", ["page.md", "causes.md"])
def test_no_figure_of_the_results_page_is_typed_in(name: str) -> None:
    text = (RESULTS / name).read_text(encoding="utf-8")
    assert re.findall(r".*\d.*", re.sub(r"\{\{.+?\}\}", "", text, flags=re.DOTALL)) == []


def test_the_results_page_refuses_what_it_does_not_know() -> None:
    page = Page(RESULTS)
    with pytest.raises(SystemExit, match="asks for guess"):
        page.fill("{{guess v/gru}}")
