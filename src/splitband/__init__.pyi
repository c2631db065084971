"""Say what the package hands out, and where it is: for type checkers, and when it is loaded."""

from splitband.data import (
    Grid as Grid,
    Record as Record,
    read as read,
)
from splitband.evaluation.clock import Clock as Clock
from splitband.evaluation.comparison import Comparison as Comparison
from splitband.evaluation.forecast import (
    Forecast as Forecast,
    forecast as forecast,
)
from splitband.evaluation.plan import (
    Plan as Plan,
    plan as plan,
)
from splitband.evaluation.run import (
    Standing as Standing,
    compare as compare,
    run as run,
)
from splitband.filters import ComplementaryPair as ComplementaryPair
from splitband.forecasters.backtest import (
    Fit as Fit,
    Origin as Origin,
    Question as Question,
    backtest as backtest,
)
from splitband.forecasters.bands import Bands as Bands
from splitband.forecasters.base import Forecaster as Forecaster
from splitband.forecasters.closed_form import (
    Harmonic as Harmonic,
    Mean as Mean,
    Periodic as Periodic,
    Persistence as Persistence,
    SeasonalNaive as SeasonalNaive,
)
from splitband.forecasters.ensemble import Ensemble as Ensemble
from splitband.forecasters.grey_box import GreyBox as GreyBox
from splitband.forecasters.hybrids import (
    Filtered as Filtered,
    Residual as Residual,
)
from splitband.forecasters.known import Known as Known
from splitband.forecasters.names import (
    Sizes as Sizes,
    named as named,
)
from splitband.forecasters.learned import (
    Single as Single,
    Split as Split,
)
from splitband.forecasters.linear import Linear as Linear
from splitband.forecasters.prediction import Prediction as Prediction
from splitband.forecasters.saving import load as load
from splitband.forecasters.simulation import (
    Calibrated as Calibrated,
    Simulation as Simulation,
)
from splitband.forecasters.streaming import Stream as Stream
from splitband.metrics import (
    ExtrapolationWarning as ExtrapolationWarning,
    cumulative_rmse as cumulative_rmse,
    fit_percent as fit_percent,
    nrmse as nrmse,
    rmse as rmse,
)
from splitband.networks import (
    GRU as GRU,
    Cell as Cell,
    EulerMLP as EulerMLP,
    StateSpace as StateSpace,
    rollout as rollout,
)
from splitband.simulators import (
    Estimate as Estimate,
    Fmu as Fmu,
    Function as Function,
    Ode as Ode,
    Recorded as Recorded,
    Simulator as Simulator,
    identify as identify,
)
from splitband.training import (
    Progress as Progress,
    Settings as Settings,
)

__all__: list[str]
__version__: str
