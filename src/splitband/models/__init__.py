"""Define models of a record: what is trained, and how it simulates from a warm-up.

A model says which networks it has and what each must reproduce (`tasks`); `training.loop` knows
nothing more. Training and simulation go through the same methods, so a network meets in training
just what it will meet in use.
"""

from splitband.models.base import Model, Signals, Task
from splitband.models.hybrid import Filtered, Hybrid, Residual
from splitband.models.recurrent import Recurrent
from splitband.models.split import Split

__all__ = ["Filtered", "Hybrid", "Model", "Recurrent", "Residual", "Signals", "Split", "Task"]
