"""What holds for every command: help, entry points, quiet, JSON, version, methods, doctor."""

import json
import re
import shutil
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import splitband as sb
from splitband.cli import COMMANDS, main, methods
from splitband.comparison.methods import NAMES
from splitband.comparison.methods import QUICK as UNTRAINED
from tests.cli.support import QUICK, assert_fails, call, complaints, process, results

pytestmark = pytest.mark.usefixtures("inside")

INSPECT = "inspect record.csv --columns a --inputs ''"
FILES = "--time-column --missing --skip-rows --header-row --gaps"
READING = "compare", "forecast", "fit", "inspect", "check", "simulate"


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("", "compare"),
        *((each, FILES) for each in READING),
        ("export", "OUT"),
        ("demo", "about a minute"),
        ("data", "fetch"),
    ],
)
def test_every_command_has_help(
    command: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"{command} --help")
    found = capsys.readouterr()
    assert [word for word in words.split(" --") if word not in found.out] == []
    assert not re.findall(r"<\w+>|\[x|\bint\b|\bstr\b", found.out)  # values have names, no types
    assert found.err == ""


def test_the_entry_point_writes_results_no_warning_and_no_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    script = shutil.which("splitband", path=str(Path(sys.executable).parent))
    assert script is not None
    line = f"fit record.csv --columns a --method gru {QUICK} --out {tmp_path}/model"
    found = process(script, *line.split())
    assert (found.returncode, complaints(found.stderr)) == (0, [])
    assert results(tmp_path / "model")["record"] == "record"
    assert [*temporary.iterdir()] == []


@pytest.mark.usefixtures("public_data")
def test_data_finds_and_lists_the_public_records(
    public_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("data")
    listed = capsys.readouterr().out
    for name in ("drill_string_data", "double_torsion_phi2", "van-der-pol", "CC BY 4.0"):
        assert name in listed
    call("data --fetch --json")
    found = json.loads(capsys.readouterr().out)["files"]
    path = public_data / "drill_string" / "drill_string_sim.txt"
    assert found["drill_string_sim"] == str(path)
    assert len(found) == 4


def test_json_is_all_that_is_printed_and_what_the_file_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"--json {INSPECT}", tmp_path)
    assert json.loads(capsys.readouterr().out) == results(tmp_path)


def test_every_command_that_compares_trains_or_simulates_prints_json(
    workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = f"{workspace}/record.csv --columns a"
    lines = {
        "compare": (f"{record} --methods mean --out {tmp_path}/compared", "recommended"),
        "forecast": (f"{record} --method mean --steps 5 --out {tmp_path}/forecast", "recommended"),
        "fit": (f"{record} --method gru {QUICK} --out {tmp_path}/model", "training_rmse"),
        "simulate": (f"{tmp_path}/model --steps 5 --out {tmp_path}/simulated.csv", "file"),
        "export": (f"{tmp_path}/model {tmp_path}/model.c", "files"),
        "methods": ("", "residual-gru-calibrated"),
        "data": ("", "named"),
        "doctor": ("", "versions"),
    }
    assert {*lines, "demo", "inspect", "check", "summary"} == {*COMMANDS}
    for command, (line, key) in lines.items():
        call(f"{command} {line} --json")
        assert key in json.loads(capsys.readouterr().out)


def test_an_export_says_how_to_begin_elsewhere(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call("fit record.csv --columns a --method harmonic", tmp_path / "harmonic")
    for folder, file, said in (
        (model, "rig.c", "call rig_clear, and let it observe at least 10 measured sample(s)."),
        (model, "rig.onnx", "to begin elsewhere, export it with --history."),
        (tmp_path / "harmonic", "rig.c", "export it with --history, as its periods count time."),
    ):
        call(f"export {folder} {tmp_path}/{file}")
        assert said in " ".join(capsys.readouterr().out.split())


def test_quiet_prints_nothing_but_errors_and_writes_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"{INSPECT} --quiet", tmp_path / "quiet")
    assert capsys.readouterr() == ("", "")
    call(f"--verbose {INSPECT} --quiet", tmp_path / "quiet")
    assert capsys.readouterr() == ("", "")
    call("fit record.csv --columns a --method mean --quiet", tmp_path / "forgotten")
    assert "not used: b, force; inputs (--inputs)" in capsys.readouterr().err
    call(INSPECT, tmp_path / "aloud")  # what comes after a quiet command is not quiet
    assert "Strongest frequencies" in capsys.readouterr().out
    quiet, aloud = results(tmp_path / "quiet"), results(tmp_path / "aloud")
    differ = quiet.pop("arguments").items() ^ aloud.pop("arguments").items()
    assert differ == {("out", str(tmp_path / name)) for name in ("quiet", "aloud")}
    assert quiet == aloud
    assert_fails("--quiet inspect nothing.csv", ("nothing.csv",), capsys)


def test_the_version_is_that_of_the_package_and_a_shell_completes_commands(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    call("--version")
    assert capsys.readouterr().out == f"splitband {sb.__version__}\n"
    monkeypatch.setenv("COMP_WORDS", "splitband fo")
    monkeypatch.setenv("COMP_CWORD", "1")
    monkeypatch.setenv("_SPLITBAND_COMPLETE", "complete_bash")
    with pytest.raises(SystemExit):
        main([])
    assert capsys.readouterr().out.split() == ["forecast"]


def test_a_defect_is_no_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ValueError that a library raises inside of the package keeps its traceback."""
    monkeypatch.setattr(
        "splitband.cli.records.load_records", lambda *_, **__: np.reshape([1, 2], 3)
    )
    with pytest.raises(ValueError, match="cannot reshape"):
        main(["inspect", "record.csv", "--out", "out"])


def test_the_table_of_methods_names_each_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    call("methods")
    said = capsys.readouterr().out
    kinds, bases, networks, options = methods.COLUMNS.values()
    assert all(part in said for part in (*kinds, *bases, *networks, *options, *methods.MEANINGS))
    found = {*methods.NETWORKS, "split-gru", "split-gru-hp", *UNTRAINED}
    for kind, base, network in product(kinds, bases, networks):
        calibrated = base == "(simulator)"
        name = f"{kind}{'' if calibrated else base}{network}"
        found |= {name, f"{name}{options[0]}"} if calibrated else {name}
    conditioned = {f"{name}{options[1]}" for name in found - {*methods.NETWORKS, *UNTRAINED}}
    assert found | conditioned == {*NAMES}
