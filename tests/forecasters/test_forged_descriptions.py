"""A description that was forged is refused in a ValueError, and takes no memory."""

from __future__ import annotations

import json
import resource
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import splitband as sb
from tests.support import edit

DT = 0.1
TIME = DT * np.arange(80)
RECORD = sb.Record(np.sin(TIME) + 0.2 * np.sin(9 * TIME), DT)
SHORT = sb.TrainingSettings.paper(window=30, warmup=12, epochs=1)
BANDS = sb.Bands(0.5, 1, 2)
MADE: dict[str, Any] = {
    "single": lambda: sb.Single(sb.GRU(2), SHORT),
    "rnn": lambda: sb.Single(sb.networks.EulerMLP(hidden_size=4, recognition_size=3), SHORT),
    "split": lambda: sb.Split(sb.GRU(2), sb.GRU(3), BANDS, settings=SHORT),
    "ensemble": lambda: sb.Ensemble(sb.Single(sb.GRU(2), SHORT), 2),
    "residual": lambda: sb.Residual(sb.Periodic(), sb.GRU(2), settings=SHORT),
}
SIZES = {"hidden_size", "state_size", "recognition_size", "ny", "nu", "warmup", "window"}
SIZES |= {"epochs", "batch_size", "order", "downsampling", "count", "begin", "samples"}
"""Keys of numbers that something is built from."""


def places(value: Any) -> list[tuple[Any, Any]]:
    """Where a description has the number of a size."""
    if isinstance(value, list):
        return [place for part in value for place in places(part)]
    if not isinstance(value, dict):
        return []
    here = [(value, key) for key, said in value.items() if key in SIZES and isinstance(said, int)]
    return here + [place for part in value.values() for place in places(part)]


def loaded_or_refused(folder: Path) -> str:
    """What `load` says against it; nothing where it loads and forecasts."""
    try:
        sb.load(folder).predict(5)
    except (ValueError, FileNotFoundError) as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("kind", "forged"),
    [*((kind, 1_000_000) for kind in ("rnn", "split", "ensemble", "residual")), ("split", "7")],
)
def test_a_size_that_was_forged_takes_no_memory(kind: str, forged: Any, tmp_path: Path) -> None:
    """In a template of a cell, too, of which there are no weights in the file."""
    MADE[kind]().fit(RECORD, seed=0).save(tmp_path)
    path = tmp_path / "forecaster.json"
    whole, before = path.read_text(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    said: list[str] = []
    for i in range(len(places(json.loads(whole)))):
        description = json.loads(whole)
        part, key = places(description)[i]
        part[key] = forged
        path.write_text(json.dumps(description))
        said.append(loaded_or_refused(tmp_path))
    path.write_text(whole)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB
    assert len(said) > 5
    assert not loaded_or_refused(tmp_path)


@pytest.mark.parametrize("kind", ["ensemble", "residual"])
def test_what_was_loaded_can_be_fitted_again(kind: str, tmp_path: Path) -> None:
    model = MADE[kind]().fit(RECORD, seed=1)
    model.save(tmp_path)
    loaded = sb.load(tmp_path)
    again = loaded.fit(RECORD, seed=1)
    np.testing.assert_array_equal(again.predict(9).y, model.predict(9).y)


class Counted(sb.GRU):
    """A cell of the user's own that computes with values when it is made."""

    def __init__(self, hidden_size: int, ny: int = 1, nu: int = 0) -> None:
        super().__init__(hidden_size, ny, nu)
        self.first = float(torch.ones(3).sum())

    def sized(self, ny: int, nu: int, warmup: int) -> Counted:
        return Counted(self.hidden_size, ny, nu)


def test_a_cell_of_ones_own_may_compute_with_values(tmp_path: Path) -> None:
    model = sb.Single(Counted(2), SHORT).fit(RECORD, seed=0)
    model.save(tmp_path)
    loaded = sb.load(tmp_path)
    np.testing.assert_array_equal(loaded.predict(9).y, model.predict(9).y)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        *(({"delays": {"tuple": d}}, "delays must be") for d in ([-1], [10**12], [0, 0])),
        *(({"late": {"tuple": d}}, "delays must be") for d in ([-1], [10**12], [0, 0])),
        ({"root": 0}, "root must be an array, got '0'"),
    ],
)
def test_what_no_fit_finds_is_refused(changes: dict[str, Any], said: str, tmp_path: Path) -> None:
    sb.Linear().fit(sb.Record(np.sin(TIME), DT, u=np.cos(TIME))).save(tmp_path)

    def change(description: dict[str, Any]) -> None:
        fields = description["forecaster"]["fields"]
        (fields if "delays" in changes else fields["model"]["fields"]).update(changes)

    edit(tmp_path, change)
    with pytest.raises(ValueError, match=said):
        sb.load(tmp_path)
