from .cell import Cell as Cell
from .euler_mlp import EulerMLP as EulerMLP
from .gru import GRU as GRU
from .rollout import Backend as Backend
from .rollout import free_run as free_run
from .rollout import rollout as rollout
from .state_space import StateSpace as StateSpace
