"""Write what a check of a model found: results.json and the page."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from splitband.forecasters.checking import ModelCheck
from splitband.forecasters.responses import Responses
from splitband.report.results import environment
from splitband.runtime.outputs import staged, write_facts


@dataclass(frozen=True, eq=False)
class CheckReport:
    """Hold what `splitband check` shows.

    Attributes
    ----------
    check : Fits, tests, stability and ranges.
    kind : What the model is, in words.
    responses : To steps; None for a model without inputs, or whose simulator stays outside.
    asked : The command.
    """

    check: ModelCheck
    kind: str
    responses: Responses | None = None
    asked: str = ""


def save(report: CheckReport, folder: Path) -> None:
    """Write results.json and report.html in place of an earlier result."""
    page = import_module("splitband.report.page")
    with staged(folder) as new:
        page.of_check(report, new / page.NAME)
        write_facts(new, facts(report))


def facts(report: CheckReport) -> dict[str, Any]:
    """Return what results.json says."""
    found = report.check.as_json() | {"kind": report.kind, "command": report.asked}
    if report.responses is not None:
        gain = report.responses.y[-1]
        found["static_gain"] = {
            column: dict(zip(report.responses.inputs, map(float, row), strict=True))
            for column, row in zip(report.responses.columns, gain, strict=True)
        }
    return found | {"environment": environment()}
