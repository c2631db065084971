"""Tables of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.selection import Trial
from splitband.evaluation.trials import SearchAttempt
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
    listed, trial = columns(comparison), comparison.require_trial()
    kinds = {name: in_words(name, comparison.forecasters) for name in said}
    return _of_columns(caption, listed, said, kinds, trial)


def tried(trial: Trial, record: Record) -> Table:
    """Return the table of a trial: a row for each method."""
    kinds = {name: in_words(name) for name in ordered(trial, trial.errors)}
    caption = "What the methods did on the record's last quarter; the best of each is bold"
    listed = columns_of_trial(trial, record, [*trial.errors])
    return _of_columns(caption, listed, {}, kinds, trial)


def _of_columns(
    caption: str,
    listed: Sequence[Column],
    said: Mapping[str, str],
    kinds: Mapping[str, str],
    trial: Trial,
) -> Table:
    """Return a table of columns, with what is `said` of each method in a last one, if anything.

    Of the methods that need no training, all but the best are folded away.
    """
    rows = [
        [
            Cell(name, says=kinds[name]),
            *(Cell(c.entry(name), c.values.get(name), name == c.best) for c in listed),
            *([Cell(said[name])] if said else []),
        ]
        for name in kinds
    ]
    marked, trained = trial.recommended, trial.trained
    explained = dict.fromkeys((column.heading, column.note) for column in listed)
    headings = ["method", *(column.label for column in listed), *(["settled on"] if said else [])]
    place = frozenset([[*kinds].index(marked)])
    simple = [i for i, name in enumerate(kinds) if name not in trained and i not in place]
    minor = frozenset(simple[1:])  # the best of them is what the others have to be better than
    return Table(caption, headings, rows, place, minor, [*explained])


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
