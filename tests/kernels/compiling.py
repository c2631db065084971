"""Compile every kernel in both precisions; `make test` runs it while other checks do.

Otherwise each worker of the suite would compile for itself what is not on disk yet.
"""

import numpy as np
import torch

from splitband.filters import lfilter
from splitband.networks import GRU, EulerMLP, StateSpace, rollout


def main() -> None:
    """Filter, and simulate with gradients."""
    lfilter([0.5], [1.0, -0.5], np.arange(3.0))
    for dtype in (torch.float32, torch.float64):
        for batch in (1, 8):  # few rows and many are different kernels
            y = torch.zeros(batch, 2, 1, dtype=dtype)
            for cell in (GRU(2), EulerMLP(1, 2, 2, 2, 2, 0.1), StateSpace(2, 2)):
                rollout(cell.to(dtype), y, 2).sum().backward()


if __name__ == "__main__":
    main()
