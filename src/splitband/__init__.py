"""Learn dynamics models from measured records, their slow and fast parts by different means."""

from splitband.cells import GRU, Cell, EulerMLP
from splitband.data import Trajectory, read
from splitband.filters import ComplementaryPair
from splitband.models import Filtered, Model, Recurrent, Residual, Split
from splitband.rollout import rollout
from splitband.training import History, Progress, Settings, fit

__version__ = "0.1.0"
__all__ = [
    "GRU",
    "Cell",
    "ComplementaryPair",
    "EulerMLP",
    "Filtered",
    "History",
    "Model",
    "Progress",
    "Recurrent",
    "Residual",
    "Settings",
    "Split",
    "Trajectory",
    "fit",
    "read",
    "rollout",
]
