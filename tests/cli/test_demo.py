"""`splitband demo`, on a shorter crane and hardly trained."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband.cli import demo, main
from splitband.comparison.methods import named
from splitband.comparison.running import RunningComparison
from splitband.records.named import overhead_crane
from tests.cli.support import call, results, watched

pytestmark = pytest.mark.usefixtures("inside")


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo, "overhead_crane", lambda: overhead_crane(800))
    monkeypatch.setattr(demo, "TRAIN", 400)
    monkeypatch.setattr(demo, "RECIPE", {"window": 60, "warmup": 10, "epochs": 1})


def test_a_demo_that_is_stopped_has_no_story_but_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(run: RunningComparison) -> None:
        if run.finals:
            raise KeyboardInterrupt

    watched(monkeypatch, stop)
    assert main(["demo", "--jobs", "1", "--out", str(tmp_path)]) == 130
    assert "RMSE of its first" not in capsys.readouterr().out
    assert demo.NETWORK not in results(tmp_path)["methods"]


def test_the_demo_tells_its_story_with_the_errors_of_its_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("demo --jobs 1", tmp_path)
    said = " ".join(capsys.readouterr().out.split())
    found = results(tmp_path)
    assert list(found["methods"]) == demo.METHODS
    table = pd.read_csv(tmp_path / "predictions.csv")
    truth = overhead_crane(800).y_true
    assert truth is not None
    for name in (demo.SIMULATOR, demo.NETWORK, demo.BOTH):
        errors = table[f"load [m], {name}, forecast"].to_numpy()[400:] - truth[400:, 0]
        first, last = (np.sqrt(np.mean(part**2)) for part in (errors[:300], errors[-300:]))
        assert f"{named(name).in_words()}: {first:.2f} m, then {last:.2f} m" in said
    assert (
        f"recommended: {named(found['recommended']).title}, chosen by held-out error simulation of"
        in said
    )
    assert "over the whole simulation: " in said
