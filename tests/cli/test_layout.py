"""Options that say how a file is laid out, in every command that reads one."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.support import call

LOGGER = "Logger X1\nRate,100 Hz,1\nDate,Time,force,x\n,,N,mm\n"
OPTIONS = "--missing Bad,-- --gaps mask"


@pytest.fixture
def logger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A record over midnight, with units and a word for a missing value."""
    rows = [
        f"2024-03-0{1 + i // 60},{(23 + i // 60) % 24:02d}:{59 * (i < 60):02d}:{i % 60:02d},"
        f"{np.sin(i / 5):.4f},{'Bad' if i == 50 else f'{np.sin(i / 5 - 0.3):.4f}'}\n"
        for i in range(120)
    ]
    (tmp_path / "logger.csv").write_text(LOGGER + "".join(rows))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_record_of_a_logger(logger: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call(f"fit logger.csv --method mean --inputs force --columns x {OPTIONS}", logger / "a")
    said = capsys.readouterr().out
    assert "inputs: force [N]; outputs: x [mm]; 120 samples every 1 s" in said
    assert "1 of 120 samples are masked" in said
    assert "or just before: row 50" in said
    given = "--inputs force --time-column Date,Time --header-row 3 --skip-rows 14"
    call(f"fit logger.csv --method mean {given} {OPTIONS}", logger / "b")
    assert "110 samples every 1 s" in capsys.readouterr().out
