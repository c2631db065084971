"""Train networks: windows, settings and recipes, the fit, checkpoints."""

from splitband.training.checkpoints import Checkpoint
from splitband.training.loop import History, Progress, fit
from splitband.training.settings import Settings, default_warmup

__all__ = ["Checkpoint", "History", "Progress", "Settings", "default_warmup", "fit"]
