"""Learn dynamics models from measured records, their slow and fast parts by different means."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from splitband.data import Trajectory, read
    from splitband.filters import ComplementaryPair
    from splitband.models import Filtered, Model, Recurrent, Residual, Split
    from splitband.networks import GRU, Cell, EulerMLP, rollout
    from splitband.training import History, Progress, Settings, fit

__version__ = "0.1.0"

# Loaded on first use: torch and pandas take seconds.
_PACKAGES = {
    "data": ("Trajectory", "read"),
    "filters": ("ComplementaryPair",),
    "models": ("Filtered", "Model", "Recurrent", "Residual", "Split"),
    "networks": ("GRU", "Cell", "EulerMLP", "rollout"),
    "training": ("History", "Progress", "Settings", "fit"),
}
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


def __getattr__(name: str) -> Any:
    for package, names in _PACKAGES.items():
        if name in names:
            found = getattr(import_module(f"splitband.{package}"), name)
            globals()[name] = found
            return found
    raise AttributeError(f"module 'splitband' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
