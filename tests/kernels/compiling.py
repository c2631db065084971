"""Compile every kernel in a precision; `make test` runs it for both while other checks do.

Otherwise each worker of the suite would compile for itself what is not on disk yet.
"""

import sys

import numpy as np
import torch

from splitband.filters import lfilter
from splitband.networks import GRU, EulerMLP, StateSpace, rollout


def main(precision: str) -> None:
    """Simulate with gradients, in float64 filter as well: filters know no other precision."""
    dtype = {"float32": torch.float32, "float64": torch.float64}[precision]
    if dtype == torch.float64:
        lfilter([0.5], [1.0, -0.5], np.arange(3.0))
    for batch in (1, 8):  # few rows and many are different kernels
        y = torch.zeros(batch, 2, 1, dtype=dtype)
        for cell in (GRU(2), EulerMLP(1, 2, 2, 2, 2, 0.1), StateSpace(2, 2)):
            rollout(cell.to(dtype), y, 2).sum().backward()


if __name__ == "__main__":
    main(*sys.argv[1:])
