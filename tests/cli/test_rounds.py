"""A comparison round by round: the same work for a seed, results while it runs, what is gone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.comparison.clock import Clock
from splitband.comparison.running import RunningComparison
from splitband.report import results as written
from splitband.runtime.outputs import FACTS, LOCK
from splitband.runtime.progress import in_place
from tests.cli.support import assert_fails, call, files, results, watched

pytestmark = pytest.mark.usefixtures("inside", "short_rounds")

LINE = "compare record.csv --columns a --methods gru,mean --hidden 3,4 --jobs 1 "


@pytest.mark.usefixtures("drawn")
def test_each_round_leaves_a_line_a_table_and_a_model_while_it_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record, seen = sb.read("record.csv", columns="a"), dict[str, str]()
    shown = list[str]()

    def look(run: RunningComparison) -> None:
        shown.extend(each.read_text(encoding="utf-8") for each in tmp_path.glob("report.html"))
        if not run.new_table:
            return
        facts, model = results(tmp_path), sb.load(tmp_path / "model")
        assert model.name == facts["recommended"]
        assert model.predict(5, record).y.shape == (5, 1)
        seen[run.doing] = facts["unfinished"]

    watched(monkeypatch, look)
    call(f"{LINE} --rounds 2", tmp_path)
    assert seen == {each: each for each in ("baselines", "round 1", "round 2")}
    said = capsys.readouterr().out
    assert "round 1; best so far: " in said
    assert "round 2; best so far: " in said
    assert "unfinished" not in results(tmp_path)
    assert shown
    assert all("splitband compare record.csv" in page for page in shown)
    assert all("SHA-256 of record.csv" in page for page in shown)


def test_a_disk_error_in_between_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kept: list[bool] = []
    before: dict[str, bytes] = {}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    def look(run: RunningComparison) -> None:
        now = files(tmp_path)
        if run.doing == "round 1":
            before.update(now)
        elif run.doing == "round 2":
            kept.append(now == before)

    monkeypatch.setattr(written, "save_unfinished", full)
    watched(monkeypatch, look)
    call(f"{LINE} --rounds 2", tmp_path)
    assert kept == [True]
    assert f"warning: {tmp_path} could not be written: " in capsys.readouterr().out
    assert results(tmp_path)["methods"].keys() == {"gru", "mean"}


def test_a_training_like_an_earlier_one_has_its_settings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    earlier, out = tmp_path / "earlier", tmp_path / "out"
    line = "compare record.csv --columns a --inputs force --methods gru --hidden 2,5 --rounds 1"
    call(f"{line} --jobs 1", earlier)
    call(f"compare record.csv --like {earlier} --seeds 1 --jobs 1", out)
    found = results(out)
    assert found["search"] == []
    assert {"gru", "linear", "mean"} <= found["methods"].keys()
    assert (found["record"]["columns"], found["record"]["inputs"]) == (["a"], 1)
    first, again = (sb.load(each / "model") for each in (earlier, out))
    if again.name == first.name:
        assert again.settings == first.settings
    capsys.readouterr()
    for line, says in (
        (f"compare record.csv --like {earlier} --epochs 3 --out x", "--epochs must be left out"),
        (f"compare record.csv --like {earlier} --out {earlier}", "is read by --like"),
    ):
        before = files(earlier)
        assert_fails(line, (says,), capsys)
        assert files(earlier) == before


def test_skip_done_leaves_a_finished_result_alone_and_begins_another_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever it is asked for."""
    line, path = "compare record.csv --columns a --methods mean --skip-done", tmp_path / FACTS
    call(line, tmp_path)
    before, facts = files(tmp_path), results(tmp_path)
    capsys.readouterr()
    other = line.replace("mean", "persistence")
    call(other, tmp_path)
    said = f"{tmp_path} has a finished comparison of record already: nothing is done\n"
    assert capsys.readouterr().out == said
    call(f"{other} --json", tmp_path)
    assert json.loads(capsys.readouterr().out) == facts
    assert files(tmp_path) == before
    for mark in ({"unfinished": "round 1"}, {"interrupted": True}, {"format": 1}):
        path.write_text(json.dumps(facts | mark), encoding="utf-8")
        call(other, tmp_path)
        assert results(tmp_path)["recommended"] == "persistence"
    path.write_bytes(b"damaged")
    call(other, tmp_path)
    assert results(tmp_path)["recommended"] == "persistence"


