"""What splitband does on the systems of its users; on Linux it is made to see Windows."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from splitband.runtime import system
from splitband.runtime.errors import InputError
from splitband.runtime.outputs import locked, staged, write_facts
from splitband.simulators import user_code

HERE = Path(__file__).parent
linux = pytest.mark.skipif(sys.platform != "linux", reason="Windows is pretended on Linux")


@pytest.fixture
def desk(tmp_path: Path) -> dict[str, str]:
    """The environment of a Windows with splitband, whose console knows one code page."""
    site = tmp_path / "site"
    site.mkdir()
    begin = "from tests.desks import windows\n\nwindows.pretend()\n"
    (site / "sitecustomize.py").write_text(begin, encoding="utf-8")
    before = os.environ.get("PYTHONPATH", "")
    paths = [str(site), str(HERE.parents[1]), *filter(None, [before])]
    return os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONIOENCODING": "cp1252",
        "PYTHONWARNDEFAULTENCODING": "1",
    }


def run(folder: Path, environment: dict[str, str], *words: str) -> subprocess.CompletedProcess[str]:
    how: dict[str, Any] = {"capture_output": True, "encoding": "cp1252", "timeout": 300}
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=folder, env=environment, check=False, **how)


@linux
def test_the_main_paths_run_on_windows(tmp_path: Path, desk: dict[str, str]) -> None:
    """In a folder with a space and an umlaut in its name, as a user's is."""
    folder = tmp_path / "Müller, Karl"
    folder.mkdir()
    done = run(folder, desk, str(HERE / "main_paths.py"))
    assert done.returncode == 0, done.stderr[-3000:]
    assert done.stdout.endswith("all main paths run\n")
    assert "outputs: ? (°)" in done.stdout
    page = (folder / "out/report.html").read_text(encoding="utf-8")
    assert "\\\n" not in page.partition("<pre")[2].partition("</pre>")[0]


PROBE = """
import contextlib, io, os
import pathlib

with contextlib.suppress(ModuleNotFoundError):
    import fcntl
    raise SystemExit("fcntl")
assert not hasattr(os, "killpg") and os.name == "nt"
path = pathlib.Path("open.txt")
path.write_bytes(b"1")
with path.open("rb") as file:
    for refused in (lambda: os.fsync(file.fileno()), path.unlink, lambda: path.rename(path)):
        with contextlib.suppress(OSError):
            refused()
            raise SystemExit("not refused")
try:
    path.read_text()
except EncodingWarning:
    print("pretended")
"""


@linux
def test_the_pretended_windows_refuses_what_the_real_one_does(
    tmp_path: Path, desk: dict[str, str]
) -> None:
    program = f"exec(compile({PROBE!r}, 'probe', 'exec'), {{'__name__': 'splitband.probe'}})"
    done = run(tmp_path, desk, "-c", program)
    assert done.stdout == "pretended\n", done.stderr


@pytest.fixture
def on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(system, "sys", SimpleNamespace(platform="win32"))


@pytest.mark.usefixtures("on_windows")
def test_commands_are_written_as_the_shells_of_windows_take_them(tmp_path: Path) -> None:
    assert system.quoted(r"out\model") == r"out\model"
    assert system.quoted(r"C:\my rigs\rig.csv") == r'"C:\my rigs\rig.csv"'
    assert system.quoted("force,valve (%)") == '"force,valve (%)"'
    assert system.quoted("a,b\\") == r'"a,b\\"'
    assert system.quoted(r'the "x\"') == r'"the \"x\\\""'
    assert system.over_lines(["splitband fit rig.csv", "    --out rig"]) == (
        "splitband fit rig.csv --out rig"
    )
    for name in ("b.csv", "a.csv"):
        (tmp_path / name).touch()
    words = ["summary", str(tmp_path / "*.csv"), "--columns", "a*"]
    found = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    assert system.expanded(words) == ["summary", *found, "--columns", "a*"]


def busy(path: Path, number: int | None) -> PermissionError:
    """What Windows says of a file that another program has open, or POSIX of a folder."""
    error = PermissionError(13, "in use", str(path))
    if number is not None:
        error.winerror = number  # type: ignore[attr-defined]
    return error


@pytest.mark.parametrize(("number", "tries"), [(32, 3), (5, 3), (None, 1)])
def test_a_file_that_a_scanner_has_open_is_moved_a_moment_later(
    number: int | None, tries: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is refused for any other reason is not tried again."""
    source, moved, seen = tmp_path / "new", Path.replace, []
    source.touch()

    def scanned(self: Path, target: Path) -> Path:
        seen.append(target)
        if len(seen) < 3:
            raise busy(self, number)
        return moved(self, target)

    monkeypatch.setattr(Path, "replace", scanned)
    if number is None:
        with pytest.raises(PermissionError):
            system.move(source, tmp_path / "old")
    else:
        system.move(source, tmp_path / "old")
    assert len(seen) == tries


def test_a_result_that_is_open_elsewhere_is_told_first_and_stays_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a spreadsheet has it open on Windows."""
    out, renamed = tmp_path / "out", Path.rename

    def write(text: str) -> None:
        with staged(out) as new:
            (new / "predictions.csv").write_text(text, encoding="utf-8")
            write_facts(new, {"text": text})

    def opened(self: Path, target: Path) -> Path:
        if self.name == "predictions.csv":
            raise busy(self, 32)
        return renamed(self, target)

    write("old")
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    monkeypatch.setattr(Path, "rename", opened)
    monkeypatch.setattr(system, "TRIES", 1)
    with pytest.raises(InputError, match=r"--out .*predictions\.csv"), locked(out, "--out"):
        pytest.fail("the command has begun")
    with pytest.raises(PermissionError, match=r"close it.*predictions\.csv"):
        write("new")
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_compiled_modules_of_python_are_not_the_users(tmp_path: Path) -> None:
    """On Windows they lie in a folder of their own."""
    assert not user_code._of_the_user(Path(sys.base_prefix).resolve() / "DLLs" / "_ssl.pyd")
    assert user_code._of_the_user(tmp_path.resolve() / "rig.py")
