"""Tables and numbers in the documents are those of the result files."""

from __future__ import annotations

import difflib
import re
from pathlib import Path

import pytest

from docs.tables import NUMBERS, PAGES, ROOT, numbers_of, with_numbers, with_tables
from docs.tables import written as made

GRU = "{results/demo[methods][gru][forecast_rmse][0]:.2f}"
GIVEN: dict[str, dict[str, str]] = {
    "README.md": {"version of Python": "3.11"},
    "reproduction/REPORT.md": {"finished study, commit 2909be7": "0.141 0.205 0.556"},
    "docs/howto/experiment.md": {
        "properties of what is simulated": "0.45 0.75 1.05",
        "printed by benchmarks.linear": "0.900 0.014 0.889 0.020",
    },
    "docs/results/benchmarks.md": {"sampling rate": "610.35"},
    "docs/results/beyond.md": {"finished study, commit c5ae2c0": "0.182"},
}
"""Numbers of two or more decimals in prose that no result file has, by page and by source."""


def test_tables_and_numbers_are_those_of_the_result_files() -> None:
    """Where they are not: `make figures`."""
    for path, text in made():
        there = path.read_text(encoding="utf-8")
        changes = difflib.ndiff(there.splitlines(), text.splitlines())
        assert [line for line in changes if line[0] in "+-"] == [], path


def test_each_number_in_prose_has_a_source() -> None:
    """Of those with two or more decimals: a table of its page, `NUMBERS`, or `GIVEN`."""
    found = {}
    for path in PAGES:
        page = str(path.relative_to(ROOT))
        numbers = _decimals(path, [words for of, words in NUMBERS if of == page])
        if numbers:
            found[page] = sorted(numbers)
    given = {page: sorted({*" ".join(of.values()).split()}) for page, of in GIVEN.items()}
    assert found == given


def _decimals(path: Path, templates: list[str]) -> set[str]:
    """Return the numbers in a page's sentences that no template covers."""
    text = path.read_text(encoding="utf-8")
    for template in templates:
        for start, end in reversed(numbers_of(text, template)):
            text = text[:start] + text[end:]
    tables = "".join(re.findall(r"^\|.*$", text, re.MULTILINE))
    for left_out in (
        r"^<!--=.*?^<!--/-->",
        r"^```.*?^```",
        r"^\|.*?$",
        r"^    .*?$",
        r"`[^`]*`",
        r"\]\(.*?\)",
        r"\$.*?\$",
    ):
        text = re.sub(left_out, "", text, flags=re.DOTALL | re.MULTILINE)
    number = r"(?<![\d.])\d+\.\d{2,}(?!\.?\d)"
    return {*re.findall(number, text)} - {*re.findall(number, tables)}


def test_a_stale_number_is_written_again_and_the_text_around_it_stays() -> None:
    template = f"A GRU has {GRU} m, or {GRU}"
    text = "A GRU\nhas 9.99 m, or 1,009. At 1.5 Hz.\n"
    assert with_numbers(text, template) == text.replace("9.99", "2.05").replace("1,009", "2.05")
    table = f"<!--={GRU}-->\n| 1 |\n<!--/-->\n"
    assert with_tables(table) == table.replace("| 1 |", "2.05")


def test_a_sentence_must_stand_on_the_page_once() -> None:
    for text in ("none", "has 1 m, has 2 m"):
        with pytest.raises(ValueError, match="must stand once"):
            with_numbers(text, f"has {GRU} m")
