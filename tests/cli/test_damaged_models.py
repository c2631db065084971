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


def changed(*names: str, **values: Any) -> Callable[[Path], None]:
    """Other values in what the description says of a part of the forecaster."""

    def change(description: dict[str, Any]) -> None:
        found = description["forecaster"]["fields"]
        for name in names:
            found = found[name]["fields"]
        found.update(values)

    return lambda folder: edit(folder, change)


CALIBRATION = "_fitted_base", "applied"


@pytest.mark.parametrize(
    ("kind", "damage", "says"),
    [
        ("gru", cut_weights, "damaged/weights-"),
        ("gru", lambda folder: edit(folder, lambda d: d.pop("format")), "`splitband fit`"),
        ("gru", changed("_trained_by", warmup=-3), "warm"),
        ("gru", changed("fitted", "record", columns=["a"]), "columns"),
        ("gru", changed("fitted", start={"date": "NaT"}), "damaged"),
        ("filtered", changed(*CALIBRATION, speed=1.0), "damaged"),
        ("filtered", changed(*CALIBRATION, gain=[1.0, 2.0]), "damaged"),
        ("filtered", changed(*CALIBRATION, clock=math.nan), "damaged"),
    ],
    ids=["weights", "format", "warm-up", "columns", "start", "unknown", "size", "nan"],
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
