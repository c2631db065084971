"""Learn dynamics models from measured records, their slow and fast parts by different means."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from splitband.runtime.provided import provide

if TYPE_CHECKING:
    from splitband.data import Grid, Record, read
    from splitband.evaluation.comparison import Comparison
    from splitband.evaluation.forecast import Forecast, forecast
    from splitband.evaluation.plan import Plan, plan
    from splitband.evaluation.run import compare, run
    from splitband.evaluation.saved_settings import SavedSettings
    from splitband.evaluation.search import Search
    from splitband.evaluation.setup import Options, Setup
    from splitband.evaluation.work import Work
    from splitband.filters import ComplementaryPair
    from splitband.forecasters.backtest import Origin, Question, backtest
    from splitband.forecasters.bands import Bands
    from splitband.forecasters.base import Forecaster
    from splitband.forecasters.closed_form import (
        Harmonic,
        Linear,
        Mean,
        Periodic,
        Persistence,
        SeasonalNaive,
    )
    from splitband.forecasters.ensemble import Ensemble
    from splitband.forecasters.grey_box import GreyBox
    from splitband.forecasters.hybrids import Filtered, Residual
    from splitband.forecasters.known import Known
    from splitband.forecasters.names import Sizes, named
    from splitband.forecasters.prediction import Prediction
    from splitband.forecasters.saving import load
    from splitband.forecasters.simulation import Calibrated, Simulation
    from splitband.forecasters.single import Single
    from splitband.forecasters.split import Split
    from splitband.forecasters.streaming import Stream
    from splitband.metrics import ExtrapolationWarning, cumulative_rmse, fit_percent, nrmse, rmse
    from splitband.networks import GRU, Cell, EulerMLP, StateSpace, rollout
    from splitband.runtime.cluster import Cluster
    from splitband.simulators import Estimate, Fmu, Function, Ode, Recorded, Simulator, identify
    from splitband.training import Progress, Settings

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
        "page of a comparison": "splitband.report.page:of_comparison",
        "page of a forecast": "splitband.report.page:of_forecast",
        "export": "splitband.export.writing:export",
        "saving": "splitband.forecasters.saving:save",
        "step responses": "splitband.forecasters.responses:respond",
        "check": "splitband.forecasters.checking:check",
        "held-out forecasts": "splitband.forecasters.backtest:held_out_by",
    }
)

# Loaded on first use: torch and pandas take seconds.
_MODULES = {
    "data": ("Grid", "Record", "read"),
    "evaluation.comparison": ("Comparison",),
    "evaluation.forecast": ("Forecast", "forecast"),
    "evaluation.run": ("compare", "run"),
    "evaluation.search": ("Search",),
    "evaluation.plan": ("Plan", "plan"),
    "evaluation.setup": ("Options", "Setup"),
    "evaluation.saved_settings": ("SavedSettings",),
    "evaluation.work": ("Work",),
    "filters": ("ComplementaryPair",),
    "forecasters.backtest": ("Origin", "Question", "backtest"),
    "forecasters.bands": ("Bands",),
    "forecasters.base": ("Forecaster",),
    "forecasters.closed_form": (
        "Harmonic",
        "Linear",
        "Mean",
        "Periodic",
        "Persistence",
        "SeasonalNaive",
    ),
    "forecasters.ensemble": ("Ensemble",),
    "forecasters.grey_box": ("GreyBox",),
    "forecasters.hybrids": ("Filtered", "Residual"),
    "forecasters.known": ("Known",),
    "forecasters.names": ("Sizes", "named"),
    "forecasters.prediction": ("Prediction",),
    "forecasters.saving": ("load",),
    "forecasters.simulation": ("Calibrated", "Simulation"),
    "forecasters.single": ("Single",),
    "forecasters.split": ("Split",),
    "forecasters.streaming": ("Stream",),
    "metrics": ("ExtrapolationWarning", "cumulative_rmse", "fit_percent", "nrmse", "rmse"),
    "networks": ("GRU", "Cell", "EulerMLP", "StateSpace", "rollout"),
    "runtime.cluster": ("Cluster",),
    "simulators": ("Estimate", "Fmu", "Function", "Ode", "Recorded", "Simulator", "identify"),
    "training": ("Progress", "Settings"),
}
__all__ = [
    "GRU",
    "Bands",
    "Calibrated",
    "Cell",
    "Cluster",
    "Comparison",
    "ComplementaryPair",
    "Ensemble",
    "Estimate",
    "EulerMLP",
    "ExtrapolationWarning",
    "Filtered",
    "Fmu",
    "Forecast",
    "Forecaster",
    "Function",
    "GreyBox",
    "Grid",
    "Harmonic",
    "Known",
    "Linear",
    "Mean",
    "Ode",
    "Options",
    "Origin",
    "Periodic",
    "Persistence",
    "Plan",
    "Prediction",
    "Progress",
    "Question",
    "Record",
    "Recorded",
    "Residual",
    "SavedSettings",
    "Search",
    "SeasonalNaive",
    "Settings",
    "Setup",
    "Simulation",
    "Simulator",
    "Single",
    "Sizes",
    "Split",
    "StateSpace",
    "Stream",
    "Work",
    "backtest",
    "compare",
    "cumulative_rmse",
    "fit_percent",
    "forecast",
    "identify",
    "load",
    "named",
    "nrmse",
    "plan",
    "read",
    "rmse",
    "rollout",
    "run",
]


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            value = getattr(import_module(f"splitband.{module}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module 'splitband' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
