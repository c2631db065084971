"""`--ahead`: models for some samples ahead of any origin, from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

import splitband as sb
from tests.cli.support import WARMUP, call, results

pytestmark = pytest.mark.usefixtures("inside", "short_rounds")


@pytest.mark.usefixtures("drawn")
def test_a_comparison_is_made_for_some_samples_ahead(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = "compare record.csv --columns a,b --methods gru,persistence --hidden 3,4 --rounds 1"
    call(f"{asked} --warmup {WARMUP} --ahead 12 --jobs 1", tmp_path / "out")
    said, found = capsys.readouterr().out, results(tmp_path / "out")
    best = found["recommended"]
    assert found["settings"]["ahead"] == 12
    ahead = [column for column in found["table"] if column.get("ahead")]
    assert [(column["ahead"], column["channel"]) for column in ahead] == [
        (steps, name) for steps in (1, 12) for name in "ab"
    ]
    assert f"a, 12 samples ahead: fit {ahead[2]['values'][best]:.1f} % (1 sample ahead: " in said
    assert "simulation of" in said or "forecast of" in said
    assert "Fits 1, 12 samples ahead are from" in " ".join(said.split())
    assert f"windows of {WARMUP + 12}" in found["methods"]["gru"]["description"]
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "forecasts 12 samples ahead after the training part" in page
    assert "--steps 12" in page  # how the model is used
    assert "model.predict(12)" in page
    # The model says so where it is checked.
    call(f"check {tmp_path}/out/model --record record.csv", tmp_path / "checked")
    assert {"1 sample ahead", "12 samples ahead"} < {*results(tmp_path / "checked")["fit"]}
    call(f"check {tmp_path}/out/model --record record.csv --ahead 3", tmp_path / "checked")
    assert {"1 sample ahead", "3 samples ahead"} < {*results(tmp_path / "checked")["fit"]}


def test_one_method_is_fitted_for_some_samples_ahead(tmp_path: Path) -> None:
    asked = f"fit record.csv --columns a --method gru --hidden 3,4 --warmup {WARMUP} --ahead 15"
    call(f"{asked} --rounds 1", tmp_path / "searched")
    call(f"{asked} --epochs 1 --intervals", tmp_path / "given")
    for name in ("searched", "given"):
        model = sb.load(tmp_path / name)
        assert f"windows of {WARMUP + 15}" in model.describe()
        assert model.held_out is not None
        assert model.held_out.ahead == 15


def test_one_sample_ahead_is_what_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("compare record.csv --columns a --methods persistence,mean --ahead 1", tmp_path / "out")
    found = results(tmp_path / "out")
    (fit,) = (column for column in found["table"] if column.get("ahead"))
    assert f"1 sample ahead: fit {fit['values'][found['recommended']]:.1f} %" in (
        capsys.readouterr().out
    )
