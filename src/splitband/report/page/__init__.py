"""Results as one HTML file to look at and send on: it loads nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.report.benchmark import Row
from splitband.report.checked import CheckReport
from splitband.report.page import cases, checked, comparison, forecast, spectrum_report
from splitband.report.page.document import write as write_page
from splitband.report.page.spectrum_report import SpectrumReport
from splitband.report.page.usage import Usage

__all__ = ["NAME", "SpectrumReport", "Usage", "write"]

NAME = "report.html"
"""Of the file beside other results."""


def write(
    result: Comparison | Forecast | CheckReport | SpectrumReport | Sequence[Row],
    path: str | Path,
    usage: Usage | None = None,
) -> None:
    """Write the page of a result, whole or not at all.

    Parameters
    ----------
    result : A comparison, a forecast, a check of a model, what is known of a record's
        spectrum, or the rows of many comparisons.
    path : Of the file.
    usage : What only the caller knows of how it was asked for.
    """
    usage = usage or Usage()
    if isinstance(result, Comparison):
        page = comparison.page(result, usage)
    elif isinstance(result, Forecast):
        page = forecast.page(result, usage)
    elif isinstance(result, CheckReport):
        page = checked.page(result)
    elif isinstance(result, SpectrumReport):
        page = spectrum_report.page(result, usage)
    else:
        page = cases.page(result, usage, NAME)
    write_page(page, path)
