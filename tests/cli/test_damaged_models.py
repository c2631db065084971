"""A saved model that is damaged is refused in one line."""

import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.support import assert_fails
from tests.support import edit

pytestmark = pytest.mark.usefixtures("inside")


def cut_weights(folder: Path) -> None:
    (path,) = folder.glob("weights-*")
    path.write_bytes(path.read_bytes()[:-4])


def changed(**facts: Any) -> Callable[[Path], None]:
    """Other facts of the fit; a dot is written as two underscores."""
    found = {name.replace("__", "."): value for name, value in facts.items()}
    return lambda folder: edit(folder, lambda d: d["forecaster"]["facts"].update(found))


@pytest.mark.parametrize(
    ("kind", "damage", "says"),
    [
        ("gru", cut_weights, "damaged/weights-"),
        ("gru", lambda folder: edit(folder, lambda d: d.pop("format")), "`splitband fit`"),
        ("gru", changed(fitted__record__columns=["a"]), "columns"),
        ("gru", changed(fitted__start="NaT"), "damaged"),
        ("filtered", changed(**{"_fitted_base.0.applied.clock": math.nan}), "damaged"),
    ],
    ids=["weights", "format", "columns", "start", "nan"],
)
def test_a_damaged_model_is_one_line(
    kind: str,
    damage: Callable[[Path], None],
    says: str,
    model: Path,
    hybrid_model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("history.csv", "simulated.csv"):
        shutil.copy(name, tmp_path)
    shutil.copytree(model if kind == "gru" else hybrid_model, tmp_path / "damaged")
    monkeypatch.chdir(tmp_path)
    damage(Path("damaged"))
    line = "simulate damaged --history history.csv --steps 5 --out ahead.csv"
    line += "" if kind == "gru" else " --simulator simulated.csv"
    assert_fails(line, (says,), capsys)
