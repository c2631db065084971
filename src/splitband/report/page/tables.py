"""Make the tables of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.recommendation import Trial
from splitband.evaluation.search import Attempt
from splitband.report.environment import environment
from splitband.report.numbers import number
from splitband.report.page.parts import Cell, Section, Table, Usage
from splitband.report.table import Column, columns, ordered, remarks
from splitband.report.table import tried as columns_of_trial
from splitband.report.words import in_words


def methods(comparison: Comparison) -> Table:
    """Return the table of a comparison: a row for each method."""
    said = remarks(comparison)
    caption = (
        "The methods and their errors, each channel in its own unit; the best of each is bold"
        if comparison.record.ny > 1
        else "The methods and their errors, in the record's unit; the best of each is bold"
    )
    listed, trial = columns(comparison), comparison.require_trial()
    kinds = {name: in_words(name, comparison.methods) for name in said}
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
    """Return a table of columns; below the name of a method are its kind and remarks (`said`).

    Baselines are folded away, except a recommended one and the best of the others.
    """
    rows = [
        [
            Cell(name, says="; ".join(filter(None, [kinds[name], said.get(name)]))),
            *(Cell(c.entry(name), c.values.get(name), name == c.best) for c in listed),
        ]
        for name in kinds
    ]
    marked, trained = trial.recommended, trial.trained
    explained = dict.fromkeys((column.heading, column.note) for column in listed)
    headings = ["method", *(column.label for column in listed)]
    place = frozenset([[*kinds].index(marked)])
    simple = [i for i, name in enumerate(kinds) if name not in trained and i not in place]
    minor = frozenset(simple[1:])  # the best of them is the reference
    return Table(caption, headings, rows, place, minor, [*explained])


def attempts(tried: Sequence[Attempt]) -> Table:
    """Return the table of the search for how to train networks."""
    rows = [
        [
            Cell(each.method),
            Cell(each.training),
            Cell(str(each.round), each.round),
            Cell(number(each.score), each.score),
        ]
        for each in tried
    ]
    lowest = min((r[3].value for r in rows if r[3].value is not None), default=None)
    marked = frozenset(i for i, row in enumerate(rows) if row[3].value == lowest)
    return Table(
        "What was tried, in that order; the score is the RMSE on held-out samples, in standard "
        "deviations of each output",
        ["method", "training", "round", "score"],
        rows,
        marked,
    )


def next_steps(used: Usage) -> list[Section]:
    """Return the section of the commands that use the model, if there are any."""
    return [Section("next", "What to do next", code=used.commands)] if used.commands else []


def settings(facts: list[tuple[str, str]], used: Usage) -> Section:
    """Return the section of settings and versions."""
    made = environment()
    pairs = [("command", used.asked)] if used.asked else []
    versions = ", ".join(f"{name} {v}" for name, v in made["versions"].items())
    pairs += [*facts, ("versions", versions), ("machine", made["machine"])]
    pairs += [("commit", made["commit"])] if made["commit"] else []
    return Section("settings", "Settings and versions", facts=pairs, folded=True)


def flat(facts: Mapping[str, object], before: str = "") -> list[tuple[str, str]]:
    """Return nested facts as pairs of a name and a text, without empty ones."""
    pairs: list[tuple[str, str]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            pairs += flat(value, f"{before}{name} ")
        elif value not in (None, "", (), [], {}):
            text = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
            pairs.append((f"{before}{name}".replace("_", " "), text))
    return pairs