def test_a_summary_has_a_row_for_each_output_and_test_record_of_each_folder(
    tmp_path: Path,
    workspace: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    line = f"compare {workspace}/record.csv --jobs 1 --methods"
    call(f"{line} mean,harmonic --columns a", Path("pump"))
    call(f"{line} mean --columns a,b --test {workspace}/history.csv", Path("arm"))
    Path("begun").mkdir()
    Path("begun", LOCK).touch()
    capsys.readouterr()
    call("summary pump arm begun --out all.csv")
    said = capsys.readouterr().out
    assert "begun: -: unfinished: no result yet" in said
    assert said.index("pump: harmonic") < said.index("arm: mean")
    call("summary pump arm begun --out all.json --json")
    rows = json.loads(capsys.readouterr().out)
    assert rows == json.loads(Path("all.json").read_text())
    arm = [("arm", record, output) for record in ("history", "record") for output in "ab"]
    found = [(row["folder"], row["record"], row["output"]) for row in rows]
    assert found == [("pump", "record", ""), *arm, ("begun", "", "")]
    for folder, best in (("pump", "harmonic"), ("arm", "mean")):
        for column in results(Path(folder))["table"]:
            for row in rows:
                where = row["folder"], row["record"], row["output"]
                own = column.get("record", "record"), column.get("channel", row["output"])
                if where == (folder, *own) and best in column["values"]:
                    assert row[column["heading"]] == column["values"][best]
    table = pd.read_csv("all.csv")
    assert table["forecast fit %"].tolist() == pytest.approx(
        [row.get("forecast fit %", np.nan) for row in rows], nan_ok=True
    )
    assert table["test fit %"].notna().tolist() == [False, True, True, False, False, False]
    for given, says in (
        ("pump other", "DIR must be a folder that splitband compare wrote, with results.json"),
        ("pump --out all.txt", "--out must end in .csv or .json, got all.txt"),
        ("pump --out pump/results.json", "is read by DIR..."),
    ):
        Path("other").mkdir(exist_ok=True)
        assert_fails(f"summary {given}", (says,), capsys)
    Path("pump/results.json").write_text(json.dumps({**results(Path("pump")), "format": 1}))
    says = "got 1 in pump: make them again with `splitband compare`"
    assert_fails("summary pump", (says,), capsys)


def test_the_time_left_is_that_to_the_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(120.0, writing=2.0)
    for module in ("runtime.deadlines", "comparison.clock"):
        monkeypatch.setattr(f"splitband.{module}.now", lambda: clock.began + 65.0)
    assert clock.left_in_words() == "0:53 left of 2:00"
    assert Clock(began=clock.began).left_in_words() == "1:05 so far"
    # The page is written meanwhile where that takes little of these 53 s.
    assert clock.allows_pages
    assert not replace(clock, writing=10.0).allows_pages


def test_a_notebook_whose_cursor_only_moves_on_gets_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setenv("TERM", "xterm-color")
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    assert in_place()
    monkeypatch.setenv("JPY_PARENT_PID", "1")
    assert not in_place()


@pytest.mark.parametrize("terminal", [True, False])
def test_python_shows_where_a_comparison_stands_in_a_terminal_alone(
    terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: terminal, raising=False)
    monkeypatch.setenv("TERM", "xterm-color")
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    record = sb.Record(np.sin(0.3 * np.arange(100)), 0.1)
    sb.compare(record, 80, [sb.Mean(), sb.Harmonic()])
    lines = [line.strip() for line in capsys.readouterr().out.split("\r")]
    assert any("best so far: sinusoids" in line for line in lines) == terminal
    assert lines[-2:] == (["", ""] if terminal else [""])


def test_a_second_is_enough_for_a_result(tmp_path: Path) -> None:
    call(f"{LINE} --budget 1s", tmp_path)
    found = results(tmp_path)
    assert sb.load(tmp_path / "model").name == found["recommended"]
    assert found["time"]["asked_seconds"] == 1


def test_a_summary_has_a_column_for_each_number_of_samples_ahead(
    tmp_path: Path, workspace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for ahead in (5, 12):
        line = f"compare {workspace}/record.csv --columns a --methods mean,persistence --jobs 1"
        call(f"{line} --ahead {ahead}", Path(f"of{ahead}"))
    call("summary of5 of12 --out all.csv")
    table = pd.read_csv("all.csv")
    for ahead in (5, 12):
        assert table[f"fit % {ahead} samples ahead"].notna().tolist() == [ahead == 5, ahead == 12]
    assert table["fit % 1 sample ahead"].notna().all()
