"""What holds for every command: quiet, JSON, version, methods, doctor."""

import json
from pathlib import Path

import pytest

import splitband as sb
from splitband.cli import COMMANDS, main
from splitband.cli.methods import GROUPS
from splitband.forecasters.names import NAMES
from tests.cli.support import QUICK, call, results

pytestmark = pytest.mark.usefixtures("inside")

SPECTRUM = "spectrum record.csv --columns a"


@pytest.mark.parametrize("line", [f"--json {SPECTRUM}", f"{SPECTRUM} --json"])
def test_json_is_all_that_is_printed_and_what_the_file_holds(
    line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(line, tmp_path)
    assert json.loads(capsys.readouterr().out) == results(tmp_path)


def test_every_command_that_compares_trains_or_simulates_prints_json(
    workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = f"{workspace}/record.csv --columns a"
    lines = {
        "compare": f"compare {record} --methods mean,persistence --out {tmp_path}/compared",
        "forecast": f"forecast {record} --method mean --steps 5 --out {tmp_path}/forecast",
        "fit": f"fit {record} --method gru {QUICK} --out {tmp_path}/model",
        "simulate": f"simulate {tmp_path}/model --history {workspace}/record.csv --steps 5 "
        f"--out {tmp_path}/simulated.csv",
        "export": f"export {tmp_path}/model {tmp_path}/model.c",
        "methods": "methods",
        "data": "data list",
        "doctor": "doctor",
    }
    keys = {
        "compare": "recommended",
        "forecast": "method",
        "fit": "training_rmse",
        "simulate": "file",
        "export": "files",
        "methods": "simple baselines",
        "data": "named",
        "doctor": "versions",
    }
    assert {*lines, "demo", "spectrum", "check", "summary"} == {*COMMANDS}
    for command, line in lines.items():
        call(f"{line} --json")
        assert keys[command] in json.loads(capsys.readouterr().out)


def test_quiet_prints_nothing_and_writes_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(SPECTRUM, tmp_path / "aloud")
    capsys.readouterr()
    call(f"{SPECTRUM} --quiet", tmp_path / "quiet")
    assert capsys.readouterr() == ("", "")
    assert results(tmp_path / "quiet") == results(tmp_path / "aloud")


def test_a_command_after_a_quiet_one_is_not_quiet(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("methods --quiet")
    assert capsys.readouterr().out == ""
    call("methods")
    assert "seasonal-naive" in capsys.readouterr().out


def test_errors_are_said_in_quiet_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quiet", "spectrum", "nothing.csv"]) == 2
    assert "nothing.csv" in capsys.readouterr().err


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    call("--version")
    assert capsys.readouterr().out == f"splitband {sb.__version__}\n"


def test_every_method_is_in_one_group_and_explained() -> None:
    grouped = [name for group in GROUPS for name in group.names]
    assert sorted(grouped) == sorted(NAMES)
    assert all(method.in_words() for method in NAMES.values())


def test_an_unknown_method_is_told_what_may_have_been_meant(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["compare", "record.csv", "--columns", "a", "--methods", "splt-gru,mean"]) == 2
    found = capsys.readouterr().err
    assert "`splitband methods` lists, got 'splt-gru' (did you mean split-gru?)" in found


def test_the_doctor_finds_a_record_that_is_not_the_published_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = tmp_path / sb.data.public.PUBLIC["drill_string_sim"].path
    damaged.parent.mkdir(parents=True)
    damaged.write_text("1\n2\n")
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    call("doctor --json")
    found = json.loads(capsys.readouterr().out)["public records"]
    assert "is not the published drill_string_sim" in found["drill_string_sim"]
    assert found["drill_string_data"] == "not there: splitband data fetch"


def test_a_shell_completes_commands(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COMP_WORDS", "splitband fo")
    monkeypatch.setenv("COMP_CWORD", "1")
    monkeypatch.setenv("_SPLITBAND_COMPLETE", "complete_bash")
    with pytest.raises(SystemExit):
        main([])
    assert capsys.readouterr().out.split() == ["forecast"]
