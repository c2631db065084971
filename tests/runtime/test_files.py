"""Files appear whole or not at all."""

import json
import os
import stat
from pathlib import Path
from typing import Any

import pytest

from splitband.runtime.files import replacing, write_json, write_text

OLD, NEW = "old content", "new content"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "results.json"


@pytest.mark.parametrize("before", [None, OLD])
@pytest.mark.parametrize("name", ["archive.tar.gz", "noextension"])
def test_the_new_content_appears_when_the_block_ends(
    name: str, before: str | None, tmp_path: Path
) -> None:
    """It is written beside the file, under a name with its suffix."""
    path = tmp_path / name
    if before is not None:
        path.write_text(before)
    with replacing(str(path)) as temporary:
        assert (temporary.parent, temporary.suffix) == (path.parent, path.suffix)
        temporary.write_text(NEW)
        assert (path.read_text() if path.exists() else None) == before
    assert path.read_text() == NEW
    assert list(tmp_path.iterdir()) == [path]


def fail_while_replacing(path: Path, error: type[BaseException]) -> None:
    with replacing(path) as temporary:
        temporary.write_text(NEW)
        raise error


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_a_failing_block_leaves_the_old_content_and_nothing_else(
    path: Path, error: type[BaseException]
) -> None:
    with pytest.raises(error):
        fail_while_replacing(path, error)
    assert list(path.parent.iterdir()) == []
    path.write_text(OLD)
    with pytest.raises(error):
        fail_while_replacing(path, error)
    assert path.read_text() == OLD
    assert list(path.parent.iterdir()) == [path]


def test_a_file_that_cannot_be_replaced_leaves_nothing_behind(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(OSError, match="folder"), replacing(folder) as temporary:
        temporary.write_text(NEW)
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_is_written_into_and_stays(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.txt"
    os.mkfifo(pipe)
    end = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        write_text(pipe, NEW)
        assert os.read(end, 100).decode() == NEW
    finally:
        os.close(end)
    assert pipe.is_fifo()
    assert [*tmp_path.iterdir()] == [pipe]


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="Windows has no such file")
def test_standard_output_is_gone_on_with(capfd: pytest.CaptureFixture[str]) -> None:
    os.write(1, OLD.encode())
    write_text("/dev/stdout", NEW)
    assert capfd.readouterr().out == OLD + NEW
    assert Path("/dev/stdout").is_symlink()


@pytest.mark.parametrize("mask", [0o022, 0o077])
def test_the_file_has_the_permissions_of_any_new_file(path: Path, mask: int) -> None:
    previous = os.umask(mask)
    try:
        with replacing(path) as temporary:
            temporary.write_text(NEW)
        assert os.umask(mask) == mask
    finally:
        os.umask(previous)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


def test_json_is_written_as_it_was(path: Path) -> None:
    value = {"rmse": 0.1, "nested": [1, None, True, {"Ω": "5 °"}]}
    write_json(path, value)
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == value
    assert text.endswith("}\n")


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (float("nan"), "not JSON compliant"),
        ({"rmse": [1.0, -float("inf")]}, "not JSON compliant"),
        ({"folder": Path()}, "Path"),
    ],
)
def test_json_refuses_what_it_lacks_and_keeps_the_old_file(
    path: Path, value: Any, said: str
) -> None:
    path.write_text(OLD)
    with pytest.raises((ValueError, TypeError), match=said):
        write_json(path, value)
    assert path.read_text() == OLD
    assert list(path.parent.iterdir()) == [path]
