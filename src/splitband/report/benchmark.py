"""Summarise the comparisons of many records: a row for each, and medians over all."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pandas as pd

from splitband.report.numbers import number, percent


@dataclass(frozen=True)
class Row:
    """Hold the result of the comparison of one case.

    An error is the RMSE of the median over seeds, divided by the standard deviation of the
    predicted samples: 1 is as good as their mean. With several outputs it is the root mean square
    over them.

    Attributes
    ----------
    name : Name of the case.
    protocol : "test" if there are test records (an error is the mean over them), else "forecast".
    recommended : The method chosen by training samples alone.
    error : Its error; None if it was not tested, or the record is constant.
    best : The method with the lowest error, known only in hindsight.
    best_error : Its error.
    held : Share of the forecast's measured samples in the recommended method's interval, 0 to 1;
        None if nothing was forecast.
    seconds : Run time of the comparison, in the call that finished it.
    failed : Why there is no comparison; empty if there is one.
    """

    name: str
    protocol: str = ""
    recommended: str = ""
    error: float | None = None
    best: str = ""
    best_error: float | None = None
    held: float | None = None
    seconds: float | None = None
    failed: str = ""

    @property
    def fit(self) -> float | None:
        """Return the recommended method's fit, 100 (1 - error) %; None if it has no error."""
        return None if self.error is None else 100 * (1 - self.error)

    @property
    def regret(self) -> float | None:
        """Return the recommended method's error divided by the lowest error; 1 is ideal.

        None if either is missing, or only the lowest is 0.
        """
        if self.error is None or self.best_error is None:
            return None
        if self.error == self.best_error:
            return 1.0
        return self.error / self.best_error if self.best_error else None

    @classmethod
    def of(cls, name: str, facts: Mapping[str, Any]) -> Row:
        """Return the row of a comparison's results.json, to which `seconds` has been added.

        Raises
        ------
        KeyError
            If an entry is missing there.
        """
        protocol = "test" if facts.get("tests") else "forecast"
        methods, chosen = facts["methods"], facts["recommended"]
        fits = [c for c in facts["table"] if c["heading"] == f"{protocol} fit %"]
        found = {method: _error(fits, method) for method in methods}
        errors = {method: error for method, error in found.items() if error is not None}
        best = min(errors, key=lambda method: errors[method], default="")
        return cls(
            name,
            protocol,
            chosen,
            errors.get(chosen),
            best,
            errors.get(best),
            methods[chosen]["interval"].get("covers"),
            facts["seconds"],
        )

    @property
    def note(self) -> str:
        """Return why numbers are missing; empty if there is nothing to say."""
        if self.failed:
            return f"failed: {self.failed}"
        if self.protocol == "test" and self.error is None:
            return f"{self.recommended} was not tested: see the case's own results"
        return ""

    def as_json(self) -> dict[str, Any]:
        """Return the row as in results.json and table.csv."""
        return {**vars(self), "fit": self.fit, "regret": self.regret}


def _error(fits: Sequence[Mapping[str, Any]], method: str) -> float | None:
    """Return a method's error, from its fits to each output of each record; None without any."""
    known: dict[str, list[float]] = {}
    for column in fits:
        if method in column["values"]:
            error = 1 - column["values"][method] / 100
            known.setdefault(column.get("record", ""), []).append(error)
    each = [math.hypot(*errors) / math.sqrt(len(errors)) for errors in known.values()]
    return statistics.mean(each) if each else None


@dataclass(frozen=True)
class CaseColumn:
    """Say what a column shows of each case.

    Attributes
    ----------
    heading, note : What it is called, and what it means.
    value : Gives the value for a row; None if the row has none.
    show : Formats a number; None for a column of text.
    ideal : The best possible value, if it is the same for all cases.
    """

    heading: str
    value: Callable[[Row], Any]
    show: Callable[[float], str] | None = None
    note: str = ""
    ideal: float | None = None

    def entry(self, row: Row) -> str:
        """Return the text of a row's cell."""
        value = self.value(row)
        if self.show is None:
            return str(value)
        return number(None) if value is None else self.show(value)


COLUMNS = (
    CaseColumn("case", lambda row: row.name),
    CaseColumn("of", lambda row: row.protocol),
    CaseColumn(
        "fit %", lambda row: row.fit, "{:.1f}".format,
        "100 (1 - error) of the recommended method: 100 is perfect, 0 as good as the mean",
    ),
    CaseColumn("recommended", lambda row: row.recommended),
    CaseColumn("best", lambda row: row.best),
    CaseColumn(
        "error", lambda row: row.error, number,
        "its RMSE over the standard deviation of the predicted samples; of several outputs the "
        "root mean square",
    ),
    CaseColumn(
        "regret", lambda row: row.regret, number,
        "the recommended method's error over the lowest one; 1 is ideal", 1.0,
    ),
    CaseColumn(
        "in interval", lambda row: row.held, percent,
        "share of the forecast's samples in the recommended method's interval",
    ),
    CaseColumn("seconds", lambda row: row.seconds, number),
    CaseColumn("note", lambda row: row.note),
)  # fmt: skip
"""The columns that the terminal and the page show."""


def table(rows: Sequence[Row]) -> pd.DataFrame:
    """Return a line for each case, as in table.csv."""
    return pd.DataFrame([row.as_json() for row in rows]).set_index("name")


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """Return counts, and medians over the cases that have the number; None if none has it."""
    done = [row for row in rows if not row.failed]
    return {
        "cases": len(rows),
        "failed": len(rows) - len(done),
        "with_regret": sum(row.regret is not None for row in done),
        "recommended_is_best": sum(row.regret == 1 for row in done),
        "median_fit": _median([row.fit for row in done]),
        "median_error": _median([row.error for row in done]),
        "median_regret": _median([row.regret for row in done]),
        "worst_regret": max((r for row in done if (r := row.regret) is not None), default=None),
        "median_held": _median([row.held for row in done]),
    }


def _median(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None
