"""Learn dynamics models from measured records, their slow and fast parts by different means.

What the package hands out stands once, in `__init__.pyi`: a line there is all that a name needs.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

from splitband.runtime.provided import provide

__version__ = "0.2.0"

# What results and forecasters are asked for, and who does it: the code knows them, not they it.
provide(
    {
        "table": "splitband.report.table:frame",
        "table as text": "splitband.report.table:as_text",
        "table as HTML": "splitband.report.table:as_html",
        "picture of a comparison": "splitband.report.pictures:rollouts",
        "picture of a prediction": "splitband.report.pictures:prediction",
        "results": "splitband.report.results:save",
        "page of a comparison": "splitband.report.page.document:of_comparison",
        "page of a forecast": "splitband.report.page.document:of_forecast",
        "export": "splitband.export.writing:export",
        "saving": "splitband.forecasters.saving:save",
        "step responses": "splitband.forecasters.responses:respond",
        "check": "splitband.forecasters.checking:check",
        "held-out forecasts": "splitband.forecasters.backtest:interval_errors_of",
    }
)

_PLACES = {
    name.name: str(line.module)
    for line in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(line, ast.ImportFrom)
    for name in line.names
}
__all__ = sorted(_PLACES)  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    """Load a name on its first use: torch and pandas take seconds."""
    if name not in _PLACES:
        raise AttributeError(f"module 'splitband' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(_PLACES[name]), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_PLACES})
