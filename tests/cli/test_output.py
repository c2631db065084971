"""What --out may be, and what is in it: no input, one command at a time, one whole result."""

import json
import os
import shlex
import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband.cli import main
from splitband.runtime.outputs import LOCK, locked, staged, write_facts
from tests.cli.support import QUICK, B, assert_fails, call, files, results, written

resource = pytest.importorskip("resource")

MEAN = "compare record.csv --columns a --methods mean --warmup 10"
INSPECT = "inspect record.csv --columns a"


@pytest.fixture(autouse=True)
def beside_records(workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each test has a folder of its own with copies of records and of a simulator."""
    for name in ("record.csv", "history.csv", "future.csv", "simulated.csv"):
        shutil.copy(workspace / name, tmp_path)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(
    ("history", "out"),
    [(name, "./history.csv") for name in ("history.csv", "symlink.csv", "hardlink.csv")],
)
def test_a_simulation_never_replaces_its_history(
    model: Path, history: str, out: str, capsys: pytest.CaptureFixture[str]
) -> None:
    os.symlink("history.csv", "symlink.csv")
    os.link("history.csv", "hardlink.csv")
    line = f"simulate {model} --history {history} --steps 3 --out {out}"
    says = "--out must not replace a file that the command reads", "is read by --history"
    assert_fails(line, says, capsys)
    assert_fails(f"simulate {model} --history {out} --steps 3 --out {history}", says, capsys)


def test_a_simulation_never_replaces_a_file_of_its_model(
    model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(model, "model")
    line = "simulate model --history history.csv --steps 3 --out model/"
    (weights,) = (path.name for path in model.glob("weights-*"))
    for name in ("forecaster.json", weights):
        assert_fails(f"{line}{name}", ("--out", f"model/{name}", "MODEL_DIR"), capsys)
    for _ in range(2):  # its own file in the same folder may be replaced
        call(f"{line}ahead.csv")


@pytest.mark.parametrize(
    ("line", "option"),
    [
        ("compare {} --methods mean", "RECORD"),
        ("compare record.csv --methods mean --test {}", "--test"),
        ("compare record.csv --methods mean --simulator {}", "--simulator"),
        ("forecast record.csv --steps 3 --future-inputs {}", "--future-inputs"),
    ],
)
def test_no_command_replaces_what_it_reads(
    line: str, option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for each in ("report.html", "results.json"):
        Path("out").mkdir(exist_ok=True)
        shutil.copy("record.csv", f"out/{each}")
        given = line.format(f"out/{each}")
        assert_fails(f"{given} --out out", (f"out/{each} is read by {option}",), capsys)


def test_results_of_a_model_are_not_replaced_by_those_of_another_kind(
    capsys: pytest.CaptureFixture[str],
) -> None:
    fit = "fit record.csv --columns a --method mean"
    for first, model, others in ((MEAN, "out/model", (INSPECT, fit)), (fit, "out", (MEAN,))):
        call(first, Path("out"))
        before = files(Path("out"))
        for other in others:
            says = f"--out must not hold a model that the command does not replace, got {model}"
            assert_fails(f"{other} --out out", (says,), capsys)
        assert files(Path("out")) == before
        call(first, Path("out"))
        shutil.rmtree("out")


def test_a_second_command_in_the_folder_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with locked("out"):
        says = (
            "--out: out is in use by another splitband command",
            f"process {os.getpid()}, started",
        )
        assert_fails(f"{INSPECT} --out out", says, capsys)
    call(INSPECT, Path("out"))
    assert not Path("out", LOCK).exists()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_a_killed_command_keeps_nobody_out() -> None:
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        with locked("out"):
            os.write(writing, b".")
            signal.pause()
    os.read(reading, 1)
    with pytest.raises(ValueError, match=f"process {child}"), locked("out"):
        pass
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    with locked("out"):
        assert Path("out", LOCK).exists()


@pytest.mark.parametrize("exists", [True, False])
def test_a_link_in_place_of_the_lock_is_refused_and_not_followed(exists: bool) -> None:
    Path("out").mkdir()
    target = Path("target").absolute()
    if exists:
        target.write_text("kept")
    Path("out", LOCK).symlink_to(target)
    expected = f"--out must not hold a link .*{LOCK}; remove it"
    with pytest.raises(ValueError, match=expected), locked("out", "--out"):
        pass
    assert target.exists() == exists
    assert not exists or target.read_text() == "kept"


def test_a_folder_of_a_full_disk_can_be_locked() -> None:
    with largest_file(0), locked("out"):
        assert Path("out", LOCK).read_bytes() == b""
        with pytest.raises(ValueError, match="out is in use by another"), locked("out"):
            pass
    assert not Path("out").exists()


def test_nothing_of_an_earlier_result_stays_but_what_is_the_users() -> None:
    out = Path("out")
    call(f"{MEAN} --test history.csv", out)
    assert (out / "predictions-test-1.csv").is_file()
    own = {"notes.txt": "mine", "table.csv": "mine", "predictions-test-7.csv": "mine"}
    for name, text in own.items():
        (out / name).write_text(text)
    call(MEAN, out)
    found = results(out)
    assert {path.name for path in out.iterdir()} == {*found["files"], "results.json", "model", *own}
    assert not (out / "predictions-test-1.csv").exists()
    call("forecast record.csv --method mean --steps 3", out)
    kept = {"results.json", "predictions.csv", "forecast.csv", "report.html", "model", *own}
    assert {path.name for path in out.iterdir()} == kept
    assert {name: (out / name).read_text() for name in own} == own


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """The operating system refuses to write beyond that size, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize(
    ("line", "size", "name"),
    [
        (MEAN, 200_000, "report.html"),  # after predictions.csv
        ("fit record.csv --method linear --columns a --inputs force", 3_000, "weights-"),
    ],
)
def test_a_result_that_cannot_be_written_leaves_the_earlier_one_and_names_the_file(
    line: str, size: int, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = Path("out")
    call(line, out)
    before = files(out)
    with largest_file(size):
        assert main([*shlex.split(line), "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert f"File too large: out/{name}" in said
    assert said.count("\n") == 1
    assert files(out) == before


def test_a_result_cut_off_while_it_is_moved_is_gone_and_the_next_one_whole(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def write(*names: str) -> None:
        with staged("out") as new:
            for name in names:
                (new / name).write_text(name)
            write_facts(new, {})

    write("predictions.csv", "forecast.csv", "rollouts.png")
    moved = Path.replace

    def killed(self: Path, target: Path) -> Path:
        if self.name == "table.csv":
            raise KeyboardInterrupt
        return moved(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            write("rollouts.png", "table.csv")
    assert not Path("out/results.json").exists()
    write("spectrum.png")
    assert {path.name for path in Path("out").iterdir()} == {"results.json", "spectrum.png"}
    assert json.loads(Path("out/results.json").read_text()) == {
        "format": 2,
        "files": ["spectrum.png"],
    }


def test_predictions_of_test_records_and_errors_by_channel_are_written() -> None:
    line = "compare record.csv --columns a,b --methods gru,mean --test history.csv"
    call(f"{line} --test record.csv {QUICK} --seeds 1 --jobs 1", Path("out"))
    found = results(Path("out"))
    for test, file in zip(found["tests"], ("history", "record"), strict=True):
        table = written(Path("out") / test["predictions"])
        measured = written(Path(f"{file}.csv"))
        np.testing.assert_array_equal(table["time"], measured["time"])
        errors = [c for c in found["table"] if c["heading"] == "test RMSE"]
        for column in test["columns"]:
            np.testing.assert_array_equal(table[column], measured[column])
            (own,) = (c for c in errors if (c["record"], c["channel"]) == (test["name"], column))
            for method in ("gru", "mean"):
                predicted = table[f"{column}, {method}, from start"]
                assert predicted.isna().tolist() == [True] * 10 + [False] * (len(table) - 10)
                rmse = np.sqrt(np.mean((predicted - table[column])[10:] ** 2))
                assert own["values"][method] == pytest.approx(rmse)
    level = pd.read_csv("out/predictions-test-2.csv")["b, mean, from start"].dropna()
    assert level.to_numpy() == pytest.approx(B.mean())
