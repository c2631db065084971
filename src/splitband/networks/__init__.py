"""Define recurrent networks and their free runs; the plain loop is the definition."""

from splitband.networks.cell import Cell
from splitband.networks.euler_mlp import EulerMLP
from splitband.networks.gru import GRU
from splitband.networks.rollout import Backend, free_run, rollout
from splitband.networks.state_space import StateSpace

__all__ = ["GRU", "Backend", "Cell", "EulerMLP", "StateSpace", "free_run", "rollout"]
