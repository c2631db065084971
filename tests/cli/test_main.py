"""What holds for every command: help, entry points, messages."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from splitband.cli import main
from tests.cli.support import QUICK, call, complaints, process, results

pytestmark = pytest.mark.usefixtures("inside")


@pytest.mark.parametrize(
    ("command", "word"),
    [
        ("", "compare"),
        ("compare", "--simulator"),
        ("fit", "MODEL_DIR"),
        ("simulate", "--future-inputs"),
        ("export", "OUT"),
        ("spectrum", "--cutoff"),
        ("demo", "about a minute"),
        ("data", "fetch"),
    ],
)
def test_every_command_has_help(
    command: str, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"{command} --help")
    found = capsys.readouterr()
    assert word in found.out
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


def test_as_a_module_it_fails_with_one_line_too() -> None:
    found = process(sys.executable, "-m", "splitband", "spectre")
    assert (found.returncode, found.stdout) == (2, "")
    assert found.stderr.startswith("error: No such command 'spectre'")
    assert found.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "name",
    [
        "price [EUR].csv",
        pytest.param("a :car: b.csv"),
    ],
)
def test_a_message_shows_file_names_as_they_are(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", name]) == 2
    assert name in capsys.readouterr().err


def test_a_defect_is_no_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ValueError that a library raises inside of the package keeps its traceback."""
    monkeypatch.setattr("splitband.cli.records.load_record", lambda *_: np.reshape([1, 2], 3))
    with pytest.raises(ValueError, match="cannot reshape"):
        main(["spectrum", "record.csv", "--out", "out"])
