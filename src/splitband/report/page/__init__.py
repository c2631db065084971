"""Results as one HTML file to look at and send on: it loads nothing from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.report.benchmark import Row
from splitband.report.checked import CheckReport
from splitband.report.page import (
    cases,
    checked,
    comparison,
    document,
    forecast,
    spectrum_report,
)
from splitband.report.page.spectrum_report import SpectrumReport
from splitband.report.page.usage import Usage

__all__ = [
    "NAME",
    "SpectrumReport",
    "Usage",
    "of_check",
    "of_comparison",
    "of_forecast",
    "of_rows",
    "of_spectrum",
]

NAME = "report.html"
"""Of the file beside other results."""


def of_comparison(result: Comparison, path: str | Path, usage: Usage | None = None) -> None:
    """Write the page of a comparison, whole or not at all; the caller knows the `usage`."""
    document.write(comparison.page(result, usage or Usage()), path)


def of_forecast(result: Forecast, path: str | Path, usage: Usage | None = None) -> None:
    """Write the page of a forecast, see `of_comparison`."""
    document.write(forecast.page(result, usage or Usage()), path)


def of_check(report: CheckReport, path: str | Path) -> None:
    """Write the page of a check of a model, see `of_comparison`."""
    document.write(checked.page(report), path)


def of_spectrum(report: SpectrumReport, path: str | Path, usage: Usage | None = None) -> None:
    """Write the page of what is known of a record's spectrum, see `of_comparison`."""
    document.write(spectrum_report.page(report, usage or Usage()), path)


def of_rows(rows: Sequence[Row], path: str | Path, usage: Usage | None = None) -> None:
    """Write the page of the rows of many comparisons, see `of_comparison`."""
    document.write(cases.page(rows, usage or Usage(), NAME), path)
