"""What is released: built, installed into an environment of its own, and run from there."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import splitband as sb

ROOT = Path(__file__).parents[1]
RECORD = sb.Record(np.sin(0.3 * np.arange(60)), 0.1)


def run(*command: str | Path, folder: Path) -> str:
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=own, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source distribution; the wheel is built from the latter."""
    out = tmp_path_factory.mktemp("built")
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", out, folder=ROOT)
    return out


def test_the_wheel_holds_the_package_and_the_sdist_what_it_takes_to_test_it(built: Path) -> None:
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        inside = set(wheel.namelist())
    sources = ROOT / "src"
    for path in (sources / "splitband").rglob("*"):
        if path.is_file() and "__pycache__" not in path.parts:
            assert str(path.relative_to(sources)) in inside
    assert not any(name.startswith("tests") for name in inside)
    with tarfile.open(next(built.glob("*.tar.gz"))) as sdist:
        kept = {name.partition("/")[2] for name in sdist.getnames()}
    assert {"README.md", "LICENSE", "CITATION.cff", "tests/conftest.py", "Makefile"} <= kept


def test_the_installed_wheel_runs_from_an_environment_of_its_own(
    built: Path, tmp_path: Path
) -> None:
    run(sys.executable, "-m", "venv", "--without-pip", "own", folder=tmp_path)
    site = next((tmp_path / "own").glob("lib/*/site-packages"))
    with zipfile.ZipFile(next(built.glob("*.whl"))) as wheel:
        wheel.extractall(site)
    # What the package depends on is taken from the environment of the tests.
    (site / "others.pth").write_text(f"{Path(pytest.__file__).parents[1]}\n")
    python = tmp_path / "own/bin/python"
    program = "from splitband import cli; print(cli.__file__); cli.main(['--version'])"
    where, said = run(python, "-c", program, folder=tmp_path).splitlines()
    assert where.startswith(str(site))
    assert said == f"splitband {sb.__version__}"


@pytest.mark.soak
@pytest.mark.parametrize(
    "extras", ["", "[networks]", "[fmu]", "[everywhere]", "[docs]", "[cluster]", "[parquet,plot]"]
)
def test_the_wheel_and_its_extras_are_installed_into_an_empty_environment(
    extras: str, built: Path, tmp_path: Path
) -> None:
    run(sys.executable, "-m", "venv", "own", folder=tmp_path)
    python, wheel = tmp_path / "own/bin/python", next(built.glob("*.whl"))
    pins = ROOT / "constraints.txt"
    run(python, "-m", "pip", "install", "-q", "-c", pins, f"{wheel}{extras}", folder=tmp_path)
    assert "splitband" in run(tmp_path / "own/bin/splitband", "--version", folder=tmp_path)
    run(tmp_path / "own/bin/splitband", "doctor", folder=tmp_path)


def test_the_citation_and_the_changelog_are_of_this_version() -> None:
    """What is cited is the last release; between releases the changelog begins with what is new."""
    cited = (ROOT / "CITATION.cff").read_text().splitlines()
    headings = re.findall("(?m)^## (\\S+)", (ROOT / "CHANGELOG.md").read_text())
    new, last = headings[:2]
    assert new == ("Unreleased" if "dev" in sb.__version__ else sb.__version__)
    assert f"version: {last if new == 'Unreleased' else new}" in cited


def test_every_requirement_is_pinned() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *(line for name in extras for line in extras[name])]
    names = {line.partition(">")[0].partition("=")[0].partition("[")[0] for line in wanted}
    pinned = {
        line.partition("==")[0].lower().replace("_", "-")
        for line in (ROOT / "constraints.txt").read_text().splitlines()
        if "==" in line
    }
    assert {name.lower().replace("_", "-") for name in names - BENCH - {"splitband"}} <= pinned


BENCH = {"jax", "tsfast"}
"""Of the extra that is for comparisons with others alone, and not for this machine's Python."""


PLOT = r"matplotlib: pip install .splitband\[plot\]"


@pytest.mark.parametrize(
    ("module", "use", "said"),
    [
        ("pyarrow", lambda: sb.read("rig.parquet"), r"PyArrow: pip install .splitband\[parquet\]"),
        ("matplotlib.axes", lambda: sb.Mean().fit(RECORD).predict(3).plot(), PLOT),
    ],
)
def test_a_missing_extra_says_how_it_is_installed(
    module: str,
    use: Callable[[], object],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.parquet").write_bytes(b"PAR1")
    monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, "splitband.report.pictures", raising=False)
    with pytest.raises(sb.InputError, match=said):
        use()
