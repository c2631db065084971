"""Commands know columns and inputs by name, and say which these are."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.cli.comparing import Request, planned
from splitband.cli.options import RecordOptions, names
from tests.cli.support import DT, FORCE, SAMPLES, A, B, assert_fails, call, results

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


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("record.csv --inputs b", "outputs: a, the record has inputs: b; outputs: a"),
        ("record.csv --columns force", "outputs: a, the record has inputs: none; outputs: force"),
        ("record.csv --columns a,b", "outputs: a, the record has inputs: force; outputs: a, b"),
        ("record.csv --columns a --inputs ''", "outputs: a, the record has inputs: none; outp"),
        ("history_renamed.csv", "column 'a' is unknown: the columns are 'time', 'z', 'b', 'force'"),
    ],
)
@pytest.mark.usefixtures("driven_model")
def test_a_model_of_other_columns_is_refused(
    line: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    says_both = "is for inputs: force; outputs: a", says
    assert_fails(f"fit {line} --like driven --out m", says_both, capsys)


def test_a_history_of_other_names_is_refused_by_command_and_in_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("fit record.csv --columns a,b --inputs force --method linear", tmp_path / "model")
    line = f"simulate {tmp_path / 'model'} --history history_renamed.csv --steps 3 --out x.csv"
    says = "'time', 'z', 'b', 'force'", "the model is for inputs: force; outputs: a, b"
    assert_fails(f"{line} --future-inputs future.csv", says, capsys)

    forecaster = sb.load(tmp_path / "model")
    y, u, coming = np.column_stack([A, B])[:50], FORCE[:50], FORCE[50:53, None]
    for columns, inputs, both in (
        (("temp", "b"), ("force",), "training record, a, b, got temp, b"),
        (("a", "b"), ("rpm",), "training record, force, got rpm"),
    ):
        other = sb.Record(y, DT, u=u, columns=columns, inputs=inputs, start=0.0)
        with pytest.raises(ValueError, match=both):
            forecaster.predict(3, other, coming)
    nameless = forecaster.predict(3, sb.Record(y, DT, u=u, start=0.0), coming)
    named = sb.read("history.csv", columns=["a", "b"], inputs="force")
    np.testing.assert_allclose(nameless.y, forecaster.predict(3, named, coming).y)


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
    call(f"spectrum {path}", tmp_path / "spectrum")
    said = capsys.readouterr().out.splitlines()
    assert f"{path}: inputs: none; outputs: y; 60 samples every 0.1 s" in said
