"""Learn dynamics models from measured records, their slow and fast parts by different means.

What the package hands out stands once, in `__init__.pyi`: a line there is all that a name needs. It
is loaded when it is used, as torch and pandas take seconds.
"""

import lazy_loader

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

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
