"""Commands know columns and inputs by name, and say which these are."""

from pathlib import Path

import pandas as pd
import pytest

from splitband.cli.options import RecordOptions, names
from splitband.cli.requests import Request, planned
from tests.cli.support import DT, SAMPLES, call, results

pytestmark = pytest.mark.usefixtures("inside")


def test_an_earlier_model_brings_columns_and_inputs(
    driven_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    call(f"fit record.csv --jobs 1 --like {driven_model}", tmp_path / "model")
    facts, earlier = results(tmp_path / "model"), results(driven_model)
    assert (facts["columns"], facts["inputs"]) == (["a"], ["force"])
    assert facts["training"] == earlier["training"]
    said = f"record.csv: inputs: force; outputs: a; {SAMPLES} samples every {DT} s"
    assert said in capsys.readouterr().out.splitlines()
    assert planned(Request("record.csv", like=driven_model)).record.inputs == ("force",)


def test_a_column_with_a_comma_stands_in_double_quotes(tmp_path: Path) -> None:
    table = pd.read_csv("record.csv").rename(columns={"a": "a, measured"})
    table.to_csv(tmp_path / "rig.csv", index=False)
    given = RecordOptions(columns=' "a, measured" ,b', inputs="force")
    record = planned(Request(f"{tmp_path}/rig.csv", given, methods="mean")).record
    assert record.columns == ("a, measured", "b")
    assert names('force  (N), ,"x"') == ["force  (N)", "x"]


def test_every_record_is_announced_and_what_is_left_out_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "noted.csv"
    rows = "".join(f"{i / 10},{2 * i},{i % 7},fine\n" for i in range(60))
    path.write_text(f"time,time_2,y,note\n{rows}")
    call(f"compare {path} --methods mean,persistence --test {path} --jobs 1", tmp_path / "out")
    said = capsys.readouterr().out.splitlines()
    assert said.count(f"{path}: inputs: none; outputs: y; 60 samples every 0.1 s") == 2
    left_out = "left out: 'time_2' (another time column), 'note' (no numbers: 'fine')"
    assert f"warning: {path}: {left_out}" in said
