"""Saving when it is interrupted between two renames, and models whose parts share parameters."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from splitband import GRU, ComplementaryPair
from splitband.models import Model, Recurrent, Split
from splitband.models.saving import load, save

Y = np.random.default_rng(0).standard_normal((60, 1))


def simulated(model: Model) -> Any:
    return model.simulate(Y[:20], 30)


class Tied(GRU):
    """A cell with two names for one matrix, as an embedding and its decoder often have."""

    def __init__(self, ny: int, hidden_size: int) -> None:
        super().__init__(hidden_size, ny)
        self.arguments = {"ny": ny, "hidden_size": hidden_size}
        self.encoder = nn.Linear(ny, hidden_size, bias=False)
        self.decoder = nn.Linear(ny, hidden_size, bias=False)
        self.decoder.weight = self.encoder.weight

    def observe(self, h: torch.Tensor) -> torch.Tensor:
        return h @ self.decoder.weight + self.encoder(super().observe(h)).mean(-1, keepdim=True)


@pytest.mark.parametrize("renames", [(0, 0), (1, 1), (2, 1), (2, 0)])
def test_whichever_rename_is_interrupted_a_whole_model_is_left(
    renames: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And if it is interrupted once more over what the first interruption has left."""
    old, new = Recurrent(GRU(3, 1)), Recurrent(GRU(3, 1))
    save(old, tmp_path)
    for allowed in renames:
        with monkeypatch.context() as patched:
            interrupt_after(patched, allowed)
            with pytest.raises(KeyboardInterrupt):
                save(new, tmp_path)
        np.testing.assert_array_equal(simulated(load(tmp_path)[0]), simulated(old))
    save(new, tmp_path)
    np.testing.assert_array_equal(simulated(load(tmp_path)[0]), simulated(new))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model.json", "weights.safetensors"]


def interrupt_after(monkeypatch: pytest.MonkeyPatch, renames: int) -> None:
    left, rename = iter(range(renames)), Path.replace

    def interrupted(self: Path, target: Any) -> Path:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "replace", interrupted)


def test_a_network_that_stands_for_two_bands_is_saved(tmp_path: Path) -> None:
    cell = GRU(3, 1)
    model = Split([cell, cell], ComplementaryPair.butterworth(0.5, 10.0))
    save(model, tmp_path)
    np.testing.assert_array_equal(simulated(load(tmp_path)[0]), simulated(model))


def test_parameters_that_a_cell_ties_are_tied_in_the_loaded_one(tmp_path: Path) -> None:
    model = Recurrent(Tied(1, 3)).double()
    save(model, tmp_path)
    loaded, _ = load(tmp_path, {"Tied": Tied})
    np.testing.assert_array_equal(simulated(loaded), simulated(model))
    assert isinstance(loaded, Recurrent)
    assert isinstance(loaded.cell, Tied)
    assert loaded.cell.decoder.weight is loaded.cell.encoder.weight
    assert loaded.cell.decoder.weight.dtype == torch.float64
