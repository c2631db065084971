"""Define models of a record: what is trained, and how it simulates from a warm-up.

A model defines its networks and the signal that each must reproduce (`tasks`), which is all that
`training.loop` needs. Training and simulation call the same methods, so that a network has the same
kind of inputs in both.
"""

from splitband.models.base import Model, Signals, Task
from splitband.models.hybrid import Filtered, Hybrid, Residual
from splitband.models.recurrent import Recurrent
from splitband.models.split import Split

__all__ = ["Filtered", "Hybrid", "Model", "Recurrent", "Residual", "Signals", "Split", "Task"]
