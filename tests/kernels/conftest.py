"""Threads of the kernels."""

from collections.abc import Iterator

import pytest
import torch

from splitband.kernels import rollouts


@pytest.fixture(autouse=True)
def two_threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two threads for the kernels, small as the cases are, and one for torch, which would spin."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 2)
    monkeypatch.setattr(rollouts, "_WORTH_A_THREAD", 1)
    torch.manual_seed(0)
    yield
    torch.set_num_threads(threads)
