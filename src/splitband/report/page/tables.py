"""Tables of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.search import SearchAttempt
from splitband.evaluation.selection import Trial
from splitband.report.numbers import number
from splitband.report.page.parts import Cell, Table
from splitband.report.page.words import in_words
from splitband.report.table import Column, columns, ordered, remarks
from splitband.report.table import tried as columns_of_trial


def methods(comparison: Comparison) -> Table:
    """Return the table of a comparison: a row for each method."""
    said = remarks(comparison)
    caption = (
        "The methods and their errors, each channel in its own unit; the best of each is bold"
        if comparison.record.ny > 1
        else "The methods and their errors, in the record's unit; the best of each is bold"
    )
    made = comparison.forecasters
    notes = [(name, words) for name in comparison.runs if (words := in_words(name, made))]
    listed = columns(comparison)
    return _of_columns(caption, listed, said, "settled on", comparison.recommended, notes)


def tried(trial: Trial, record: Record) -> Table:
    """Return the table of a trial: a row for each method."""
    said = {name: in_words(name) for name in ordered(trial, trial.errors)}
    caption = "What the methods did on the record's last quarter; the best of each is bold"
    listed = columns_of_trial(trial, record, [*trial.errors])
    return _of_columns(caption, listed, said, "what it is", trial.recommended)


def _of_columns(
    caption: str,
    listed: Sequence[Column],
    said: Mapping[str, str],
    last: str,
    marked: str,
    notes: Sequence[tuple[str, str]] = (),
) -> Table:
    """Return a table of columns, `last` headed by what is said of each method."""
    rows = [
        [
            Cell(name),
            *(Cell(c.entry(name), c.values.get(name), name == c.best) for c in listed),
            Cell(words),
        ]
        for name, words in said.items()
    ]
    explained = dict.fromkeys((column.heading, column.note) for column in listed)
    headings = ["method", *(column.label for column in listed), last]
    return Table(caption, headings, rows, frozenset([[*said].index(marked)]), [*explained, *notes])


def attempts(tried: Sequence[SearchAttempt]) -> Table:
    """How networks were trained to find out how to train them."""
    rows = [
        [
            Cell(each.method),
            Cell(each.training),
            Cell(str(each.seeds), each.seeds),
            Cell(number(each.score), each.score),
        ]
        for each in tried
    ]
    lowest = min((r[3].value for r in rows if r[3].value is not None), default=None)
    marked = frozenset(i for i, row in enumerate(rows) if row[3].value == lowest)
    return Table(
        "What was tried, in that order; the score is the RMSE on held-out samples, of channels "
        "scaled to a deviation of 1",
        ["method", "training", "seeds", "score"],
        rows,
        marked,
    )


def plain(caption: str, columns: Sequence[str], values: Sequence[Sequence[float]]) -> Table:
    """A table of numbers."""
    return Table(caption, columns, [[Cell(number(v), v) for v in row] for row in values])


def flat(facts: Mapping[str, object], before: str = "") -> list[tuple[str, str]]:
    """Nested facts as pairs of a name and a text, without those that are not there."""
    pairs: list[tuple[str, str]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            pairs += flat(value, f"{before}{name} ")
        elif value not in (None, "", (), [], {}):
            text = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
            pairs.append((f"{before}{name}".replace("_", " "), text))
    return pairs
