"""Commands know columns and inputs by name, and say which these are."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.cli.options import RecordOptions, names
from splitband.cli.requests import Request, planned
from tests.cli.support import DT, FORCE, SAMPLES, assert_fails, call, results

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


def test_a_history_of_other_names_is_refused_by_command_and_in_python(
    driven_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "simulate driven --history history_renamed.csv --steps 3 --out x.csv"
    says = "'time', 'z', 'b', 'force'", "the model is for inputs: force; outputs: a"
    assert_fails(f"{line} --future-inputs future.csv", says, capsys)

    forecaster, coming = sb.load(driven_model), FORCE[50:53, None]
    known = sb.read("history.csv", columns="a", inputs="force")
    others: tuple[tuple[dict[str, Any], str], ...] = (
        ({"columns": ("temp",)}, "training record, a, got temp"),
        ({"inputs": ("rpm",)}, "training record, force, got rpm"),
    )
    for other, both in others:
        with pytest.raises(ValueError, match=both):
            forecaster.predict(3, replace(known, **other), coming)
    nameless = forecaster.predict(3, sb.Record(known.y, DT, u=known.u, start=0.0), coming)
    np.testing.assert_allclose(nameless.y, forecaster.predict(3, known, coming).y)


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
