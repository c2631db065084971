"""Make the page of many comparisons."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

import numpy as np
from bokeh.models import Scatter, Segment

from splitband.report.benchmark import COLUMNS, CaseColumn, Row, summary
from splitband.report.numbers import number, percent
from splitband.report.page.charts import Axis, Chart, X
from splitband.report.page.parts import Cell, Page, Plot, Section, Table, Usage
from splitband.report.page.tables import settings


def page(rows: Sequence[Row], used: Usage, own_page: str) -> Page:
    """Return the whole page; `own_page` is the file name of the page in each case's folder."""
    found = summary(rows)
    text = [
        f"The recommended method was the best one in {found['recommended_is_best']} of "
        f"{found['with_regret']} cases."
    ]
    facts = [("cases", str(found["cases"]))]
    for key in ("median_fit", "median_error", "median_regret", "worst_regret"):
        title = key.replace("_", " ")
        facts += [] if found[key] is None else [(title, number(found[key]))]
    if found["median_held"] is not None:
        facts.append(("median share in the interval", percent(found["median_held"])))
    failed = [f"{row.name}: {row.note}" for row in rows if row.note]
    sections = [
        Section("answer", "In short", text, failed, facts=facts, plots=_plots(rows)),
        Section("cases", "All cases", tables=[_table(rows, own_page)]),
        settings([], used),
    ]
    lead = "Each case is a separate comparison; its name links to its page."
    return Page(f"Benchmark of {len(rows)} cases", lead, sections)


def _table(rows: Sequence[Row], own_page: str) -> Table:
    caption, headings = "Fit and error of the median over seeds", [each.heading for each in COLUMNS]
    cells = [
        [
            Cell(row.name, link="" if row.failed else f"{quote(row.name)}/{own_page}"),
            *(_cell(column, row) for column in COLUMNS[1:]),
        ]
        for row in rows
    ]
    notes = [(each.heading, each.note) for each in COLUMNS if each.note]
    return Table(caption, headings, cells, notes=notes)


def _cell(column: CaseColumn, row: Row) -> Cell:
    value = None if column.show is None else column.value(row)
    return Cell(column.entry(row), value, value is not None and value == column.ideal)


def _plots(rows: Sequence[Row]) -> list[Plot]:
    """Return a plot of the error of the recommended and of the best method, by case."""
    known = [(i, row) for i, row in enumerate(rows) if row.error and row.best_error]
    if not known:
        return []
    errors, best = np.full((2, len(rows)), np.nan)
    for i, row in known:
        errors[i], best[i] = row.error, row.best_error
    axis = Axis.over(np.arange(1.0, len(rows) + 1), "case, in the order of the list")
    between = 0.7 * float(np.nanmin(best)), 1.4 * float(np.nanmax(errors))
    chart = Chart(axis, "RMSE over standard deviation", between, log=True)
    ends = [chart.column(y) for y in (errors, best)]
    joined = Segment(x0=X, x1=X, y0=ends[0], y1=ends[1], line_width=1.5)
    chart.add(joined, "regret", ["measured"])
    for y, name, marker, role in zip(ends[::-1], ("best", "recommended"), ("diamond", "circle"),
                                     ("c2", "c0"), strict=True):  # fmt: skip
        chart.add(Scatter(x=X, y=y, marker=marker, size=9), name, [role])
    chart.mark(1.0, "mark", "width")
    says = (
        f"Dot plot of the errors of {len(known)} cases with a logarithmic axis: the recommended "
        "method's and the best one's, joined by a line whose length is the regret. At 1 a "
        "prediction is as good as the record's mean."
    )
    caption = "Error of the recommended and of the best method; dashed: as good as the mean"
    return [chart.plot(caption, says, key=[("c0", "recommended"), ("c2", "best")])]
