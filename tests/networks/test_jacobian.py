"""Test the derivatives of a rollout against those of torch, in float64."""

import numpy as np
import pytest
import torch

from splitband.networks import GRU, StateSpace
from splitband.networks.rollout import jacobians, rollout


@pytest.mark.parametrize(
    ("ny", "nu", "hidden", "encoded"), [(1, 0, 3, 0), (2, 3, 4, 5), (1, 2, 0, 2)]
)
def test_derivatives_are_those_of_torch(ny: int, nu: int, hidden: int, encoded: int) -> None:
    torch.manual_seed(0)
    cell = StateSpace(3, hidden, ny, nu, encoded=encoded).double()
    for weight in cell.parameters():
        weight.data += 0.1 * torch.randn_like(weight)
    y, u = torch.randn(2, 6, ny).double(), torch.randn(2, 20, nu).double() if nu else None
    found = jacobians(cell, y, 14, u)
    assert found is not None
    for row, slopes in enumerate(found):
        outputs = rollout(cell, y, 14, u)[row].flatten()
        for output, of_output in zip(outputs, slopes.reshape(len(outputs), -1), strict=True):
            wanted = torch.autograd.grad(output, [*cell.parameters()], retain_graph=True)
            together = torch.cat([each.flatten() for each in wanted])
            np.testing.assert_allclose(of_output, together.numpy(), rtol=1e-10, atol=1e-12)


def test_what_has_no_kernel_has_no_derivatives() -> None:
    y = torch.zeros(1, 4, 1)
    assert jacobians(GRU(3), y, 5) is None
    assert jacobians(StateSpace(2, 3, layers=2), y, 5) is None
