"""Say what the package hands out, and where it is: for type checkers, and when it is loaded."""

from .checks.model import check as check
from .checks.responses import step_responses as step_responses
from .data import (
    Grid as Grid,
    Record as Record,
    read as read,
)
from .evaluation.clock import Clock as Clock
from .evaluation.comparison import Comparison as Comparison
from .evaluation.plan import (
    Plan as Plan,
    plan as plan,
)
from .evaluation.run import (
    Run as Run,
    compare as compare,
    run as run,
)
from .export.writing import casadi_step as casadi_step
from .filters import ComplementaryPair as ComplementaryPair
from .forecasters.backtest import (
    Fit as Fit,
    BacktestSpec as BacktestSpec,
    backtest as backtest,
)
from .forecasters.bands import Bands as Bands
from .forecasters.base import Forecaster as Forecaster
from .forecasters.closed_form import (
    Harmonic as Harmonic,
    Mean as Mean,
    Periodic as Periodic,
    Persistence as Persistence,
    SeasonalNaive as SeasonalNaive,
)
from .forecasters.ensemble import Ensemble as Ensemble
from .forecasters.grey_box import GreyBox as GreyBox
from .forecasters.names import (
    Sizes as Sizes,
    named as named,
)
from .forecasters.held_out import Origin as Origin
from .forecasters.learned import (
    Filtered as Filtered,
    Residual as Residual,
    Single as Single,
    Split as Split,
)
from .forecasters.linear import Linear as Linear
from .forecasters.loading import load as load
from .forecasters.prediction import (
    ForecastContext as ForecastContext,
    Prediction as Prediction,
)
from .forecasters.simulation import (
    Calibrated as Calibrated,
    Simulation as Simulation,
)
from .forecasters.stepping import Stream as Stream
from .metrics import (
    ExtrapolationWarning as ExtrapolationWarning,
    cumulative_rmse as cumulative_rmse,
    fit_percent as fit_percent,
    nrmse as nrmse,
    rmse as rmse,
)
from .networks import (
    GRU as GRU,
    Cell as Cell,
    EulerMLP as EulerMLP,
    StateSpace as StateSpace,
    rollout as rollout,
)
from .runtime.errors import InputError as InputError
from .simulators import (
    Estimate as Estimate,
    Fmu as Fmu,
    Function as Function,
    Ode as Ode,
    Recorded as Recorded,
    Simulator as Simulator,
    identify as identify,
)
from .simulators.opening import open_simulator as open_simulator
from .training import (
    Progress as Progress,
    TrainingSettings as TrainingSettings,
)

__all__: list[str]
__version__: str
