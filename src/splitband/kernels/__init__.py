"""Compile whole rollouts: warm-up, free run and their gradients in one call each.

The plain loop, `splitband.rollout`, is the definition; these take a cell's tensors and give the
same samples and gradients, on the CPU in float32 and float64. `recurrence` is that of a filter.
Numba compiles a kernel on its first call, says so on the log, and keeps it on disk. Importing
this package compiles nothing.
"""

from splitband.kernels.euler_mlp import euler_rollout
from splitband.kernels.gru import gru_rollout
from splitband.kernels.recurrence import recurrence
from splitband.kernels.state_space import state_space_rollout

__all__ = ["euler_rollout", "gru_rollout", "recurrence", "state_space_rollout"]
