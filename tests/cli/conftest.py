"""Records and models that tests of several commands use."""

from pathlib import Path

import pytest

from tests.cli.support import QUICK, call, write_records


@pytest.fixture(scope="session")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli")
    write_records(folder)
    return folder


@pytest.fixture
def inside(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs in the folder of the records."""
    monkeypatch.chdir(workspace)


@pytest.fixture(scope="session")
def model(workspace: Path) -> Path:
    out = workspace / "gru"
    call(f"fit {workspace}/record.csv --columns a,b --method gru {QUICK}", out)
    return out


@pytest.fixture(scope="session")
def hybrid_model(workspace: Path) -> Path:
    out = workspace / "filtered"
    line = f"fit {workspace}/record.csv --columns a --method filtered-gru-calibrated {QUICK}"
    call(f"{line} --simulator {workspace}/simulated.csv", out)
    return out


@pytest.fixture(scope="session")
def driven_model(workspace: Path) -> Path:
    out = workspace / "driven"
    call(f"fit {workspace}/record.csv --columns a --inputs force --method gru {QUICK}", out)
    return out


@pytest.fixture
def short_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Candidates of a search are trained for a few steps only."""
    monkeypatch.setattr("splitband.comparison.candidates.FIRST_ROUND", 3)
    monkeypatch.setattr("splitband.comparison.candidates.FIRST_STEPS", 3)
