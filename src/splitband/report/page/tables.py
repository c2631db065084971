"""Tables of the page."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence

from splitband.evaluation.comparison import Comparison
from splitband.evaluation.protocols import Run
from splitband.evaluation.search import Attempt
from splitband.evaluation.selection import Trial
from splitband.report.page.parts import Cell, Table, number, percent
from splitband.report.page.words import in_words
from splitband.report.tested import errors

_HELD_OUT = (
    "held out",
    "RMSE of forecasts of the last quarter of the training part, fitted to the rest of it: what "
    "the recommendation rests on",
)
_CHANGED = (
    "changed",
    "by how much the forecast of what follows changed once the method knew all training samples",
)
_NOTES = (
    ("from the start", "RMSE of the free run from the first samples to the end of the record"),
    ("forecast", "RMSE of the free run from the end of the training part"),
    ("in interval", "share of the forecast's measured samples in the interval around it"),
    ("fit (s)", "seconds of one fit, mean over the seeds"),
)


def methods(comparison: Comparison) -> Table:
    """A row for each method: errors, mean and deviation over the seeds."""
    trial, tests = comparison.require_trial(), comparison.tests
    ahead = bool(comparison.predictions)
    headings = ["method", "held out", *(["changed"] if ahead else []), "from the start"]
    headings += ["forecast", "in interval"] if ahead else []
    headings += [f"test {test.name or i + 1}" for i, test in enumerate(tests)]
    headings += ["seeds", "fit (s)", "settled on"]
    rows = []
    for name, runs in comparison.runs.items():
        tested = comparison.means[name].errors.tests
        cells = [_error([trial.errors[name]])]
        cells += [_error([trial.change(name)])] if ahead else []
        cells.append(_error([run.total_rmse for run in runs]))
        if ahead:
            covers = comparison.covers(name)
            cells.append(_error([run.forecast_rmse for run in runs]))
            cells.append(Cell(percent(covers), covers))
        cells += [_error([e]) for e in tested] or [Cell("–")] * len(tests)  # noqa: RUF001
        cells += [Cell(str(len(runs)), len(runs)), _seconds(runs)]
        rows.append([Cell(name), *cells, Cell(runs[0].description)])
    marked = [*comparison.runs].index(comparison.recommended)
    rows = [_with_best(rows, i) for i in range(len(rows))]
    empty = [Cell("–")] * (len(headings) - 2)  # noqa: RUF001
    rows += [
        [Cell(name), *empty, Cell(f"could not be fitted: {reason}")]
        for name, reason in trial.failed.items()
        if name not in comparison.runs
    ]
    notes = [note for note in (_HELD_OUT, _CHANGED, *_NOTES) if note[0] in headings]
    notes += [("test", "RMSE of the free run over a test record, mean of the seeds")] * bool(tests)
    notes += [(name, said) for name in comparison.runs if (said := in_words(name))]
    caption = "The methods and their errors, in the record's unit; the lowest of each is bold"
    return Table(caption, headings, rows, frozenset([marked]), notes)


def tests(comparison: Comparison) -> Table:
    """Return the errors on test records by channel, a row for each method that was tested."""
    columns = comparison.record.columns
    names = [name for name, mean in comparison.means.items() if mean.tests]
    headings = [
        f"{test.name or i + 1}: {column}"
        for i, test in enumerate(comparison.tests)
        for column in columns
    ]
    rows = [
        [Cell(name), *(_channel_error(e) for each in errors(comparison, name) for e in each)]
        for name in names
    ]
    marked = [i for i, name in enumerate(names) if name == comparison.recommended]
    caption = "RMSE of each channel of the test records, mean of the seeds"
    return Table(caption, ["method", *headings], rows, frozenset(marked))


def _channel_error(error: float | None) -> Cell:
    return Cell("–") if error is None else Cell(number(error), error)  # noqa: RUF001


def tried(trial: Trial) -> Table:
    """A row for each method of which only a trial has been made."""
    rows = [
        [
            Cell(name),
            _error([error]),
            _error([trial.change(name)]) if name in trial.final else Cell("–"),  # noqa: RUF001
            Cell(in_words(name)),
        ]
        for name, error in trial.errors.items()
    ]
    marked = [*trial.errors].index(trial.recommended)
    rows = [_with_best(rows, i) for i in range(len(rows))]
    return Table(
        "What the methods did on the record's last quarter, in the record's unit",
        ["method", "held out", "changed", "what it is"],
        rows,
        frozenset([marked]),
        (_HELD_OUT, _CHANGED),
    )


def attempts(tried: Sequence[Attempt]) -> Table:
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


def _error(values: Sequence[float]) -> Cell:
    mean = statistics.mean(values)
    text = number(mean)
    if len(set(values)) > 1:
        text += f" ± {statistics.stdev(values):.2g}"
    return Cell(text, mean)


def _with_best(rows: Sequence[Sequence[Cell]], i: int) -> list[Cell]:
    """A row whose lowest errors of their columns are marked."""
    cells = []
    for column, cell in enumerate(rows[i]):
        known = [row[column].value for row in rows]
        error = cell.value is not None and column <= len(rows[i]) - 4 and "%" not in cell.text
        lowest = min((v for v in known if v is not None), default=None)
        best = error and cell.value == lowest
        cells.append(Cell(cell.text, cell.value, best))
    return cells


def _seconds(runs: Sequence[Run]) -> Cell:
    seconds = statistics.mean(run.fit.seconds for run in runs)
    return Cell(f"{seconds:.1f}", seconds)
