"""A saved model that is damaged is refused in one line."""

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.support import HYBRID_AHEAD, assert_fails

pytestmark = pytest.mark.usefixtures("inside")


def change_json(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        path = folder / "forecaster.json"
        description = json.loads(path.read_text())
        change(description)
        path.write_text(json.dumps(description))

    return damage


def state(description: dict[str, Any], *names: str) -> dict[str, Any]:
    """What the description says of the forecaster, or of a part of it."""
    found: dict[str, Any] = description["forecaster"]["fields"]
    for name in names:
        found = found[name]["fields"]
    return found


def cut_weights(folder: Path) -> None:
    (path,) = folder.glob("weights-*")
    path.write_bytes(path.read_bytes()[:-4])


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda f: (f / "forecaster.json").write_text("{"), ("forecaster.json is damaged:",)),
        (cut_weights, ("damaged/weights-", "damaged:")),
        (change_json(lambda d: d.pop("format")), ("`splitband fit`", "format")),
        (change_json(lambda d: state(d, "_trained_by").update(warmup=-3)), ("warm",)),
        (change_json(lambda d: state(d, "fitted", "record").update(columns=["a"])), ("columns",)),
        (change_json(lambda d: state(d, "fitted").update(start={"date": "NaT"})), ("damaged",)),
    ],
    ids=["json", "weights", "no facts", "warm-up", "columns", "start"],
)
def test_a_damaged_model_is_one_line(
    damage: Callable[[Path], None],
    says: tuple[str, ...],
    model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copy("history.csv", tmp_path)
    shutil.copytree(model, tmp_path / "damaged")
    monkeypatch.chdir(tmp_path)
    damage(Path("damaged"))
    line = "simulate damaged --history history.csv --steps 5 --out ahead.csv"
    assert_fails(line, says, capsys)


@pytest.mark.parametrize(
    "wrong", [{"speed": 1.0}, {"clock": "fast"}, {"gain": [1.0, 2.0]}, {"clock": math.nan}], ids=str
)
def test_a_damaged_calibration_is_one_line(
    wrong: dict[str, Any],
    hybrid_model: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(hybrid_model, tmp_path / "damaged")
    for name in ("history.csv", "simulated.csv"):
        shutil.copy(name, tmp_path)
    monkeypatch.chdir(tmp_path)
    change_json(lambda d: state(d, "_fitted_base", "applied").update(wrong))(Path("damaged"))
    line = HYBRID_AHEAD.replace("filtered", "damaged") + "--simulator simulated.csv"
    assert_fails(line, ("damaged",), capsys)
