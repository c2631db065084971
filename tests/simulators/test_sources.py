"""What counts as a simulator's content: its file, what that imports, and what its user names."""

from pathlib import Path

import numpy as np
import pytest

from splitband.simulators import run
from splitband.simulators.isolation import Isolated
from splitband.simulators.sources import source_files

FILES = {
    "sim.py": "import json\nimport numpy as np\nfrom pack.sub import inner\nimport space.deep\n"
    "def f(time):\n    import late\n    return inner.factor() * time\n",
    "late.py": "",
    "unused.py": "",
    "pack/__init__.py": "",
    "pack/sub/__init__.py": "from . import beside\n",
    "pack/sub/beside.py": "import sim  # a circle\n",
    "pack/sub/inner.py": "from pathlib import Path\nfrom ..level import LEVEL\n"
    "def factor():\n    return LEVEL * float(Path(__file__).with_name('f.txt').read_text())\n",
    "pack/level.py": "LEVEL = 1.0\n",
    "pack/sub/f.txt": "2",
    "space/deep.py": "def broken(:\n",
    "elsewhere/other.py": "",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path.resolve()


def test_modules_of_the_user_are_found_and_no_others(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(folder / "elsewhere"))
    with (folder / "late.py").open("a") as late:
        late.write("import other\n")
    found = source_files(folder / "sim.py")
    assert found[0] == folder / "sim.py"
    without = {"unused.py", "pack/sub/f.txt"}
    assert {str(path.relative_to(folder)) for path in found} == FILES.keys() - without


def test_what_is_kept_is_computed_again_when_a_module_or_a_named_file_changes(
    folder: Path,
) -> None:
    (folder / "space/deep.py").write_text("")
    named = str(folder / "pack/sub/f.txt")
    simulator = Isolated(str(folder / "sim.py"), "f", reads=(named,))

    def last() -> float:
        return float(run(simulator, 3, 0.5, cache=folder / "cache")[-1, 0])

    assert last() == 2
    (folder / "pack/level.py").write_text("LEVEL = 10.0\n")
    assert last() == 20
    Path(named).write_text("3")
    assert last() == 30
    (stored,) = [p for p in (folder / "cache").iterdir() if np.load(p)[-1] == 30]
    np.save(stored, np.load(stored) + 1)
    (folder / "unused.py").write_text("changed = True\n")
    assert last() == 31  # as it was kept
