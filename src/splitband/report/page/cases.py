"""The page of many comparisons."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

import numpy as np
from bokeh.models import HoverTool

from splitband.report.benchmark import Row, summary
from splitband.report.numbers import number, percent
from splitband.report.page import figures
from splitband.report.page.about import settings
from splitband.report.page.parts import Cell, Page, Plot, Section, Table
from splitband.report.page.usage import Usage

_NOTES = (
    ("fit %", "100 (1 - error) of the recommended method: 100 is perfect, 0 as good as the mean"),
    ("error", "its RMSE over the standard deviation of the predicted samples; of several outputs "
     "the root mean square"),
    ("regret", "the recommended method's error over the lowest one; 1 is ideal"),
    ("in interval", "share of the forecast's samples in the recommended method's interval"),
)  # fmt: skip


def page(rows: Sequence[Row], used: Usage, own_page: str) -> Page:
    """All of it; `own_page` is the name of each case's own one, in its folder."""
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
        Section("answer", "In short", text, failed, facts=facts),
        Section("cases", "All cases", tables=[_table(rows, own_page)]),
        Section("plots", "Errors and regret", plots=_plots(rows)),
        settings([], used),
    ]
    lead = "Each case is a comparison of its own; its name leads to its page."
    return Page(f"Benchmark of {len(rows)} cases", lead, [s for s in sections if _full(s)])


def _full(section: Section) -> bool:
    return section.name != "plots" or bool(section.plots)


def _table(rows: Sequence[Row], own_page: str) -> Table:
    cells = [
        [
            Cell(row.name, link="" if row.failed else f"{quote(row.name)}/{own_page}"),
            Cell(row.protocol),
            Cell("" if row.fit is None else f"{row.fit:.1f}", row.fit),
            Cell(row.recommended),
            Cell(row.best),
            Cell(number(row.error), row.error),
            Cell(number(row.regret), row.regret, row.regret == 1),
            Cell("–" if row.held is None else percent(row.held), row.held),  # noqa: RUF001
            Cell(number(row.seconds), row.seconds),
            Cell(row.note),
        ]
        for row in rows
    ]
    headings = [
        "case",
        "of",
        "fit %",
        "recommended",
        "best",
        "error",
        "regret",
        "in interval",
        "seconds",
        "note",
    ]
    caption = "Fit and error of the mean over seeds"
    return Table(caption, headings, cells, notes=_NOTES)


def _plots(rows: Sequence[Row]) -> list[Plot]:
    """The error of the recommended and of the best method, by case."""
    known = [(i + 1, row) for i, row in enumerate(rows) if row.error and row.best_error]
    if not known:
        return []
    x = np.array([i for i, _ in known], float)
    errors = np.array([row.error for _, row in known])
    best = np.array([row.best_error for _, row in known])
    shown = figures.plain(
        "RMSE over standard deviation", "case, in the order of the list", y_axis_type="log",
        x_range=figures.time_range(0.5, len(rows) + 0.5),
        y_range=figures.between(0.7 * float(best.min()), 1.4 * float(errors.max())),
    )  # fmt: skip
    data = figures.source(x, {"recommended": errors, "best": best})
    data.add([row.name for _, row in known], "case")
    drawn = shown.segment(figures.X, "recommended", figures.X, "best", source=data, line_width=1.5)
    drawn.update(tags=["measured"])
    for name, marker, role in (("best", "diamond", "c2"), ("recommended", "circle", "c0")):
        dots = shown.scatter(figures.X, name, source=data, marker=marker, size=9, name=name)
        dots.update(tags=[role])
    figures.mark(shown, 1.0, "mark", "width")
    tips = [("", "@case"), ("recommended", "@recommended"), ("best", "@best")]
    shown.add_tools(HoverTool(tooltips=tips, visible=False))
    says = (
        f"Dot plot of the errors of {len(known)} cases with a logarithmic axis: the recommended "
        "method's and the best one's, joined by a line whose length is the regret. At 1 a "
        "prediction is as good as the record's mean."
    )
    caption = "Error of the recommended and of the best method; dashed: as good as the mean"
    return [Plot(shown, caption, says, key=[("c0", "recommended"), ("c2", "best")])]
