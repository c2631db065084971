"""Say what the package hands out, and where it is: for type checkers, and when it is loaded."""

from . import networks as networks
from .checks.inspection import inspect as inspect
from .checks.model import check as check
from .checks.responses import step_responses as step_responses
from .comparison.run import compare as compare
from .comparison.result import Comparison as Comparison
from .records import (
    Record as Record,
    read as read,
)
from .export.writing import casadi_step as casadi_step
from .filters import ComplementaryPair as ComplementaryPair
from .forecasters.bands import Bands as Bands
from .forecasters.base import Forecaster as Forecaster
from .forecasters.baselines import (
    Harmonic as Harmonic,
    Mean as Mean,
    Periodic as Periodic,
    Persistence as Persistence,
    SeasonalNaive as SeasonalNaive,
)
from .forecasters.ensemble import Ensemble as Ensemble
from .forecasters.grey_box import GreyBox as GreyBox
from .forecasters.hybrid import (
    Filtered as Filtered,
    Residual as Residual,
    Single as Single,
    Split as Split,
)
from .forecasters.linear import Linear as Linear
from .forecasters.loading import load as load
from .forecasters.prediction import Prediction as Prediction
from .forecasters.simulation import (
    Calibrated as Calibrated,
    Simulation as Simulation,
)
from .forecasters.stream import Stream as Stream
from .metrics import (
    ExtrapolationWarning as ExtrapolationWarning,
    fit_percent as fit_percent,
    nrmse as nrmse,
    rmse as rmse,
)
from .networks import (
    GRU as GRU,
    StateSpace as StateSpace,
)
from .runtime.errors import InputError as InputError
from .simulators import (
    Fmu as Fmu,
    Function as Function,
    Ode as Ode,
    Recorded as Recorded,
    Simulator as Simulator,
    Unknown as Unknown,
    identify as identify,
)
from .training import TrainingSettings as TrainingSettings

__all__: list[str]
__version__: str
